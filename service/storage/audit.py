"""The audit log: written in the transaction of what it tells of, never changed."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.access.audit import Action, AuditEvent
from service.storage.ids import new_id
from service.storage.listing import Page, page
from service.storage.tables import AuditRow


def record(session: Session, event: AuditEvent) -> None:
    """Add a line to the log."""
    detail = dict(event.detail) | ({"address": event.address} if event.address else {})
    session.add(
        AuditRow(
            id=new_id("aud"),
            at=event.at,
            who=event.actor_name,
            key_id=event.actor,
            action=str(event.action),
            rig_id=event.rig,
            resource=event.subject,
            detail=detail,
            request_id=event.request_id or "",
        )
    )


def listed(
    session: Session,
    rig_id: str | None = None,
    action: str | None = None,
    resource: str | None = None,
    after: str | None = None,
    limit: int = 100,
) -> Page[AuditRow]:
    """A page of the log, newest first."""
    wanted = ((AuditRow.rig_id, rig_id), (AuditRow.action, action), (AuditRow.resource, resource))
    conditions = [column == value for column, value in wanted if value is not None]
    return page(session, AuditRow, *conditions, after=after, limit=limit)


def holding(session: Session, rig_id: str, jobs: Collection[str]) -> set[str]:
    """Which of a rig's jobs have its controller's lease, as far as is written down: it began, and has not ended."""
    both = (str(Action.rotor_excited), str(Action.rotor_released))
    of_jobs = (AuditRow.rig_id == rig_id) & AuditRow.resource.in_(jobs) & AuditRow.action.in_(both)
    in_order = select(AuditRow.resource, AuditRow.action).where(of_jobs).order_by(AuditRow.at)
    last = dict(session.execute(in_order).all())
    return {job for job, action in last.items() if action == str(Action.rotor_excited)}


def stop_of_rig(session: Session, rig_id: str, since: datetime) -> AuditRow | None:
    """The last stop of a rig that was asked for over this service since then; None where there was none."""
    of_rig = (AuditRow.action == str(Action.rotor_released)) & (AuditRow.resource == rig_id)  # else it is of a job
    query = select(AuditRow).where(of_rig, AuditRow.at >= since).order_by(AuditRow.at.desc()).limit(1)
    return session.scalar(query)
