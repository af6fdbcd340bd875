"""The workflows: which steps a kind of job has. Imported by workers only; the engine finds them by their names.

The order of the steps of a kind may change only together with `service.jobs.engine.VERSION`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from dbos import DBOS

from service.jobs import campaigns, checks, derived, lost, notices, steps
from service.jobs.context import Context
from service.jobs.control import Control
from service.jobs.engine import NOTICE, workflow_id, workflow_name
from service.jobs.progress import MEASURING, WHOLE
from service.jobs.steps import Outcome, outcome
from service.storage import jobs
from service.storage.tables import JobRow

Work = Callable[[Context, JobRow, Control], dict[str, Any]]


Asked = dict[str, str]
"""The request that asked for a job, and its trace; a job that was handed over before these were kept has none."""


def _workflow(kind: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A workflow of a kind of job; one that the engine cannot carry on fails its job, whose rig is free then."""

    def registered(work: Callable[..., None]) -> Callable[..., None]:
        @wraps(work)
        def watched(job_id: str, run: int, asked: Asked | None = None) -> None:
            with lost.running(workflow_id(job_id, run)):
                try:
                    work(job_id, run, asked)
                except Exception as error:
                    steps.give_up(job_id, run, error)
                    if kind == "health":
                        notices.begin_failed(job_id, run)
                    raise

        return DBOS.workflow(name=workflow_name(kind), max_recovery_attempts=None)(watched)

    return registered


@_workflow("experiment")
def experiment(job_id: str, run: int, asked: Asked | None = None) -> None:
    """Measure a rig, then identify it unless that is not wanted."""
    found = _step("measure", _measure, job_id, run, asked, campaigns.keep)
    if found["state"] == jobs.DONE:
        made = found["result"]["experiment"]
        found = _and(found, _step("identify", lambda w, j, c: _identify_measured(w, j, c, made), job_id, run, asked))
    _end(job_id, run, found)


@_workflow("identification")
def identification(job_id: str, run: int, asked: Asked | None = None) -> None:
    """Identify an experiment that is there."""
    _end(job_id, run, _step("identify", _identify_given, job_id, run, asked))


@_workflow("gap")
def gap(job_id: str, run: int, asked: Asked | None = None) -> None:
    """Diagnose the gap of an experiment that is there."""
    _end(job_id, run, _step("diagnose", _diagnose_given, job_id, run, asked))


@_workflow("health")
def health(job_id: str, run: int, asked: Asked | None = None) -> None:
    """A short experiment, compared with the rig's baseline; whoever wants to know is told."""
    found = _step("measure", checks.measure, job_id, run, asked, campaigns.keep)
    if found["state"] == jobs.DONE:
        made = found["result"]["experiment"]
        found = _and(found, _step("compare", lambda w, j, c: checks.compare(w, j, c, made), job_id, run, asked))
    _end(job_id, run, found)
    if found["state"] == jobs.DONE:
        DBOS.run_step({"name": "notify"}, notices.begin, found["result"]["health"])
    elif found["state"] == jobs.FAILED:
        DBOS.run_step({"name": "notify"}, notices.begin_failed, job_id, run)


@DBOS.workflow(name=NOTICE, max_recovery_attempts=None)
def notice(delivery_id: str, number: int | None = None) -> None:
    """Tell a webhook once; when it is told again is in the message's row, and no thread waits for it.

    An earlier version's has no number, and waited here: its row says by now when the message is sent.
    """
    if number is None:
        return
    with lost.running(workflow_id(delivery_id, number)):
        try:
            DBOS.run_step({"name": "send"}, notices.attempt, delivery_id, number)
        except Exception as error:
            notices.not_made(delivery_id, number, error)
            raise


def _step(
    name: str,
    work: Work,
    job_id: str,
    run: int,
    asked: Asked | None,
    keep: Callable[[Context, JobRow, Control], None] | None = None,
) -> Outcome:
    return DBOS.run_step({"name": name}, steps.guarded, work, job_id, run, asked, keep)


def _end(job_id: str, run: int, found: Outcome) -> None:
    DBOS.run_step({"name": "finish"}, steps.finish, job_id, run, found)


def _and(first: Outcome, second: Outcome) -> Outcome:
    """Outcome of two steps: the results of both, the state of the second."""
    return outcome(second["state"], first["result"] | second["result"], second["title"], second["detail"])


def _measure(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    share = MEASURING if job.options.get("identify", True) else WHOLE
    return campaigns.measure(worker, job, control, campaigns.profile_of(job.options), share)


def _identify_measured(worker: Context, job: JobRow, control: Control, experiment_id: str) -> dict[str, Any]:
    if not job.options.get("identify", True):
        return {}
    return derived.identify(worker, job, control, experiment_id)


def _identify_given(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    return derived.identify(worker, job, control, job.experiment_id or "")


def _diagnose_given(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    return derived.diagnose(worker, job, control, job.experiment_id or "")
