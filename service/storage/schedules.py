"""Schedules of health checks, the times at which they were due, and what their webhooks were told."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from service.errors import NotFoundError
from service.storage.database import now
from service.storage.listing import Page, microseconds, moment, page
from service.storage.tables import ScheduleRow, ScheduleRunRow, WebhookRow

SUBMITTED, MISSED, REFUSED = "submitted", "missed", "refused"
PENDING, DELIVERED, FAILED = "pending", "delivered", "failed"
"""States of a message to a webhook."""
REMOVED = "the webhook was removed"
SCHEDULE_REMOVED = "the schedule was removed"


def get(session: Session, schedule_id: str, for_update: bool = False) -> ScheduleRow:
    """A schedule.

    Raises
    ------
    NotFoundError
        There is none of that id, or it was removed.
    """
    row = session.get(ScheduleRow, schedule_id, with_for_update=for_update or None)
    if row is None or row.deleted_at is not None:
        raise NotFoundError(f"there is no schedule {schedule_id!r}; list them at /api/v1/schedules")
    return row


def listed(
    session: Session, rig_id: str | None = None, after: str | None = None, limit: int = 100
) -> Page[ScheduleRow]:
    """A page of schedules."""
    conditions = [ScheduleRow.deleted_at.is_(None)] + ([ScheduleRow.rig_id == rig_id] if rig_id is not None else [])
    return page(session, ScheduleRow, *conditions, after=after, limit=limit)


def due(session: Session, at: datetime, lock: bool = True) -> list[ScheduleRow]:
    """Schedules whose time has come; with ``lock``, each for one worker only."""
    query = (
        select(ScheduleRow)
        .where(ScheduleRow.enabled, ScheduleRow.deleted_at.is_(None), ScheduleRow.next_at <= at)
        .order_by(ScheduleRow.id)
    )
    return list(session.scalars(query.with_for_update(skip_locked=True) if lock else query))


def record_run(
    session: Session, schedule_id: str, due_at: datetime, state: str, job_id: str | None = None, detail: str = ""
) -> None:
    """Note what became of one time at which a schedule was due."""
    session.merge(
        ScheduleRunRow(
            schedule_id=schedule_id, due_at=due_at, state=state, job_id=job_id, detail=detail, recorded_at=now()
        )
    )


def run_of(session: Session, schedule_id: str, due_at: datetime) -> ScheduleRunRow | None:
    """What became of one time at which a schedule was due; None while nothing is noted of it."""
    return session.get(ScheduleRunRow, (schedule_id, due_at))


def runs(session: Session, schedule_id: str, after: int | None = None, limit: int = 100) -> Page[ScheduleRunRow]:
    """A page of the times at which a schedule was due; ``after`` and the page's ``next`` are µs since 1970, UTC."""
    return page(
        session,
        ScheduleRunRow,
        ScheduleRunRow.schedule_id == schedule_id,
        after=None if after is None else moment(after),
        limit=limit,
        key="due_at",
        told=lambda due: str(microseconds(due)),
    )


def add_delivery(
    session: Session, schedule: ScheduleRow, delivery_id: str, contents: dict[str, Any], health_id: str = ""
) -> bool:
    """Have the webhook of a schedule told something, once for each id; whether there is one to be told."""
    if not schedule.webhook_url or schedule.deleted_at is not None:
        return False
    if session.get(WebhookRow, delivery_id) is None:
        at = now()
        session.add(
            WebhookRow(
                id=delivery_id,
                schedule_id=schedule.id,
                health_id=health_id,
                url=schedule.webhook_url,
                contents=contents,
                next_at=at,
                state=PENDING,
                created_at=at,
                updated_at=at,
            )
        )
    return True


def undispatched(session: Session, at: datetime, limit: int = 200) -> list[tuple[str, int]]:
    """Messages to send that the engine was not told of, the longest due first: id, and number of the attempt."""
    query = (
        select(WebhookRow.id, WebhookRow.attempts)
        .where(WebhookRow.next_at <= at, WebhookRow.dispatched.is_(False))
        .order_by(WebhookRow.next_at, WebhookRow.id)
        .limit(limit)
    )
    return [(delivery_id, attempts + 1) for delivery_id, attempts in session.execute(query)]


def dispatched(session: Session, delivery_id: str, number: int) -> None:
    """Note that the engine knows of an attempt; nothing where it was made already, and the next one waits."""
    session.execute(
        update(WebhookRow)
        .where(WebhookRow.id == delivery_id, WebhookRow.attempts == number - 1)
        .values(dispatched=True)
    )


def switch_off(session: Session, rig_id: str) -> list[ScheduleRow]:
    """Check a rig no more by the clock; the schedules that did."""
    query = select(ScheduleRow).where(
        ScheduleRow.rig_id == rig_id, ScheduleRow.enabled, ScheduleRow.deleted_at.is_(None)
    )
    found = list(session.scalars(query.with_for_update()))
    for row in found:
        row.enabled, row.updated_at = False, now()
    return found


def give_up_deliveries(session: Session, schedule_id: str, why: str) -> None:
    """Send no message of a schedule any more that was not heard yet."""
    session.execute(
        update(WebhookRow)
        .where(WebhookRow.schedule_id == schedule_id, WebhookRow.state == PENDING)
        .values(state=FAILED, detail=why, next_at=None, updated_at=now())
    )


def deliveries(session: Session, schedule_id: str, after: str | None = None, limit: int = 100) -> Page[WebhookRow]:
    """A page of a schedule's messages."""
    return page(session, WebhookRow, WebhookRow.schedule_id == schedule_id, after=after, limit=limit)
