"""Keeps the schedules: submits the checks that are due, and notes those that were missed."""

from __future__ import annotations

import logging
from datetime import datetime, timedelta

from sqlalchemy.orm import Session

from service.access.audit import Action, AuditEvent
from service.errors import ServiceError
from service.health import schedule as cron
from service.storage import audit, jobs, results, rigs, schedules
from service.storage.database import Database, now
from service.storage.tables import ScheduleRow

GRACE = timedelta(minutes=15)
"""So long after its time a check may still begin; later it is missed."""
SCHEDULED_PRIORITY = 7
log = logging.getLogger(__name__)


def keep(database: Database, at: datetime | None = None) -> int:
    """Submit what is due, in one transaction with the note that it was: once, however many workers there are.

    Returns
    -------
    submitted
        How many checks.
    """
    at = at or now()
    with database.read() as session:
        if not schedules.due(session, at, lock=False):
            return 0
    with database.write() as session:
        return sum(_kept(session, row, at) for row in schedules.due(session, at))


def _kept(session: Session, row: ScheduleRow, at: datetime) -> bool:
    assert row.next_at is not None
    due = [row.next_at, *cron.due_runs(row.cron, row.next_at, at, row.timezone)]
    row.next_at = cron.next_run(row.cron, at, row.timezone)
    for time in due[:-1]:
        schedules.record_run(session, row.id, time, schedules.MISSED, detail="the service was down")
    if at - due[-1] > GRACE:
        schedules.record_run(session, row.id, due[-1], schedules.MISSED, detail="the service was down")
        return False
    return _submitted(session, row, due[-1])


def _submitted(session: Session, row: ScheduleRow, due: datetime) -> bool:
    try:
        rig = rigs.active(session, row.rig_id)
        if not rigs.version(session, rig).controller_url:
            raise ServiceError(f"the rig {rig.name!r} has no controller_url")
        baseline = results.baseline(session, rig)
    except ServiceError as error:
        log.warning("schedule %s: no check: %s", row.id, error)
        schedules.record_run(session, row.id, due, schedules.REFUSED, detail=str(error))
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
