"""What a step of a workflow is: claims the job, does its part, and answers in plain values.

A step may run more than once: after a crash it is repeated. What it makes has names that follow from the job's, so that
made twice it is the same.
"""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service import logs, tracing
from service.errors import JobError, StoppedError
from service.jobs.context import Context, context
from service.jobs.control import POLL_S, UNHURRIED_POLL_S, Control
from service.storage import jobs, results, rigs
from service.storage.tables import ExperimentRow, JobRow, RigVersion
from sim.errors import AmbError, reason

log = logging.getLogger(__name__)

Outcome = dict[str, Any]
"""``{"state": "done", "result": {...}}``, or failed with a title and a detail, or cancelled. What a job has made so far
is in ``result`` whatever the state."""

_counts = {"begun": 0, "parked": 0}
_counting = threading.Lock()
_at_work: set[str] = set()
"""Jobs at which this process works."""
EARLIER = "waiting for the earlier attempt at this job to end"


def outcome(state: str, result: dict[str, Any], title: str = "", detail: str = "") -> Outcome:
    """An outcome."""
    return {"state": state, "result": result, "title": title, "detail": detail}


def guarded(
    work: Callable[[Context, JobRow, Control], dict[str, Any]],
    job_id: str,
    run: int,
    asked: dict[str, str] | None = None,
    keep: Callable[[Context, JobRow, Control], None] | None = None,
) -> Outcome:
    """Run a part of a job under its control; what it returns is the result.

    Parameters
    ----------
    asked
        The id of the request that handed the job over, and the ``traceparent`` of its span.
    keep
        Keeps what the job has measured, in this process or in one that died, where the part does not come to its end
        or not even to its beginning. It raises nothing: why the job ended is the one thing to tell.
    """
    _count("begun", 1)
    try:
        return _guarded(work, job_id, run, asked or {}, keep)
    finally:
        _count("begun", -1)


def _guarded(
    work: Callable[[Context, JobRow, Control], dict[str, Any]],
    job_id: str,
    run: int,
    asked: dict[str, str],
    keep: Callable[[Context, JobRow, Control], None] | None,
) -> Outcome:
    worker = context()
    if worker.stopping.is_set():
        park(job_id)
    job = worker.database.surely(lambda session: jobs.claim(session, job_id, run, worker.settings.worker))
    if job is None:  # cancelled before it began
        return outcome(jobs.CANCELLED, {})
    journal = worker.folder(job_id) / "experiment.journal"
    period_s = POLL_S if job.kind in jobs.ON_RIG else UNHURRIED_POLL_S
    with (
        logs.bound(job=job_id, rig=job.rig_id, request=asked.get("request")),
        tracing.span(f"job.{job.kind}", asked, job=job_id, rig=job.rig_id, attempt=job.run),
        Control(worker, job_id, job.attempt, journal, period_s) as control,
    ):
        log.info("a step of the %s begins, attempt %d", job.kind, job.run)
        try:
            if job.cancel_requested:
                raise StoppedError("the job was cancelled while nobody worked on it")
            with _alone(job_id, control):
                found = outcome(jobs.DONE, work(worker, job, control))
        except StoppedError:
            found = outcome(jobs.CANCELLED, control.result)
        except JobError as error:
            found = outcome(jobs.FAILED, control.result, error.title, str(error))
        except AmbError as error:
            found = outcome(jobs.FAILED, control.result, _title(error), str(error))
        except OSError as error:
            log.exception("job %s met an error of this machine", job_id)
            file = f" {error.filename}" if error.filename else ""
            detail = f"{worker.settings.worker} cannot use{file}: {reason(error)}; see to its disk, then try again"
            found = outcome(jobs.FAILED, control.result, "error of the worker's machine", detail)
        except Exception as error:
            log.exception("job %s met a defect", job_id)
            detail = f"{type(error).__name__}: {error}; report it with the worker's log"
            found = outcome(jobs.FAILED, control.result, "defect of the service", detail)
        if found["state"] != jobs.DONE and keep is not None and not (control.stopping or control.superseded):
            keep(worker, job, control)
            found["result"] = control.result
        log.info("the step ends: %s", " ".join([found["state"], found["title"], found["detail"]]).strip())
    if found["state"] != jobs.DONE and (control.stopping or control.superseded):
        park(job_id)
    return found


