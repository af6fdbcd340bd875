"""Words of the audit log: who did what to which thing, and above all who moved which rotor."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from service.access.keys import Identity


class Action(StrEnum):
    """What can be done that someone may later ask about."""

    key_created = "key.created"
    key_revoked = "key.revoked"
    access_refused = "access.refused"
    """401 or 403: a key that does not hold or does not reach so far; one line an address and minute at most."""
    rig_created = "rig.created"
    rig_changed = "rig.changed"
    rig_removed = "rig.removed"
    experiment_uploaded = "experiment.uploaded"
    upload_refused = "upload.refused"
    job_submitted = "job.submitted"
    job_cancelled = "job.cancelled"
    job_retried = "job.retried"
    schedule_created = "schedule.created"
    schedule_changed = "schedule.changed"
    schedule_removed = "schedule.removed"
    baseline_changed = "baseline.changed"
    rotor_excited = "rotor.excited"
    """A worker has taken the controller's lease for a job: from now on the rotor moves. The actor is who had this run
    of the job done, the first or a retry."""
    rotor_released = "rotor.released"
    """The lease is given back; the detail says how the excitation ended."""
    trip_acknowledged = "trip.acknowledged"
    """A controller that had tripped may excite again; the detail says of what it had tripped."""
    restored = "service.restored"


@dataclass(frozen=True)
class AuditEvent:
    """One line of the audit log."""

    action: Action
    actor: str
    """Id of the key, "local", "schedule:<id>" for what the clock began, or empty for nobody who is known."""
    actor_name: str
    subject: str
    """Id of the thing: rig_..., job_..., key_..."""
    rig: str | None = None
    """Id of the rig, where there is one."""
    detail: dict[str, Any] = field(default_factory=dict)
    request_id: str | None = None
    address: str | None = None
    """Where the request came from."""
    at: datetime = field(default_factory=lambda: datetime.now(UTC))


def audited(
    who: Identity,
    action: Action,
    subject: str,
    rig: str | None = None,
    request_id: str | None = None,
    address: str | None = None,
    **detail: Any,
) -> AuditEvent:
    """An event by an identity, now.

    >>> from service.access.keys import LOCAL
    >>> audited(LOCAL, Action.job_submitted, "job_1", rig="rig_1", kind="experiment").detail
    {'kind': 'experiment'}
    """
    return AuditEvent(action, who.key_id, who.name, subject, rig, detail, request_id, address)
