"""One sweep alone is checked on its own other lines, which lie between those that were fitted in time as well."""

from dataclasses import replace

import pytest

from service.gap.diagnose import diagnose
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def test_magnets_that_drift_are_told_from_one_sweep_alone() -> None:
    datasheet, truth = known_datasheet(seed=18)
    drift = {"thermal_drift": {"ki_change": -0.05, "ks_change": -0.07, "duration_s": 300.0}}
    measured = experiment(with_effects(true_rig(truth), drift))
    d = diagnose(*one_plane(replace(measured, sweeps=measured.sweeps[:1]), datasheet))
    assert d.verdict.effects == ("thermal_drift",)
    assert d.shrinkage.closure == pytest.approx(1.0, abs=0.05)
    share = 0.8  # of the campaign that the sweep took; the file does not tell that there was more
    assert d.chosen.fit.values[0]["ki_change"] == pytest.approx(share * -0.05, rel=0.15)
