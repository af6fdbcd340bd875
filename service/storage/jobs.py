"""Jobs as their owners see them. Only the last worker that began with a job may write to it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy import ColumnElement, CursorResult, case, delete, func, literal, select, update
from sqlalchemy.orm import Session

from service.errors import ConflictError
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.listing import Page, page, row
from service.storage.tables import JobRow, JournalPart, RigVersion

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
STATES = (QUEUED, RUNNING, DONE, FAILED, CANCELLED)
ENDED = (DONE, FAILED, CANCELLED)
ON_RIG = ("experiment", "health")
"""Kinds that move a rotor."""
KINDS = ("experiment", "identification", "gap", "health")
_CANCELLED_AS = f"{CANCELLED}: "


def cancelled_as(why: str) -> str:
    """Phase of a job that was cancelled for a reason."""
    return f"{_CANCELLED_AS}{why}"


def submit(
    session: Session,
    kind: str,
    rig_id: str,
    rig_version: int,
    by: str,
    experiment_id: str | None = None,
    options: Mapping[str, Any] | None = None,
    priority: int = 5,
    schedule_id: str | None = None,
    key_id: str = "",
) -> JobRow:
    """A new job, queued; the engine is told of it once this is committed.

    Parameters
    ----------
    by, key_id
        Name of whoever wants it, and what tells it from others of that name: its key, "local", "schedule:<id>".
    """
    job = JobRow(
        id=new_id("job"),
        kind=kind,
        rig_id=rig_id,
        rig_version=rig_version,
        experiment_id=experiment_id,
        schedule_id=schedule_id,
        options=dict(options or {}),
        priority=priority,
        state=QUEUED,
        submitted_by=by,
        requested_by=by,
        requested_key=key_id,
        created_at=now(),
        result={},
    )
    session.add(job)
    session.flush()
    return job


def get(session: Session, job_id: str) -> JobRow:
    """A job.

    Raises
    ------
    NotFoundError
        There is none of that id.
    """
    return row(session, JobRow, job_id, "job", "with ambit jobs, or at /api/v1/jobs")


def listed(
    session: Session,
    state: str | None = None,
    kind: str | None = None,
    rig_id: str | None = None,
    after: str | None = None,
    limit: int = 100,
    newest: bool = False,
) -> Page[JobRow]:
    """A page of jobs; with ``newest`` of those that are asked for only one of each rig, which ended last.

    One that has not ended comes before those that have. When a job was submitted says nothing: it may be tried again.
    """
    wanted = ((JobRow.state, state), (JobRow.kind, kind), (JobRow.rig_id, rig_id))
    conditions: list[ColumnElement[bool]] = [column == value for column, value in wanted if value is not None]
    if newest:
        latest = (JobRow.ended_at.is_not(None), JobRow.ended_at.desc(), JobRow.id.desc())
        place = func.row_number().over(partition_by=JobRow.rig_id, order_by=latest)
        placed = select(JobRow.id, place.label("place")).where(*conditions).subquery()
        conditions.append(JobRow.id.in_(select(placed.c.id).where(placed.c.place == 1)))
    return page(session, JobRow, *conditions, after=after, limit=limit)


def unfinished_of(session: Session, schedule_id: str) -> JobRow | None:
    """The job of a schedule that has not ended, if there is one."""
    query = select(JobRow).where(JobRow.state.in_((QUEUED, RUNNING)), JobRow.schedule_id == schedule_id).limit(1)
    return session.scalar(query)


def counts(session: Session) -> dict[str, int]:
    """Number of jobs by state."""
    found = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state))
    return dict.fromkeys(STATES, 0) | {row[0]: row[1] for row in found}


def cancel(session: Session, job_id: str) -> JobRow:
    """Cancel a job: a queued one at once, a running one by asking its worker.

    Raises
    ------
    NotFoundError
        There is none of that id.
    ConflictError
        It has ended.
    """
    at = now()
    job = get(session, job_id)
    changed = session.execute(
        update(JobRow)
        .where(JobRow.id == job_id, JobRow.state == QUEUED)
        .values(state=CANCELLED, cancel_requested=True, ended_at=at, phase="cancelled", changes=JobRow.changes + 1)
    )
    if not _rows(changed):
        changed = session.execute(
            update(JobRow)
            .where(JobRow.id == job_id, JobRow.state.in_((QUEUED, RUNNING)))
            .values(cancel_requested=True, changes=JobRow.changes + 1)
        )
    session.refresh(job)
    if not _rows(changed) and job.state != CANCELLED:
        raise ConflictError(f"the job {job_id} is {job.state} already; there is nothing to cancel")
    return job


def cancel_of_rig(session: Session, rig_id: str, why: str) -> list[JobRow]:
    """Cancel the jobs of a rig that wait, and ask those to end that move its rotor; calculations under way go on.

    Parameters
    ----------
    why
        What whoever watches a job is told, a waiting one at once, one under way once it has ended.
    """
    return _cancel_all(
        session,
        (JobRow.rig_id == rig_id) & ((JobRow.state == QUEUED) | (JobRow.state == RUNNING) & JobRow.kind.in_(ON_RIG)),
        why,
    )


def cancel_moving(session: Session, rig_id: str, why: str, but: Collection[str] = ()) -> list[JobRow]:
    """Cancel the jobs of a rig that would move its rotor, and ask those to end that do, except the ones in ``but``."""
    return _cancel_all(session, _moving(rig_id) & JobRow.id.not_in(but), why)


def moving(session: Session, rig_id: str) -> list[str]:
    """Ids of the jobs of a rig that move its rotor or wait to do so."""
    return list(session.scalars(select(JobRow.id).where(_moving(rig_id))))


def controllers_moving(session: Session, rig_id: str) -> list[str]:
    """URLs by which the jobs of a rig that have not ended move its rotor: those of the versions that they are of."""
    of_job = (RigVersion.rig_id == JobRow.rig_id) & (RigVersion.version == JobRow.rig_version)
    return list(
        session.scalars(select(RigVersion.controller_url).join(JobRow, of_job).where(_moving(rig_id)).distinct())
    )


def _moving(rig_id: str) -> ColumnElement[bool]:
    return (JobRow.rig_id == rig_id) & JobRow.state.in_((QUEUED, RUNNING)) & JobRow.kind.in_(ON_RIG)


def _cancel_all(session: Session, which: ColumnElement[bool], why: str) -> list[JobRow]:
    """Cancel jobs, and say why to those that nobody had asked to end yet."""
    wanted = select(JobRow.id, JobRow.cancel_requested).where(which).order_by(JobRow.id).with_for_update()
    found = []
    for job_id, asked_before in session.execute(wanted).all():
        job = cancel(session, job_id)
        if job.state == CANCELLED:
            job.phase = cancelled_as(why)
        elif not asked_before:
            job.error_detail = why
        found.append(job)
    return found


def retry(session: Session, job_id: str, by: str, key_id: str = "") -> JobRow:
    """Queue a job again that failed or was cancelled; an experiment goes on with what it has measured.

    Parameters
    ----------
    by, key_id
        Who wants that, as in `submit`: from now on it is their doing.

    Raises
    ------
    NotFoundError
        There is none of that id.
    ConflictError
        It has not failed and was not cancelled.
    """
    job = get(session, job_id)
    changed = session.execute(
        update(JobRow)
        .where(JobRow.id == job_id, JobRow.state.in_((FAILED, CANCELLED)))
        .values(
            state=QUEUED,
            run=JobRow.run + 1,
            requested_by=by,
            requested_key=key_id,
            worker="",
            cancel_requested=False,
            started_at=None,
            ended_at=None,
            phase="",
            time_left_s=None,
            error_title="",
            error_detail="",
            changes=JobRow.changes + 1,
        )
    )
    session.refresh(job)
    if not _rows(changed):
        raise ConflictError(f"the job {job_id} is {job.state}; only what failed or was cancelled can be tried again")
    return job


def dispatched(session: Session, job_id: str, run: int) -> None:
    """Note that the engine knows of a run."""
    session.execute(update(JobRow).where(JobRow.id == job_id, JobRow.run == run).values(dispatched_run=run))


def undispatched(session: Session, limit: int = 200) -> list[JobRow]:
    """Queued jobs that the engine was not told of: whoever took them was stopped in between."""
    query = (
        select(JobRow)
        .where(JobRow.state == QUEUED, JobRow.dispatched_run < JobRow.run)
        .order_by(JobRow.id)
        .limit(limit)
    )
    return list(session.scalars(query))


def claim(session: Session, job_id: str, run: int, worker: str) -> JobRow | None:
    """Begin with a job, or go on with it; None when it has ended, or was retried since.

    From now on only who holds this ``attempt`` writes to it.
    """
    session.execute(
        update(JobRow)
        .where(JobRow.id == job_id, JobRow.run == run, JobRow.state.in_((QUEUED, RUNNING)))
        .values(
            state=RUNNING,
            attempt=JobRow.attempt + 1,
            worker=worker,
            started_at=func.coalesce(JobRow.started_at, now()),
            changes=JobRow.changes + 1,
        )
    )
    job = get(session, job_id)
    session.refresh(job)
    return job if job.run == run and job.state == RUNNING else None


def note(session: Session, job_id: str, attempt: int, **values: Any) -> tuple[bool, bool]:
    """Write to a running job; an empty note only asks.

    Returns
    -------
    mine, cancelled
        Whether this attempt is still the one, and whether it shall end.
    """
    if values:
        mine = update(JobRow).where(JobRow.id == job_id, JobRow.attempt == attempt, JobRow.state == RUNNING)
        written = mine.values(**values, changes=JobRow.changes + 1).returning(JobRow.cancel_requested)
        cancelled = session.execute(written).scalar_one_or_none()
        return cancelled is not None, cancelled is None or cancelled
    found = session.execute(
        select(JobRow.attempt, JobRow.state, JobRow.cancel_requested).where(JobRow.id == job_id)
    ).one_or_none()
    if found is None:
        return False, True
    return found.attempt == attempt and found.state == RUNNING, bool(found.cancel_requested)


def finish(
    session: Session, job_id: str, run: int, state: str, result: dict[str, Any], title: str = "", detail: str = ""
) -> None:
    """The end of a run; a second time changes nothing. What was asked to end for a reason is cancelled with it."""
    values: dict[str, Any] = {"percent": 100.0, "time_left_s": 0.0} if state == DONE else {"time_left_s": None}
    why = JobRow.error_detail
    phase = case((why != "", literal(_CANCELLED_AS) + why), else_=CANCELLED) if state == CANCELLED else state
    session.execute(
        update(JobRow)
        .where(JobRow.id == job_id, JobRow.run == run, JobRow.state.in_((QUEUED, RUNNING)))
        .values(
            state=state,
            result=result,
            error_title=title,
            error_detail=detail,
            ended_at=now(),
            phase=phase,
            changes=JobRow.changes + 1,
            **values,
        )
    )


def add_journal(session: Session, job_id: str, attempt: int, offset: int, content: bytes) -> bool:
    """Keep a piece of a campaign's journal; False when another worker has the job now.

    What was kept from there on goes: it is of another machine's journal, which this one does not continue.
    """
    mine, _ = note(session, job_id, attempt)
    if mine:
        session.execute(delete(JournalPart).where(JournalPart.job_id == job_id, JournalPart.offset >= offset))
        session.add(JournalPart(job_id=job_id, offset=offset, content=content))
    return mine


def journal(session: Session, job_id: str) -> bytes:
    """The journal so far, as far as it has no gap."""
    whole = bytearray()
    parts = select(JournalPart).where(JournalPart.job_id == job_id).order_by(JournalPart.offset)
    for part in session.scalars(parts):
        if part.offset > len(whole):
            break
        whole[part.offset :] = part.content
    return bytes(whole)


def drop_journal(session: Session, job_id: str) -> None:
    """Forget a journal: its experiment is whole, or another journal begins in its place."""
    session.execute(delete(JournalPart).where(JournalPart.job_id == job_id))


def _rows(result: Any) -> int:
    assert isinstance(result, CursorResult)
    return result.rowcount
