"""A campaign is rehearsed on paper: the same each time, on two axes too, with the waiting that a loop needs."""

from dataclasses import replace

import numpy as np
import pytest

from service.campaign.aims import Profile
from service.gap.proposal.case import limits_of
from service.gap.proposal.rehearsal import BegunCampaign
from service.gap.proposal.sensor_noise import SensorNoise
from sim.errors import LevitationError
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, true_rig
from tests.support.two_axes import sheet_of_one_plane

SHEET = known_datasheet()[1]
SHORT = Profile(
    points=8, validation_points=4, amplifier_points=0, coarse_points=6, peak_points=0, rig_seconds=100.0, to_hz=300.0
)
PLANNED = ("preliminary", "main", "validation")


def noise(n_axes: int = 4) -> SensorNoise:
    return SensorNoise(np.array([10.0, 1000.0]), np.full((2, n_axes), 8e-9), np.full((2, n_axes), 8e-19))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return true_rig(SHEET)


def test_it_is_the_same_each_time_and_ends_where_it_is_told_to(rig: Rig) -> None:
    one, other = (BegunCampaign(rig, limits_of(SHEET), SHORT, noise()).whole() for _ in range(2))
    assert one.rig_seconds == other.rig_seconds
    assert tuple(one.points) == PLANNED
    assert {name: len(points) for name, points in one.points.items()} == {
        "preliminary": 24,
        "main": 32,
        "validation": 16,
    }
    begun = BegunCampaign(rig, limits_of(SHEET), SHORT, noise())
    assert [p.request for p in begun.main] == [p.request for p in one.points["main"]]


def test_two_axes_take_half_of_the_points() -> None:
    sheet = sheet_of_one_plane(SHEET)
    told = BegunCampaign(true_rig(sheet), limits_of(sheet), SHORT, noise(2)).whole()
    assert {name: len(points) for name, points in told.points.items()} == {
        "preliminary": 12,
        "main": 16,
        "validation": 8,
    }


def test_what_rings_is_waited_for(rig: Rig) -> None:
    """Lines at a mode settle for much longer than those between modes."""
    at_mode = BegunCampaign(rig, limits_of(SHEET), replace(SHORT, frequencies_hz=(300.0, 320.0, 492.9)), noise())
    waited = {round(p.frequency_hz, -1): p.request.settle_samples for p in at_mode.main}
    assert waited[490.0] > 3 * waited[300.0]


def test_a_loop_that_does_not_hold_is_told(rig: Rig) -> None:
    weak = replace(rig, magnets=replace(rig.magnets, ks=20 * rig.magnets.ks))
    with pytest.raises(LevitationError):
        BegunCampaign(weak, limits_of(SHEET), SHORT, noise())


def test_a_log_out_of_step_changes_no_amplitude_that_is_planned(rig: Rig) -> None:
    late = with_effects(rig, {"logging_offset": {"samples": 2.0}})
    right, offset = (BegunCampaign(r, limits_of(SHEET), SHORT, noise()) for r in (rig, late))
    one, other = ([p.request.amplitude_a for p in told.main] for told in (right, offset))
    assert other == pytest.approx(one, rel=0.02)
