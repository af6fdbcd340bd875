"""Sweeps at two speeds tell what goes with the speed."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

pytestmark = pytest.mark.slow

LOW_HZ = np.geomspace(10.0, 300.0, 16)


def test_a_seal_whose_fluid_the_rotor_carries_round_is_told_with_what_each_speed_adds() -> None:
    """Held against one stiffness for both speeds it was none of the known effects."""
    datasheet, truth = known_datasheet(seed=61)
    rig = with_effects(
        true_rig(truth), {"cross_coupled_stiffness": {"stiffness_n_per_m": 0.0, "by_speed_ns_per_m": 500.0}}
    )
    fast, slow = (replace(rig, speed_rad_s=speed) for speed in (300.0, 100.0))
    sweeps = (
        replace(sweep(fast, LOW_HZ, 0.15, 1), speed_rad_s=300.0, comment="main"),
        replace(sweep(slow, LOW_HZ * 1.07, 0.15, 2, during=(0.8, 1.0)), speed_rad_s=100.0, comment="another speed"),
    )
    d = diagnose(Experiment(rig.name, rig.axes, sweeps), datasheet)
    assert d.verdict.effects == ("cross_coupled_stiffness",)
    found = d.chosen.fit.values[0]
    assert found["by_speed_ns_per_m"] == pytest.approx(500.0, rel=0.1)
    assert found["stiffness_n_per_m"] == pytest.approx(0.0, abs=5e3)
    assert d.shrinkage.closure == pytest.approx(1.0, abs=0.1)
