"""Schedules: when a rig's health is checked, who is told, and which checks were missed."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Request, Response
from sqlalchemy.orm import Session

from service.access.audit import Action
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.lists import Asked, Listed, OfRig, asked_by_number, asked_of
from service.api.once import Answer, once
from service.api.problems import documented
from service.api.resources.budgets import must_hold_a_check
from service.api.resources.options import checked_options
from service.api.resources.schedule_shapes import (
    DeliveryShape,
    RunShape,
    ScheduleShape,
    ScheduleWanted,
    delivery_shape,
    run_shape,
    shape,
)
from service.api.shapes import (
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Operator,
    ScheduleId,
    Viewer,
)
from service.api.state import Api, Services
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
    """ETag of a schedule: its version, and when it runs next."""
    return f"{_version(row)}{_microseconds(row.next_at):x}"


def _version(row: ScheduleRow) -> str:
    """What its ETags begin with; that it ran is no change of it."""
    return f"{row.id}.{_microseconds(row.updated_at):x}."


def _microseconds(at: datetime | None) -> int:
    return 0 if at is None else int(at.timestamp() * 1e6)


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


def _must_work(api: Services, wanted: ScheduleWanted) -> None:
    """Refuse a schedule that is to run, and whose checks do not fit into their budget."""
    if wanted.enabled:
        must_hold_a_check(api, wanted.rig, checked_options("health", wanted.options))


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

    content = wanted.model_dump_json()
    answer, replayed = once(api.database, who, request, idempotency_key, content, make, lambda: _must_work(api, wanted))
    return answer.response(replayed)


@router.get("", response_model=Listed[ScheduleShape], responses=etags.documented_list())
def list_schedules(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_of("sch")],
    rig: OfRig = None,
) -> Response:
    """All schedules, newest first."""
    with api.database.read() as session:
        page = schedules.listed(session, rig, asked.after, asked.limit)
    return asked.answer(Listed[ScheduleShape], page, shape)


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
    with api.database.read() as session:
        _must_be_changed(schedules.get(session, schedule_id), wanted, if_match)
    _must_work(api, wanted)
    with api.database.write() as session:
        row = schedules.get(session, schedule_id, for_update=True)
        _must_be_changed(row, wanted, if_match)
        secret = _apply(session, row, wanted, api.settings.webhooks_to_itself)
        audit(session, request, who, Action.schedule_changed, row.id, rig=row.rig_id, cron=row.cron)
    return etags.document(shape(row, secret), None, tag(row))


def _must_be_changed(row: ScheduleRow, wanted: ScheduleWanted, if_match: str | None) -> None:
    """Refuse to change a schedule that has changed, or to make it another rig's."""
    etags.require_match(if_match, tag(row), _version(row))
    if wanted.rig != row.rig_id:
        raise ConflictError(f"the schedule is for the rig {row.rig_id}, and stays so; make another one")


@router.delete("/{schedule_id}", status_code=204, response_class=Response, responses=documented(404))
def remove_schedule(request: Request, schedule_id: ScheduleId, who: Operator, api: Api) -> Response:
    """Remove a schedule; its checks stay, and its webhook hears nothing more."""
    with api.database.write() as session:
        row = schedules.get(session, schedule_id, for_update=True)
        row.deleted_at = now()
        row.next_at = None
        schedules.give_up_deliveries(session, row.id, schedules.SCHEDULE_REMOVED)
        audit(session, request, who, Action.schedule_removed, row.id, rig=row.rig_id)
    return Response(status_code=204)


@router.get("/{schedule_id}/runs", response_model=Listed[RunShape], responses=etags.documented_list(404))
def list_runs(
    schedule_id: ScheduleId, who: Viewer, api: Api, asked: Annotated[Asked[int], asked_by_number(0, LATEST_US)]
) -> Response:
    """The times at which checks were due, newest first; also those that were missed."""
    with api.database.read() as session:
        schedules.get(session, schedule_id)
        page = schedules.runs(session, schedule_id, asked.after, asked.limit)
    return asked.answer(Listed[RunShape], page, run_shape)


@router.get("/{schedule_id}/deliveries", response_model=Listed[DeliveryShape], responses=etags.documented_list(404))
def list_deliveries(
    schedule_id: ScheduleId, who: Viewer, api: Api, asked: Annotated[Asked[str], asked_of("whd")]
) -> Response:
    """What the schedule's webhook was told, newest first."""
    with api.database.read() as session:
        schedules.get(session, schedule_id)
        page = schedules.deliveries(session, schedule_id, asked.after, asked.limit)
    return asked.answer(Listed[DeliveryShape], page, delivery_shape)
