"""Schedules, their runs and the messages of their webhooks, as they are given and sent."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, WithJsonSchema

from service.api.resources import examples
from service.api.resources.options import OF_A_CHECK
from service.api.shapes import Shape, Time, Wanted
from service.storage.tables import ScheduleRow, ScheduleRunRow, WebhookRow


class WebhookWanted(Wanted):
    """Who is told of a check."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"url": "https://plant.example/hooks/amb", "on": "alarm", "secret": None}]}
    )

    url: str = Field(max_length=1000, description="http or https; messages follow Standard Webhooks 1.0.0.")
    secret: str | None = Field(
        None,
        max_length=200,
        description="whsec_ and base64. Without it a new one is made, and shown in this answer only.",
    )
    on: Literal["alarm", "always"] = Field(
        "alarm",
        description="Which checks are told of: health.alarm, or health.ok too. That a check failed (health.failed) or "
        "was not made (health.missed) is always told.",
    )


class ScheduleWanted(Wanted):
    """A schedule as it is given."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "rig": examples.RIG,
                    "cron": "30 6 * * *",
                    "timezone": "Europe/Zurich",
                    "options": {"budget_s": 90},
                    "webhook": {"url": "https://plant.example/hooks/amb", "on": "alarm"},
                }
            ]
        }
    )

    rig: str = Field(max_length=40, description="Id of the rig; it stays.")
    cron: str = Field(max_length=100, description="Minute, hour, day, month, weekday.")
    timezone: str = Field("UTC", max_length=60, description="In which the expression is read.")
    options: Annotated[dict[str, Any], WithJsonSchema(OF_A_CHECK)] = Field(
        default_factory=dict, description="Options of the health jobs."
    )
    enabled: bool = True
    webhook: WebhookWanted | None = None


class WebhookShape(Shape):
    """Who is told of a check."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"url": "https://plant.example/hooks/amb", "on": "alarm", "secret": None}]}
    )

    url: str
    on: str
    secret: str | None = None
    """Only in the answer that made it."""


class ScheduleShape(Shape):
    """A schedule."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.SCHEDULE,
                    "rig": examples.RIG,
                    "cron": "30 6 * * *",
                    "timezone": "Europe/Zurich",
                    "options": {"budget_s": 90},
                    "enabled": True,
                    "webhook": {"url": "https://plant.example/hooks/amb", "on": "alarm", "secret": None},
                    "next_at": examples.TIME,
                    "created_at": examples.TIME,
                    "updated_at": examples.TIME,
                    "created_by": "lab bench",
                }
            ]
        }
    )

    id: str
    rig: str
    cron: str
    timezone: str
    options: dict[str, Any]
    enabled: bool
    webhook: WebhookShape | None
    next_at: Time | None
    created_at: Time
    updated_at: Time
    created_by: str


class RunShape(Shape):
    """One time at which a check was due."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "due_at": examples.TIME,
                    "state": "missed",
                    "detail": "the service was down",
                    "job": None,
                    "recorded_at": examples.TIME,
                },
            ]
        }
    )

    due_at: Time
    state: str
    """submitted, missed (the service was down, or the check before had not ended) or refused (the rig could not be
    checked)."""
    detail: str
    job: str | None
    recorded_at: Time


class DeliveryShape(Shape):
    """A message to a webhook, and what became of it."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": "whd_01k9abcdefghjkmnpqrstvwxyz",
                    "type": "health.alarm",
                    "health": examples.HEALTH,
                    "url": "https://plant.example/hooks/amb",
                    "state": "pending",
                    "attempts": 1,
                    "status_code": 503,
                    "detail": "try again later",
                    "next_attempt_at": examples.TIME,
                    "created_at": examples.TIME,
                    "updated_at": examples.TIME,
                },
            ]
        }
    )

    id: str
    type: str
    """health.alarm, health.ok, health.failed or health.missed; empty for one of an earlier version."""
    health: str | None
    """The check that it tells of; null for one that failed or was not made."""
    url: str
    state: str
    """pending, delivered or failed."""
    attempts: int
    status_code: int | None
    detail: str
    next_attempt_at: Time | None
    """When it is sent again; null where it has arrived or is given up."""
    created_at: Time
    updated_at: Time


def shape(row: ScheduleRow, secret: str | None = None) -> ScheduleShape:
    """A schedule as it is sent."""
    hook = WebhookShape(url=row.webhook_url, on=row.webhook_on, secret=secret) if row.webhook_url else None
    return ScheduleShape(
        id=row.id,
        rig=row.rig_id,
        cron=row.cron,
        timezone=row.timezone,
        options=row.options,
        enabled=row.enabled,
        webhook=hook,
        next_at=row.next_at if row.enabled else None,
        created_at=row.created_at,
        updated_at=row.updated_at,
        created_by=row.created_by,
    )


def run_shape(row: ScheduleRunRow) -> RunShape:
    """A time at which a check was due, as it is sent."""
    return RunShape(due_at=row.due_at, state=row.state, detail=row.detail, job=row.job_id, recorded_at=row.recorded_at)


def delivery_shape(row: WebhookRow) -> DeliveryShape:
    """A message of a webhook as it is sent."""
    return DeliveryShape(
        id=row.id,
        type=row.contents.get("type", ""),
        health=row.health_id or None,
        url=row.url,
        state=row.state,
        attempts=row.attempts,
        status_code=row.status_code,
        detail=row.detail,
        next_attempt_at=row.next_at,
        created_at=row.created_at,
        updated_at=row.updated_at,
    )