@contextmanager
def _alone(job_id: str, control: Control) -> Iterator[None]:
    """While this process does nothing else for the job.

    It may be given a job at which it works already: another worker took it for dead. The earlier attempt has been
    superseded, and ends as soon as it notices; two at a time would excite one rig under one name.
    """
    while not _taken(job_id):
        control.report(phase=EARLIER)
        if control.stopped():
            raise StoppedError("the job was stopped before it went on")
        time.sleep(POLL_S)
    try:
        yield
    finally:
        with _counting:
            _at_work.discard(job_id)


def _taken(job_id: str) -> bool:
    with _counting:
        if job_id in _at_work:
            return False
        _at_work.add(job_id)
        return True


def park(job_id: str) -> None:
    """Never come back: the worker ends, or another one has the job. The engine must hear nothing from here."""
    log.info("job %s is left to the next worker", job_id)
    _count("parked", 1)
    threading.Event().wait()


def under_way() -> int:
    """How many steps run and are not parked."""
    with _counting:
        return _counts["begun"] - _counts["parked"]


def _count(name: str, by: int) -> None:
    with _counting:
        _counts[name] += by


def _title(error: AmbError) -> str:
    """A few words from the class: BusError is "bus error"."""
    words = "".join(f" {c.lower()}" if c.isupper() else c for c in type(error).__name__)
    return words.strip()


def datasheet_file(worker: Context, job: JobRow) -> tuple[RigVersion, Path]:
    """The version of the rig that the job is for, and its datasheet as a file."""
    with worker.database.read() as session:
        version = rigs.version(session, rigs.get(session, job.rig_id), job.rig_version)
    path = worker.folder(job.id) / "rig.toml"
    path.write_text(version.datasheet, encoding="utf-8")
    return version, path


def experiment_file(worker: Context, job: JobRow, experiment_id: str) -> tuple[ExperimentRow, Path]:
    """An experiment, and its file on this machine."""
    with worker.database.read() as session:
        row = results.get(session, ExperimentRow, experiment_id)
    suffix = Path(row.file_name).suffix or ".h5"
    path = worker.folder(job.id) / f"{experiment_id}{suffix}"
    if not path.exists():
        worker.blobs.fetch(row.file_sha256, path)
    return row, path


def finish(job_id: str, run: int, found: Outcome) -> None:
    """Write the end of a job to its row, with what any run of it has made, and drop its work in progress."""
    worker = context()

    def write(session: Session) -> None:
        made = results.made_by(session, job_id) | found["result"]
        jobs.finish(session, job_id, run, found["state"], made, found["title"], found["detail"])
        if found["state"] == jobs.DONE:
            jobs.drop_journal(session, job_id)

    worker.database.surely(write)
    if found["state"] == jobs.DONE:  # what failed or was cancelled may be tried again
        shutil.rmtree(worker.folder(job_id), ignore_errors=True)


def give_up(job_id: str, run: int, error: Exception) -> None:
    """Fail a job whose workflow the engine could not carry on; what it has made is kept, and it can be tried again.

    One that waits yet is its own as well: the engine failed before it was claimed. A job of which another worker or
    another run has begun is left to it.
    """
    worker = context()
    log.error("job %s: the job engine failed", job_id, exc_info=error)
    why = (str(error).splitlines() or [type(error).__name__])[0]
    detail = f"{worker.settings.worker} cannot write down a step: {why}; see to its disk and database, then try again"

    def write(session: Session) -> None:
        job = jobs.get(session, job_id)
        if job.state == jobs.QUEUED or job.worker == worker.settings.worker:
            state, title = (jobs.CANCELLED, "") if job.cancel_requested else (jobs.FAILED, "job engine failed")
            given = {} if job.experiment_id is None else {"experiment": job.experiment_id}
            made = given | results.made_by(session, job_id)
            jobs.finish(session, job_id, run, state, made, title, detail if title else "")

    _count("begun", 1)
    try:
        worker.database.surely(write, worker.stopping.is_set)
    except SQLAlchemyError:
        if not worker.stopping.is_set():
            raise
        park(job_id)  # the next worker repeats the step
    finally:
        _count("begun", -1)
