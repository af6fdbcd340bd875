"""The line that a log has of a job now and then."""

import pytest

from service.cli.client import _line
from service.client.shapes import Job, Progress


@pytest.mark.parametrize(
    ("state", "phase", "told"),
    [
        ("running", "main", "running main sweep: 50 %"),
        ("queued", "", "queued: 50 %"),
        ("done", "done", "done: 50 %"),
        ("failed", "failed", "failed: 50 %"),
        ("cancelled", "cancelled", "cancelled: 50 %"),
        ("cancelled", "cancelled: the rig was retired", "cancelled: the rig was retired: 50 %"),
    ],
)
def test_a_state_is_told_once(state, phase, told):
    progress = Progress(phase=phase, percent=50.0)
    assert _line(Job(id="job_1", kind="gap", rig="rig_1", state=state, progress=progress)) == told
