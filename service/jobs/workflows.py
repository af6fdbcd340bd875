"""The workflows: which steps a kind of job has. Imported by workers only; the engine finds them by their names.

The order of the steps of a kind may change only together with `service.jobs.engine.VERSION`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dbos import DBOS

from service.jobs import derived, steps
from service.jobs.context import Context
from service.jobs.control import Control
from service.jobs.engine import workflow_name
from service.jobs.steps import Outcome, outcome
from service.storage.tables import JobRow

Work = Callable[[Context, JobRow, Control], dict[str, Any]]


def _step(name: str, work: Work, job_id: str, run: int) -> Outcome:
    return DBOS.run_step({"name": name}, steps.guarded, work, job_id, run)


def _end(job_id: str, run: int, found: Outcome) -> None:
    DBOS.run_step({"name": "finish"}, steps.finish, job_id, run, found)


def _workflow(kind: str) -> Callable[[Callable[[str, int], None]], Callable[[str, int], None]]:
    return DBOS.workflow(name=workflow_name(kind), max_recovery_attempts=None)


@_workflow("identification")
def identification(job_id: str, run: int) -> None:
    """Identify an experiment that is there."""
    _end(job_id, run, _step("identify", _identify_given, job_id, run))


@_workflow("gap")
def gap(job_id: str, run: int) -> None:
    """Diagnose the gap of an experiment that is there."""
    _end(job_id, run, _step("diagnose", _diagnose_given, job_id, run))


def _identify_given(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    return derived.identify(worker, job, control, job.experiment_id or "")


def _diagnose_given(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    return derived.diagnose(worker, job, control, job.experiment_id or "")


def _and(first: Outcome, second: Outcome) -> Outcome:
    """Outcome of two steps: the results of both, the state of the second."""
    return outcome(second["state"], first["result"] | second["result"], second["title"], second["detail"])
