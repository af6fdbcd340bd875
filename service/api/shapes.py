"""Parts that the shapes of all resources share."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Header, Path
from pydantic import BaseModel, ConfigDict, PlainSerializer, model_validator

from service.access.keys import Identity, Scope
from service.api import identifiers
from service.api.access import require


def _utc(value: datetime) -> str:
    return value.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


Time = Annotated[datetime, PlainSerializer(_utc, when_used="json")]
"""ISO 8601, UTC."""


DEEPEST = 16
"""Levels of objects and lists in a body; far below the depth at which Python gives up."""


class Shape(BaseModel):
    """What the service sends."""

    model_config = ConfigDict(extra="forbid")


class Wanted(BaseModel):
    """What is sent to the service: nothing that it does not know, and nothing that a database cannot keep."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _can_be_kept(cls, sent: Any) -> Any:
        parts = [(sent, 0)]
        while parts:
            part, depth = parts.pop()
            if isinstance(part, str) and "\0" in part:
                raise ValueError("holds a NUL character (U+0000), which PostgreSQL keeps in no text; leave it out")
            if isinstance(part, dict | list) and depth == DEEPEST:
                raise ValueError(f"is nested deeper than {DEEPEST} levels, as nothing is that means something here")
            if isinstance(part, dict):
                parts += [(each, depth + 1) for pair in part.items() for each in pair]
            elif isinstance(part, list):
                parts += [(each, depth + 1) for each in part]
        return sent


def identifier(prefix: str) -> Any:
    """A path parameter: the id of a resource."""
    return Path(
        description=f"Id of the resource, {prefix}_...",
        max_length=40,
        pattern=rf"^{prefix}_[0-9a-z]+$",
        examples=[identifiers.example(prefix)],
    )


RigId = Annotated[str, identifier("rig")]
JobId = Annotated[str, identifier("job")]
ExperimentId = Annotated[str, identifier("exp")]
ModelId = Annotated[str, identifier("mod")]
GapId = Annotated[str, identifier("gap")]
HealthId = Annotated[str, identifier("hc")]
ScheduleId = Annotated[str, identifier("sch")]

IfMatch = Annotated[
    str | None,
    Header(description="ETag of the version that is changed; another one gives 412.", max_length=200),
]
IfNoneMatch = Annotated[
    str | None, Header(description="ETag that the caller has; the same one gives 304.", max_length=2000)
]
IdempotencyKey = Annotated[
    str | None,
    Header(
        description="Any text that is new for every new request. The same request sent again under the same key is "
        "done once, and gets the first answer.",
        min_length=1,
        max_length=255,
        examples=["6f1c9f0e-5b1d-4d77-9a4e-0b3f8f9f2a11"],
    ),
]

Viewer = Annotated[Identity, Depends(require(Scope.viewer))]
Operator = Annotated[Identity, Depends(require(Scope.operator))]
Admin = Annotated[Identity, Depends(require(Scope.admin))]
