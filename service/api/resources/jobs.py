"""Jobs: submitted, listed, watched, cancelled, tried again."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import ConfigDict, Field, WithJsonSchema
from sqlalchemy.orm import Session

from service.access.audit import Action
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.lists import Asked, Listed, OfRig, asked_of
from service.api.once import Answer, once
from service.api.problems import UnprocessableError, documented
from service.api.resources import examples
from service.api.resources.budgets import must_hold_a_check
from service.api.resources.options import OF_A_JOB, checked_options
from service.api.shapes import (
    IdempotencyKey,
    IfNoneMatch,
    JobId,
    Operator,
    Shape,
    Time,
    Viewer,
    Wanted,
)
from service.api.state import Api
from service.errors import ConflictError
from service.jobs.submission import hand_over
from service.storage import jobs, results, rigs
from service.storage.tables import ExperimentRow, JobRow

router = APIRouter(prefix="/api/v1/jobs", tags=["jobs"], route_class=KeyFirst)

Kind = Literal["experiment", "identification", "gap", "health"]
State = Literal["queued", "running", "done", "failed", "cancelled"]


class JobWanted(Wanted):
    """A job to do."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"kind": "experiment", "rig": examples.RIG, "options": {"profile": "quick", "identify": True}},
                {
                    "kind": "experiment",
                    "rig": examples.RIG,
                    "options": {"excitation": "multisine", "profile": {"realisations": 4, "to_hz": 800.0}},
                },
                {"kind": "identification", "rig": examples.RIG, "experiment": examples.EXPERIMENT},
                {"kind": "gap", "rig": examples.RIG, "experiment": examples.EXPERIMENT, "priority": 7},
            ]
        }
    )

    kind: Kind = Field(
        description="experiment: measure the rig, then identify it. identification, gap: work on an experiment that "
        "is there. health: a short experiment, compared with the rig's baseline."
    )
    rig: str = Field(max_length=40, description="Id of the rig.")
    experiment: str | None = Field(None, max_length=40, description="Id of the experiment: identification, gap.")
    options: Annotated[dict[str, Any], WithJsonSchema(OF_A_JOB)] = Field(
        default_factory=dict,
        description="experiment: SteppedSineOptions or MultisineOptions. identification: IdentificationOptions. "
        "health: HealthOptions. gap: none.",
    )
    priority: int = Field(5, ge=1, le=9, description="1 first, 9 last, among the jobs that wait.")


class ProgressShape(Shape):
    """How far a job is."""

    percent: float
    point: int
    points: int
    phase: str
    time_left_s: float | None


class JobErrorShape(Shape):
    """Why a job failed."""

    title: str
    detail: str


