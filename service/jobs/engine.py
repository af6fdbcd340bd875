"""The job engine, DBOS: its names, how a worker starts it and how a job is handed to it.

Our own row of a job is what counts; the engine decides which worker takes it and when, and after a crash gives it to
a worker again. What a workflow is given is the id of the row, and the number of the run.
"""

from __future__ import annotations

import logging
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from service import logs, tracing
from service.config import MOST_CPU_JOBS, Settings
from service.jobs.outage import Repeats
from service.storage.database import sqlite_file, use_wal
from service.storage.jobs import ON_RIG
from service.storage.pooling import pool_options
from service.storage.tables import JobRow

if TYPE_CHECKING:
    from dbos import DBOS, DBOSClient, DBOSConfig, EnqueueOptions

APPLICATION = "ambit"
VERSION = "jobs-1"
"""Of the workflows' steps, not of the product: a job that began before an upgrade goes on after it. Changes only when
the order of the steps does."""
RIGS, CPU, NOTICES = "rigs", "cpu", "notices"
NOTICE = "ambit.notice"
MOST_AT_ONCE = {RIGS: 64, CPU: MOST_CPU_JOBS, NOTICES: 8}
"""What one worker runs of each queue at a time, at most. Receivers that answer slowly keep no more threads than those
few."""
_SPARE_THREADS = 8
THREADS = sum(MOST_AT_ONCE.values()) + _SPARE_THREADS
"""One for whatever the queues hand out: what waits for a thread would keep its rig, and run nowhere. The others are for
the engine's own work and for what it has superseded, which ends a little later. A thread is made when it is needed."""
POLLS_S = {RIGS: 0.4, CPU: 0.2, NOTICES: 1.0}
"""How often the only worker looks into each queue. Rigs' has a part for every rig and costs twice as much a look."""
UNUSED_S = 4.0
"""Below the 5 s after which the engine takes a lock from whoever holds it still."""
_SHARED_BY = 5
"""So many workers at most share the looking: a job that only one of them may take does not wait for ever."""


def workflow_id(job_id: str, run: int) -> str:
    """Name in the engine of a job's run, or of an attempt to send a message."""
    return f"{job_id}.{run}"


def workflow_name(kind: str) -> str:
    """Name of the workflow of a kind of job."""
    return f"ambit.{kind}"


def queue_of(workflow: str) -> str:
    """The queue whose limits hold for a workflow of that name."""
    if workflow == NOTICE:
        return NOTICES
    return RIGS if workflow in {workflow_name(kind) for kind in ON_RIG} else CPU


def waits_for_thread() -> bool:
    """Whether something that a queue has handed out to this process waits for a thread still."""
    from dbos._dbos import _get_dbos_instance

    return not _get_dbos_instance()._executor._work_queue.empty()


def shared_s(period_s: float, workers: int) -> float:
    """Period of each of so many workers that share something: together they do it about as often as one alone."""
    return period_s * min(max(workers, 1), _SHARED_BY)


def poll_s(queue: str, workers: int) -> float:
    """How often each of so many workers looks into a queue.

    A look costs about 4 ms of CPU here and 1 ms in PostgreSQL; a job waits for the first of them, whoever that is.
    """
    return shared_s(POLLS_S[queue], workers)


def share_polls(workers: int) -> None:
    """Tell the engine, which keeps one interval for all workers, how many there are."""
    from dbos import DBOS

    for name in POLLS_S:
        if (queue := DBOS.retrieve_queue(name)) is not None:
            queue.set_polling_interval_sec(poll_s(name, workers))


def engine_config(settings: Settings) -> DBOSConfig:
    """Configuration of a worker's engine."""
    _prepare(settings)
    pool = {} if sqlite_file(settings.jobs_database) is not None else pool_options()
    return {
        "name": APPLICATION,
        "system_database_url": settings.jobs_database,
        "executor_id": settings.worker,
        "application_version": VERSION,
        "console_log_level": "WARNING",
        "log_level": "WARNING",
        "use_listen_notify": False,
        "max_executor_threads": THREADS,
        "db_engine_kwargs": pool,
    }


def quieten(engine: DBOS) -> None:
    """Have the engine look once in `UNUSED_S` for what nobody here asks of it, and log as we do; before it is launched.

    It brings a handler of its own, past the one form of our log and past the striking out of secrets, and repeats a
    warning at every look.

    Every worker looked once a second for delayed workflows, for workflows past their deadline, and into the queue of
    workflows that have none: a third of what an idle worker cost. The engine has no setting for it.
    """
    from dbos import _workflow_commands

    _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC = UNUSED_S
    engine._registry.get_internal_queue()._polling_interval_sec = UNUSED_S
    its_log = logging.getLogger("dbos")
    its_log.handlers.clear()
    its_log.propagate = True
    its_log.addFilter(Repeats())


def _prepare(settings: Settings) -> None:
    """The engine leaves SQLite in its slower journal mode; the mode is kept in the file."""
    if (path := sqlite_file(settings.jobs_database)) is not None:
        use_wal(path)


def asked_by() -> dict[str, str]:
    """The request and the trace in which a job is handed over: its log lines and spans say where they come from."""
    request = logs.bound_ids().get("request")
    return tracing.headers() | ({} if request is None else {"request": str(request)})


class Dispatcher:
    """Hands jobs to the engine; connects when it is first used, and again after an error.

    The tables of the engine are made by the first worker: until then `dispatch` raises, the job waits in its row, and
    the worker hands it over when it is there.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._client: DBOSClient | None = None
        self._lock = threading.Lock()

    def _connected(self) -> DBOSClient:
        from dbos import DBOSClient

        with self._lock:
            if self._client is None:
                _prepare(self._settings)
                self._client = DBOSClient(
                    system_database_url=self._settings.jobs_database,
                    application_name=APPLICATION,
                    lazy=True,
                    retry_connection_errors=False,
                )
            return self._client

    def warm(self) -> None:
        """Load the engine's client, so that the first job need not wait for it; what fails is told later."""
        with suppress(Exception):
            self._connected().check_connection()

    def dispatch(self, job: JobRow) -> None:
        """Hand over a job's run; a second time changes nothing.

        Raises
        ------
        Exception
            Whatever the engine's database raises; try again later.
        """
        name = workflow_name(job.kind)
        options: EnqueueOptions = {
            "workflow_name": name,
            "queue_name": queue_of(name),
            "workflow_id": workflow_id(job.id, job.run),
            "priority": job.priority,
            "app_version": VERSION,
        }
        if job.kind in ON_RIG:
            options["queue_partition_key"] = job.rig_id
        self._connected().enqueue(options, job.id, job.run, asked_by())

    def notify(self, delivery_id: str, number: int) -> None:
        """Hand over an attempt, by its number, to send a message to a webhook; a second time changes nothing."""
        self._connected().enqueue(
            {
                "workflow_name": NOTICE,
                "queue_name": queue_of(NOTICE),
                "workflow_id": workflow_id(delivery_id, number),
                "app_version": VERSION,
            },
            delivery_id,
            number,
        )

    def close(self) -> None:
        """Give up the connection."""
        with self._lock:
            if self._client is not None:
                self._client.destroy()
                self._client = None
