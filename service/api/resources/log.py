"""The audit log, read."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import ConfigDict

from service.access.audit import Action
from service.api import etags, identifiers
from service.api.access import KeyFirst
from service.api.lists import Asked, Listed, OfRig, asked_of
from service.api.resources import examples
from service.api.shapes import Shape, Time, Viewer
from service.api.state import Api
from service.storage import audit
from service.storage.tables import AuditRow

router = APIRouter(prefix="/api/v1/audit", tags=["audit"], route_class=KeyFirst)


class AuditShape(Shape):
    """One line of the audit log."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": "aud_01k9abcdefghjkmnpqrstvwxyz",
                    "at": examples.TIME,
                    "who": "lab bench",
                    "key": "key_01k9abcdefghjkmnpqrstvwxyz",
                    "action": "job.submitted",
                    "rig": examples.RIG,
                    "subject": examples.JOB,
                    "detail": {"kind": "experiment"},
                    "request_id": "9f2c1f0e",
                }
            ]
        }
    )

    id: str
    at: Time
    who: str
    key: str
    action: str
    rig: str | None
    subject: str
    detail: dict[str, Any]
    request_id: str


def shape(row: AuditRow) -> AuditShape:
    """A line as it is sent."""
    return AuditShape(
        id=row.id,
        at=row.at,
        who=row.who,
        key=row.key_id,
        action=row.action,
        rig=row.rig_id,
        subject=row.resource,
        detail=row.detail,
        request_id=row.request_id,
    )


@router.get("", response_model=Listed[AuditShape], responses=etags.documented_list())
def list_audit(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_of("aud")],
    rig: OfRig = None,
    action: Annotated[Action | None, Query(description="Only this action.")] = None,
    subject: Annotated[
        str | None, Query(description="Only about this thing.", max_length=40, pattern=identifiers.ANY)
    ] = None,
) -> Response:
    """Who did what, and who moved which rotor; newest first."""
    with api.database.read() as session:
        page = audit.listed(session, rig, action and str(action), subject, asked.after, asked.limit)
    return asked.answer(Listed[AuditShape], page, shape)
