"""Keeps the schedules: submits the checks that are due, and notes those that were missed."""

from __future__ import annotations

import logging
from datetime import datetime, timedelta

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service.access.audit import Action, AuditEvent
from service.config import Settings
from service.errors import ServiceError
from service.health import schedule as cron
from service.health import webhook
from service.health.schedule import ScheduleError
from service.storage import audit, jobs, results, rigs, schedules
from service.storage.database import Database, now
from service.storage.ids import derived_id, new_id
from service.storage.tables import ScheduleRow

GRACE = timedelta(minutes=15)
"""So long after its time a check may still begin; later it is missed."""
ELSEWHERE = timedelta(seconds=30)
"""So long a schedule that this machine cannot read is left to a worker of another one, which may know its time zone."""
SCHEDULED_PRIORITY = 7
log = logging.getLogger(__name__)


def keep(database: Database, settings: Settings, at: datetime | None = None) -> int:
    """Submit what is due, in one transaction with the note that it was: once, however many workers there are.

    What is not submitted is noted too, with the message that tells the schedule's webhook of it. A schedule that cannot
    be kept keeps no other one back.

    Returns
    -------
    submitted
        How many checks.
    """
    at = at or now()
    with database.read() as session:
        if not any(_asks_for_something(session, row, at) for row in schedules.due(session, at, lock=False)):
            return 0
    with database.write() as session:
        return sum(_kept_alone(session, settings, row, at) for row in schedules.due(session, at))


def _times(row: ScheduleRow, at: datetime) -> tuple[list[datetime], datetime]:
    """At which a schedule was due since it was last kept, and the next one.

    Raises
    ------
    ScheduleError
        This machine cannot read it, as where it does not know the time zone.
    """
    assert row.next_at is not None
    due = [row.next_at, *cron.due_runs(row.cron, row.next_at, at, row.timezone)]
    return due, cron.next_run(row.cron, at, row.timezone)


def _asks_for_something(session: Session, row: ScheduleRow, at: datetime) -> bool:
    """Whether there is anything to do about a schedule that is due: not about one that cannot be read, which was told.

    It stays due, so that no time of it is made up, until a machine can read it or somebody gives it another zone.
    """
    try:
        _times(row, at)
    except ScheduleError:
        assert row.next_at is not None
        return at - row.next_at > ELSEWHERE and schedules.run_of(session, row.id, row.next_at) is None
    return True


def _kept_alone(session: Session, settings: Settings, row: ScheduleRow, at: datetime) -> bool:
    """Keep one schedule; a defect in it is undone, and the others are kept."""
    schedule_id = row.id
    try:
        with session.begin_nested():
            return _asks_for_something(session, row, at) and _kept(session, settings, row, at)
    except SQLAlchemyError:
        raise
    except Exception:
        log.exception("schedule %s cannot be kept", schedule_id)
        return False


def _kept(session: Session, settings: Settings, row: ScheduleRow, at: datetime) -> bool:
    assert row.next_at is not None
    try:
        due, following = _times(row, at)
    except ScheduleError as error:
        why = f"{settings.worker} cannot tell when it is due: {error}"
        log.warning("schedule %s: no check: %s", row.id, why)
        _not_made(session, settings, row, [row.next_at], schedules.REFUSED, why)
        return False
    why = "the service was down"
    if (told := schedules.run_of(session, row.id, due[0])) is not None:  # nobody could read the schedule since
        why, due = told.detail, due[1:]
    row.next_at = following
    if not due:
        return False
    too_late = at - due[-1] > GRACE
    if missed := due if too_late else due[:-1]:
        _not_made(session, settings, row, missed, schedules.MISSED, why)
    return not too_late and _submitted(session, settings, row, due[-1])


def _not_made(
    session: Session,
    settings: Settings,
    row: ScheduleRow,
    due: list[datetime],
    state: str,
    why: str,
    message_id: str | None = None,
) -> None:
    """Note checks that are not made, and tell the webhook; of each ``message_id`` once."""
    for time in due:
        schedules.record_run(session, row.id, time, state, detail=why)
    rig = rigs.get(session, row.rig_id)
    url = settings.link(f"/schedules/{row.id}/runs")
    contents = webhook.missed_payload(row.id, rig.id, rig.name, due[-1], len(due), why, now(), url)
    schedules.add_delivery(session, row, message_id or new_id("whd"), contents)


def _submitted(session: Session, settings: Settings, row: ScheduleRow, due: datetime) -> bool:
    if (before := jobs.unfinished_of(session, row.id)) is not None:
        why = f"the check before it, {before.id}, has not ended: {before.phase or before.state}"
        log.warning("schedule %s: no check: %s", row.id, why)
        _not_made(session, settings, row, [due], schedules.MISSED, why, f"{derived_id('whd', before.id)}m")
        return False
    try:
        rig = rigs.active(session, row.rig_id)
        if not rigs.version(session, rig).controller_url:
            raise ServiceError(f"the rig {rig.name!r} has no controller_url")
        baseline = results.baseline(session, rig)
    except ServiceError as error:
        log.warning("schedule %s: no check: %s", row.id, error)
        _not_made(session, settings, row, [due], schedules.REFUSED, str(error))
        return False
    by, key = f"schedule {row.id}", f"schedule:{row.id}"
    job = jobs.submit(
        session,
        "health",
        rig.id,
        rig.version,
        by,
        options={**row.options, "baseline": baseline.id},
        priority=SCHEDULED_PRIORITY,
        schedule_id=row.id,
        key_id=key,
    )
    audit.record(session, AuditEvent(Action.job_submitted, key, by, job.id, rig.id, {"kind": job.kind}))
    schedules.record_run(session, row.id, due, schedules.SUBMITTED, job.id)
    return True
