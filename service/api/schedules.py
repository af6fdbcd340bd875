"""Schedules: when a rig's health is checked, who is told, and which checks were missed."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from sqlalchemy.orm import Session

from service.access.audit import Action
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.once import Answer, once
from service.api.options import checked_options
from service.api.problems import documented
from service.api.schedule_shapes import DeliveryShape, RunShape, ScheduleShape, ScheduleWanted, shape
from service.api.shapes import (
    AFTER,
    AfterDelivery,
    AfterSchedule,
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Limit,
    Listed,
    OfRig,
    Operator,
    ScheduleId,
    Viewer,
)
from service.api.state import Api
from service.errors import ConflictError
from service.health import schedule as cron
from service.health import webhook
from service.storage import rigs, schedules
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ScheduleRow

router = APIRouter(prefix="/api/v1/schedules", tags=["schedules"], route_class=KeyFirst)
LATEST_US = 253_402_300_799_000_000
"""The year 9999, µs since 1970."""


def tag(row: ScheduleRow) -> str:
    """ETag of a schedule; that it ran is no change of it."""
    return f"{row.id}.{int(row.updated_at.timestamp() * 1e6):x}"


def _apply(session: Session, row: ScheduleRow, wanted: ScheduleWanted, loopback: bool) -> str | None:
    """Write what is wanted into a row; the secret that was made for it, if any.

    ``loopback``: whether a webhook may lead to this machine itself.

    Raises
    ------
    ScheduleError, WebhookError
        It cannot be kept.
    ConflictError
        It is to run, and its rig has no controller.
    """
    rig = rigs.active(session, row.rig_id)
    if wanted.enabled and not rigs.version(session, rig).controller_url:
        raise ConflictError(f"the rig {rig.name!r} has no controller_url; give it one before it can be checked")
    row.cron, row.timezone = cron.checked(wanted.cron, wanted.timezone), wanted.timezone
    row.options = checked_options("health", wanted.options)
    row.enabled = wanted.enabled
    row.updated_at = now()
    row.next_at = cron.next_run(row.cron, row.updated_at, row.timezone)
    made: str | None = None
    if wanted.webhook is None:
        row.webhook_url = row.webhook_secret = ""
        schedules.give_up_deliveries(session, row.id, schedules.REMOVED)
        return None
    if wanted.webhook.secret is not None:
        webhook.signed({}, wanted.webhook.secret, "check", 0.0)  # a secret that cannot sign is refused now
        row.webhook_secret = wanted.webhook.secret
    elif not row.webhook_secret:
        row.webhook_secret = made = webhook.new_secret()
    row.webhook_url, row.webhook_on = webhook.checked_url(wanted.webhook.url, loopback), wanted.webhook.on
    return made


@router.post("", status_code=201, response_model=ScheduleShape, responses=documented(404, 409, 413, 415))
def create_schedule(
    request: Request, wanted: ScheduleWanted, who: Operator, api: Api, idempotency_key: IdempotencyKey = None
) -> Response:
    """Have a rig's health checked by the clock."""

    def make(session: Session) -> Answer:
        rig = rigs.active(session, wanted.rig)
        row = ScheduleRow(id=new_id("sch"), rig_id=rig.id, created_at=now(), created_by=who.name, webhook_secret="")
        secret = _apply(session, row, wanted, api.settings.webhooks_to_itself)
        session.add(row)
        session.flush()
        audit(session, request, who, Action.schedule_created, row.id, rig=rig.id, cron=row.cron)
        return Answer(201, f"/api/v1/schedules/{row.id}", shape(row, secret).model_dump(mode="json"))

    answer, replayed = once(api.database, who, request, idempotency_key, wanted.model_dump_json(), make)
    return answer.response(replayed)


@router.get("", response_model=Listed[ScheduleShape], responses=etags.documented_list())
def list_schedules(
    who: Viewer,
    api: Api,
    rig: OfRig = None,
    after: AfterSchedule = None,
    limit: Limit = 100,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """All schedules, newest first."""
    with api.database.read() as session:
        page = schedules.listed(session, rig, after, limit)
    return etags.document(
        Listed[ScheduleShape](items=[shape(row) for row in page.items], next=page.next), if_none_match
    )


@router.get("/{schedule_id}", response_model=ScheduleShape, responses=etags.documented_resource())
def get_schedule(schedule_id: ScheduleId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """A schedule."""
    with api.database.read() as session:
        row = schedules.get(session, schedule_id)
    return etags.document(shape(row), if_none_match, tag(row))


@router.put("/{schedule_id}", response_model=ScheduleShape, responses=documented(404, 409, 412, 413, 415, 428))
def change_schedule(
    request: Request,
    schedule_id: ScheduleId,
    wanted: ScheduleWanted,
    who: Operator,
    api: Api,
    if_match: IfMatch = None,
) -> Response:
    """Change a schedule; the webhook's secret stays when none is given."""
    with api.database.write() as session:
        row = schedules.get(session, schedule_id, for_update=True)
        etags.require_match(if_match, tag(row))
        if wanted.rig != row.rig_id:
            raise ConflictError(f"the schedule is for the rig {row.rig_id}, and stays so; make another one")
        secret = _apply(session, row, wanted, api.settings.webhooks_to_itself)
        audit(session, request, who, Action.schedule_changed, row.id, rig=row.rig_id, cron=row.cron)
    return etags.document(shape(row, secret), None, tag(row))


@router.delete("/{schedule_id}", status_code=204, response_class=Response, responses=documented(404))
def remove_schedule(request: Request, schedule_id: ScheduleId, who: Operator, api: Api) -> Response:
    """Remove a schedule; its checks stay."""
    with api.database.write() as session:
        row = schedules.get(session, schedule_id, for_update=True)
        row.deleted_at = now()
        row.next_at = None
        audit(session, request, who, Action.schedule_removed, row.id, rig=row.rig_id)
    return Response(status_code=204)


@router.get("/{schedule_id}/runs", response_model=Listed[RunShape], responses=etags.documented_list(404))
def list_runs(
    schedule_id: ScheduleId,
    who: Viewer,
    api: Api,
    after: Annotated[int | None, Query(description=AFTER, ge=0, le=LATEST_US)] = None,
    limit: Limit = 100,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """The times at which checks were due, newest first; also those that were missed."""
    with api.database.read() as session:
        schedules.get(session, schedule_id)
        page = schedules.runs(session, schedule_id, after, limit)
    items = [
        RunShape(due_at=r.due_at, state=r.state, detail=r.detail, job=r.job_id, recorded_at=r.recorded_at)
        for r in page.items
    ]
    return etags.document(Listed[RunShape](items=items, next=page.next), if_none_match)


@router.get("/{schedule_id}/deliveries", response_model=Listed[DeliveryShape], responses=etags.documented_list(404))
def list_deliveries(
    schedule_id: ScheduleId,
    who: Viewer,
    api: Api,
    after: AfterDelivery = None,
    limit: Limit = 100,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """What the schedule's webhook was told, newest first."""
    with api.database.read() as session:
        schedules.get(session, schedule_id)
        page = schedules.deliveries(session, schedule_id, after, limit)
    items = [
        DeliveryShape(
            id=d.id,
            type=d.contents.get("type", ""),
            health=d.health_id or None,
            url=d.url,
            state=d.state,
            attempts=d.attempts,
            status_code=d.status_code,
            detail=d.detail,
            created_at=d.created_at,
            updated_at=d.updated_at,
        )
        for d in page.items
    ]
    return etags.document(Listed[DeliveryShape](items=items, next=page.next), if_none_match)