class JobShape(Shape):
    """A job."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.JOB,
                    "kind": "experiment",
                    "rig": examples.RIG,
                    "rig_version": 2,
                    "experiment": None,
                    "schedule": None,
                    "options": {"profile": "quick"},
                    "state": "running",
                    "priority": 5,
                    "submitted_by": "lab bench",
                    "created_at": examples.TIME,
                    "started_at": examples.TIME,
                    "ended_at": None,
                    "run": 1,
                    "worker": "w1",
                    "cancel_requested": False,
                    "progress": {"percent": 42.0, "point": 126, "points": 300, "phase": "main", "time_left_s": 180.0},
                    "result": {},
                    "error": None,
                }
            ]
        }
    )

    id: str
    kind: str
    rig: str
    rig_version: int
    experiment: str | None
    schedule: str | None
    options: dict[str, Any]
    state: State
    priority: int
    submitted_by: str
    created_at: Time
    started_at: Time | None
    ended_at: Time | None
    run: int
    """How often it was submitted: a retry is one more."""
    worker: str
    cancel_requested: bool
    progress: ProgressShape
    result: dict[str, str]
    """Ids of what it made so far: experiment, model, gap, health."""
    error: JobErrorShape | None


def shape(job: JobRow) -> JobShape:
    """A job as it is sent."""
    failed = job.state == jobs.FAILED
    return JobShape(
        id=job.id,
        kind=job.kind,
        rig=job.rig_id,
        rig_version=job.rig_version,
        experiment=job.experiment_id,
        schedule=job.schedule_id,
        options=job.options,
        state=job.state,
        priority=job.priority,
        submitted_by=job.submitted_by,
        created_at=job.created_at,
        started_at=job.started_at,
        ended_at=job.ended_at,
        run=job.run,
        worker=job.worker,
        cancel_requested=job.cancel_requested,
        progress=ProgressShape(
            percent=round(job.percent, 2),
            point=job.point,
            points=job.points,
            phase=job.phase,
            time_left_s=None if job.time_left_s is None else round(job.time_left_s, 1),
        ),
        result=job.result,
        error=JobErrorShape(title=job.error_title, detail=job.error_detail) if failed else None,
    )


def tag(job: JobRow) -> str:
    """ETag of a job."""
    return f"{job.id}.{job.changes}"


def check(session: Session, wanted: JobWanted, options: dict[str, Any]) -> int:
    """Version of the rig that a job is for; the options get what is chosen now and stays.

    Raises
    ------
    NotFoundError, ConflictError, UnprocessableError
        The job cannot be done.
    """
    rig = rigs.active(session, wanted.rig)
    version = rigs.version(session, rig)
    if wanted.kind in jobs.ON_RIG:
        if wanted.experiment is not None:
            raise UnprocessableError(f"a job of kind {wanted.kind} measures by itself; leave the field experiment out")
        if not version.controller_url:
            raise ConflictError(f"the rig {rig.name!r} has no controller_url; give it one before it can be measured")
        if wanted.kind == "health":
            options["baseline"] = results.baseline(session, rig).id
    else:
        if wanted.experiment is None:
            raise UnprocessableError(f"a job of kind {wanted.kind} works on an experiment; give the field experiment")
        experiment = results.get(session, ExperimentRow, wanted.experiment)
        if experiment.rig_id != rig.id:
            raise ConflictError(f"the experiment {experiment.id} is of another rig; give one of this rig's")
    return rig.version


@router.post("", status_code=202, response_model=JobShape, responses=documented(404, 409, 413, 415))
def submit_job(
    request: Request, wanted: JobWanted, who: Operator, api: Api, idempotency_key: IdempotencyKey = None
) -> Response:
    """Submit a job; it is done as soon as the rig and a worker are free."""
    options = checked_options(wanted.kind, wanted.options)
    made: list[JobRow] = []

    def must_work() -> None:
        if wanted.kind == "health":
            must_hold_a_check(api, wanted.rig, options)

    def make(session: Session) -> Answer:
        version = check(session, wanted, options)
        job = jobs.submit(
            session,
            wanted.kind,
            wanted.rig,
            version,
            who.name,
            wanted.experiment,
            options,
            wanted.priority,
            key_id=who.key_id,
        )
        audit(session, request, who, Action.job_submitted, job.id, rig=job.rig_id, kind=job.kind)
        made[:] = [job]
        return Answer(202, f"/api/v1/jobs/{job.id}", shape(job).model_dump(mode="json"))

    answer, replayed = once(api.database, who, request, idempotency_key, wanted.model_dump_json(), make, must_work)
    if not replayed:
        hand_over(api.database, api.dispatcher, made[0])
    return answer.response(replayed)


@router.get("", response_model=Listed[JobShape], responses=etags.documented_list())
def list_jobs(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_of("job")],
    state: Annotated[State | None, Query(description="Only in this state.")] = None,
    kind: Annotated[Kind | None, Query(description="Only of this kind.")] = None,
    rig: OfRig = None,
    newest: Annotated[
        bool, Query(description="Only one of each rig, of those in this state and of this kind: which ended last.")
    ] = False,
) -> Response:
    """All jobs, newest first."""
    with api.database.read() as session:
        page = jobs.listed(session, state, kind, rig, asked.after, asked.limit, newest)
    return asked.answer(Listed[JobShape], page, shape)


@router.get("/{job_id}", response_model=JobShape, responses=etags.documented_resource())
def get_job(job_id: JobId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """A job, and how far it is."""
    with api.database.read() as session:
        job = jobs.get(session, job_id)
    return etags.document(shape(job), if_none_match, tag(job))


@router.post("/{job_id}/cancel", status_code=202, response_model=JobShape, responses=documented(404, 409))
def cancel_job(request: Request, job_id: JobId, who: Operator, api: Api) -> JobShape:
    """Cancel a job: the excitation stops within a second, and what was measured is kept."""
    with api.database.write() as session:
        job = jobs.cancel(session, job_id)
        audit(session, request, who, Action.job_cancelled, job.id, rig=job.rig_id)
    return shape(job)


@router.post("/{job_id}/retry", status_code=202, response_model=JobShape, responses=documented(404, 409))
def retry_job(
    request: Request, job_id: JobId, who: Operator, api: Api, idempotency_key: IdempotencyKey = None
) -> Response:
    """Try a job again that failed or was cancelled; an experiment goes on with what it has measured."""
    tried: list[JobRow] = []

    def again(session: Session) -> Answer:
        rigs.active(session, jobs.get(session, job_id).rig_id)
        job = jobs.retry(session, job_id, who.name, who.key_id)
        audit(session, request, who, Action.job_retried, job.id, rig=job.rig_id, run=job.run)
        tried[:] = [job]
        return Answer(202, f"/api/v1/jobs/{job.id}", shape(job).model_dump(mode="json"))

    answer, replayed = once(api.database, who, request, idempotency_key, "", again)
    if not replayed:
        hand_over(api.database, api.dispatcher, tried[0])
    return answer.response(replayed)
