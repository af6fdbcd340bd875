"""A twin that holds an effect is diagnosed like any other: the effect's values are none of its datasheet's."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.fitting.jacobian import displacement_jacobian
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.predict import displacement
from service.gap.measured.observation import observe
from service.gap.observed import observed
from sim.effects import CATALOGUE
from sim.twin import rig_from_datasheet, with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_datasheets_values_of_a_twin_move_it_as_they_are_said_to(name: str) -> None:
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(replace(datasheet, effects=((name, ()),)))
    plain = nuisance(datasheet)
    assert nu.names == plain.names
    o = observe(sweep(true_rig(truth), lines(10), 0.1, seed=1), plain.rig)
    theta, step = 0.3 * np.random.default_rng(5).standard_normal(len(nu)), 1e-4
    J = displacement_jacobian(nu, nu.at(theta), o)
    for j in range(0, len(nu), 3):  # every kind of them on some axis or mode
        e = step * (np.arange(len(nu)) == j)
        difference = (displacement(nu.at(theta + e), o) - displacement(nu.at(theta - e), o)) / (2 * step)
        assert np.linalg.norm(J[:, :, j] - difference) < 2e-3 * np.linalg.norm(difference), nu.names[j]


def test_a_twin_with_a_further_mode_is_diagnosed() -> None:
    datasheet, truth = known_datasheet(seed=1)
    values = {"frequency_hz": 300.0, "damping_ratio": 2e-3}
    mode = {**values, **{f"{at}_{end}_per_sqrt_kg": 0.03 for at in ("bearing", "sensor") for end in "AB"}}
    measured = experiment(with_effects(true_rig(truth), {"extra_flexible_mode": mode}))
    twin = replace(datasheet, effects=(("extra_flexible_mode", tuple(mode.items())),))
    assert diagnose(*one_plane(measured, twin)).verdict.kind == "no_gap"


@pytest.mark.parametrize(("took_s", "share"), [(100.0, 1 / 3), (600.0, 2.0)])
def test_a_drift_of_the_twin_goes_on_by_the_clock_of_the_experiment(took_s: float, share: float) -> None:
    """It was found over other 300 s than the experiment takes."""
    datasheet, truth = known_datasheet(seed=18)
    drift = {"ki_change": -0.05, "ks_change": -0.07, "duration_s": 300.0}
    measured = experiment(true_rig(truth))
    dated = tuple(
        replace(s, time_s=took_s * np.linspace(*part, s.n_points))
        for s, part in zip(measured.sweeps, ((0.0, 0.8), (0.8, 1.0)), strict=True)
    )
    twin = replace(datasheet, effects=(("thermal_drift", tuple(drift.items())),))
    data = observed(replace(measured, sweeps=dated), twin)
    assert data.nuisance.rig.drift is not None
    at_the_end = data.nuisance.rig.drift.progress(data.unseen.progress[-1])
    assert data.nuisance.rig.drift.ki_change * at_the_end == pytest.approx(np.full(4, -0.05 * share))
    untold = observed(measured, twin)
    assert any("does not tell when" in note for note in untold.notes)
    assert rig_from_datasheet(twin).drift is not None
