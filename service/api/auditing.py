"""The audit log as routes write it: in the transaction of what they do."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from sqlalchemy.orm import Session

from service.access.audit import Action, audited
from service.access.keys import Identity
from service.storage import audit as rows


def audit(
    session: Session,
    request: Request,
    who: Identity,
    action: Action,
    subject: str,
    rig: str | None = None,
    **detail: Any,
) -> None:
    """Note that someone did something."""
    request_id = request.scope.get("state", {}).get("request_id")
    address = request.client.host if request.client else None
    request.scope.setdefault("state", {})["about"] = {"rig": rig, subject.partition("_")[0]: subject}
    rows.record(session, audited(who, action, subject, rig, request_id, address, **detail))
