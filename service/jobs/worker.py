"""A worker: takes jobs from the queues until it is told to end."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta
from importlib import import_module
from types import FrameType

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service import tracing
from service.config import Settings
from service.errors import ConfigurationError, ConflictError
from service.jobs import notices, steps, submission, timetable
from service.jobs.calculator import Calculator
from service.jobs.context import Context, use
from service.jobs.engine import (
    CPU,
    MOST_AT_ONCE,
    NOTICES,
    RIGS,
    Dispatcher,
    engine_config,
    poll_s,
    quieten,
    share_polls,
    shared_s,
)
from service.jobs.lost import Watch
from service.jobs.outage import Outage
from service.private import make_folders
from service.storage import idempotency, jobs, workers
from service.storage.blobs import Blobs
from service.storage.database import Database, now
from service.storage.ids import new_id
from service.storage.migrate import upgrade
from service.storage.tables import JobRow

log = logging.getLogger(__name__)

BEAT_S = 2.0
LOST_S = 5.0
"""How often a worker looks for workflows of its own that have died."""
GRACE_S = 10.0
"""Time that rigs have to stop when the worker ends."""
KEPT = timedelta(days=30)
"""So long a job that failed or was cancelled can go on where it stopped."""
PASSING = timedelta(days=1)
"""No upload or export takes so long: an older folder is of a process that was killed."""
_NAME_PATIENCE_S = workers.ALIVE_S + 1.0


class Worker:
    """One worker of this process.

    Parameters
    ----------
    settings
        ``worker_name`` must be stable, and unique among the workers of a database.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.instance = new_id("wrk")
        self.context = Context(
            settings, Database(settings.database), Blobs(settings.store), Calculator(), Dispatcher(settings)
        )
        self._lost_name = False
        self._shared_by = 1
        self._believes_silence_at = 0.0

    def start(self) -> None:
        """Take the name, start the engine, and go on with what an earlier process of this name left.

        Raises
        ------
        ConflictError
            A worker of this name is alive.
        ConfigurationError
            A worker of another machine is alive, and nobody has said where both keep their files.
        StorageError
            A database or the store cannot be used.
        """
        from dbos import DBOS

        make_folders(self.settings)
        upgrade(self.context.database)
        self.context.blobs.check()
        self._sign_on()
        use(self.context)
        import_module("service.jobs.workflows")  # registers them
        quieten(DBOS(config=engine_config(self.settings)))
        DBOS.launch()
        most = MOST_AT_ONCE | {CPU: self.settings.cpu_jobs}
        one_job_per_rig = {RIGS: 1}
        for name in (RIGS, CPU, NOTICES):
            DBOS.register_queue(
                name,
                worker_concurrency=most[name],
                partition_concurrency=one_job_per_rig.get(name),
                polling_interval_sec=poll_s(name, 1),
            )
        self.context.calculator.warm()
        log.info("worker %s is ready", self.settings.worker)

    def _sign_on(self) -> None:
        """Take the name; one that was just killed on another machine is waited for."""
        deadline = time.monotonic() + _NAME_PATIENCE_S
        while True:
            try:
                with self.context.database.write() as session:
                    self._must_share_its_store(session)
                    workers.sign_on(session, self.settings.worker, self.instance)
                return
            except ConflictError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.25)

    def _must_share_its_store(self, session: Session) -> None:
        if self.settings.store_of_this_machine and (other := workers.elsewhere(session)) is not None:
            raise ConfigurationError(
                f"the worker {other.name!r} runs on {other.machine}, and without store_url each machine keeps files "
                "that the other one cannot read; set AMBIT_STORE_URL to one store that all of them reach"
            )

    def run(self) -> None:
        """Work until `Context.stopping` is set; then stop the rigs and leave the jobs to the next worker."""
        chores: list[tuple[float, bool, Callable[[], None]]] = [  # period, whether the workers share it
            (self.beat_s(), False, self._beat),
            (1.0, True, self._hand_over),
            (1.0, True, self._keep_schedules),
            (min(5.0, self.settings.worker_timeout_s / 3), False, self._take_over),
            (LOST_S, False, Watch(self.context).settle),
            (3600.0, False, self._tidy),
        ]
        due = [time.monotonic()] * len(chores)
        outages = [Outage(log) for _ in chores]
        while not self.context.stopping.wait(max(0.0, min(due) - time.monotonic())):
            for k, (period, shared, chore) in enumerate(chores):
                if time.monotonic() >= due[k]:
                    due[k] = time.monotonic() + (shared_s(period, self._shared_by) if shared else period)
                    try:
                        chore()
                    except SQLAlchemyError as error:
                        outages[k].away(error)
                        self._believes_silence_at = time.monotonic() + self.settings.worker_timeout_s
                    except Exception:
                        log.exception("a chore of the worker failed")
                    else:
                        outages[k].over()
        self._end()

    def beat_s(self) -> float:
        """Time between signs of life: three at least before the others take a silent worker's jobs."""
        return min(BEAT_S, self.settings.worker_timeout_s / 3)

    def _beat(self) -> None:
        """Give a sign of life, and notice in the same transaction how many others do."""
        with self.context.database.write() as session:
            mine = workers.beat(session, self.settings.worker, self.instance)
            alive = workers.count_alive(session)
        if not mine:
            log.error("another process has the name %s: this one ends", self.settings.worker)
            self._lost_name = True
            self.context.stopping.set()
        elif alive != self._shared_by:  # whoever comes or goes is noticed by all
            share_polls(alive)
            self._shared_by = alive

    def _hand_over(self) -> None:
        submission.hand_over_all(self.context.database, self.context.dispatcher)
        notices.hand_over_all(self.context.database, self.context.dispatcher)

    def _keep_schedules(self) -> None:
        timetable.keep(self.context.database, self.settings)

    def _take_over(self) -> None:
        """Give the jobs of workers that are silent back to the queue.

        After the database was away everyone was silent: those that live have time to say so first.
        """
        from dbos import DBOS

        if time.monotonic() < self._believes_silence_at:
            return
        with self.context.database.read() as session:
            silent = workers.silent(session, self.settings.worker_timeout_s)
        silent = [name for name in silent if name != self.settings.worker]
        if silent:
            for handle in DBOS._recover_pending_workflows(silent):
                log.warning("taking over %s of a silent worker", handle.workflow_id)

    def _tidy(self) -> None:
        """Forget answers that nobody asks for again, the work of jobs that nobody tries again, and broken uploads."""
        for kind in ("uploads", "exports"):
            for folder in (self.settings.work / kind).glob("*"):
                with suppress(FileNotFoundError):  # its request has just ended
                    if time.time() - folder.stat().st_mtime > PASSING.total_seconds():
                        shutil.rmtree(folder, ignore_errors=True)
        with self.context.database.write() as session:
            idempotency.forget_old(session)
            for folder in self.settings.work.glob("job_*"):
                job = session.get(JobRow, folder.name)
                if job is None or (job.ended_at is not None and now() - job.ended_at > KEPT):
                    jobs.drop_journal(session, folder.name)
                    shutil.rmtree(folder, ignore_errors=True)
        self.context.blobs.tidy(PASSING)

    def _end(self) -> None:
        """Leave: rigs are stopped by their steps, which see `stopping`; then nothing is excited any more."""
        deadline = time.monotonic() + GRACE_S
        while steps.under_way() and time.monotonic() < deadline:
            time.sleep(0.05)
        with suppress(SQLAlchemyError):
            if not self._lost_name:
                with self.context.database.write() as session:
                    workers.sign_off(session, self.settings.worker, self.instance)
        self.context.calculator.close()


def serve(settings: Settings, end_with_stdin: bool = False) -> None:
    """Be a worker until SIGTERM or SIGINT; never returns.

    Parameters
    ----------
    end_with_stdin
        End when stdin closes too: the process that started this one is gone.
    """
    worker = Worker(settings)

    def stop(number: int, frame: FrameType | None) -> None:
        worker.context.stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    worker.start()
    print(f"worker {settings.worker} is ready", flush=True)
    if end_with_stdin:
        threading.Thread(target=_wait_for_end, args=(worker,), daemon=True).start()
    worker.run()
    tracing.end()
    os._exit(0)  # the engine must not hear that parked steps end


def _wait_for_end(worker: Worker) -> None:
    with suppress(OSError):
        while os.read(0, 1024):
            pass
    worker.context.stopping.set()
