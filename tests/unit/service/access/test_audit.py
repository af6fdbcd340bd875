"""The audit log answers who moved which rotor."""

from service.access.audit import Action, audited
from service.access.keys import Identity, Scope


def test_an_event_names_who_what_and_which_rig():
    who = Identity("key_1", "laptop", Scope.operator)
    event = audited(who, Action.job_submitted, "job_1", rig="rig_1", request_id="r", kind="experiment")
    assert (event.actor, event.actor_name, event.subject, event.rig) == ("key_1", "laptop", "job_1", "rig_1")
    assert event.detail == {"kind": "experiment"}
    assert event.at.utcoffset().total_seconds() == 0
