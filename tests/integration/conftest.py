"""What several tests of campaigns look at."""

import pytest

from sim.reference import reference_rig
from tests.support.campaigns import campaign


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """A finished campaign on the reference rig, and its progress reports."""
    folder = tmp_path_factory.mktemp("campaign")
    reports = []
    return folder, campaign(reference_rig(), folder, progress=reports.append), reports
