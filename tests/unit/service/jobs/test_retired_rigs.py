"""A retired rig is not measured, however its job got past the door."""

from types import SimpleNamespace

import pytest

from service import bootstrap
from service.campaign.aims import Profile
from service.errors import JobError
from service.jobs import campaigns
from service.storage import jobs, rigs
from service.storage.database import now
from tests.support.databases import migrated
from tests.support.service import reference_sheet


def test_a_job_of_a_rig_that_was_retired_since_fails_before_the_controller_is_asked(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(bootstrap, "connect", asked.append)
    with migrated("sqlite", tmp_path) as database:
        with database.write() as session:
            rig = rigs.create(session, "bench", reference_sheet(), "simulated://", "", "me")
            job = jobs.submit(session, "experiment", rig.id, 1, "me")
            rig.retired_at = now()
        with pytest.raises(JobError, match="it takes no jobs") as refused:
            campaigns.measure(SimpleNamespace(database=database), job, SimpleNamespace(), Profile())
    assert refused.value.title == "rig retired"
    assert asked == []
