"""One sweep alone is checked on its own other lines, which lie between those that were fitted in time as well."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.fitting.candidates import Fitter, Task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.predict import residual
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE
from service.gap.measured.observation import observe
from service.gap.weighing.ranking import ranked
from service.gap.which.explained import Explained
from service.gap.which.held_out import held_out, on_sweep
from service.gap.which.one_more_effect import residuals
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

MODE = {
    "frequency_hz": 60.0,
    "damping_ratio": 0.01,
    "bearing_A_per_sqrt_kg": 0.02,
    "bearing_B_per_sqrt_kg": -0.015,
    "sensor_A_per_sqrt_kg": 0.02,
    "sensor_B_per_sqrt_kg": -0.02,
}
ABOVE_HZ = np.geomspace(80.0, 930.0, 16)


def test_magnets_that_drift_are_told_from_one_sweep_alone() -> None:
    datasheet, truth = known_datasheet(seed=18)
    drift = {"thermal_drift": {"ki_change": -0.05, "ks_change": -0.07, "duration_s": 300.0}}
    measured = experiment(with_effects(true_rig(truth), drift))
    d = diagnose(*one_plane(replace(measured, sweeps=measured.sweeps[:1]), datasheet))
    assert d.verdict.effects == ("thermal_drift",)
    assert d.shrinkage.closure == pytest.approx(1.0, abs=0.05)
    share = 0.8  # of the campaign that the sweep took; the file does not tell that there was more
    assert d.chosen.fit.values[0]["ki_change"] == pytest.approx(share * -0.05, rel=0.15)


def test_magnets_that_each_warm_up_by_their_own_are_told() -> None:
    """Gaps close by unlike amounts while the iron loses permeance: ki of one axis falls, that of another rises."""
    datasheet, truth = known_datasheet(seed=18)
    closes, loses = {"xA": 0.012, "xB": 0.009, "yA": 0.003, "yB": 0.01}, 0.02
    ki = {axis: 2 * share - loses for axis, share in closes.items()}  # ki ~ k/s^2, ks ~ k/s^3
    ks = {axis: 3 * share - loses for axis, share in closes.items()}
    own = {f"ki_change_{axis}": change for axis, change in ki.items()}
    own |= {f"ks_change_{axis}": change for axis, change in ks.items()}
    drift = {"thermal_drift": {"ki_change": 0.0, "ks_change": 0.0, "duration_s": 300.0, **own}}
    d = diagnose(experiment(with_effects(true_rig(truth), drift)), datasheet)
    assert d.verdict.effects == ("thermal_drift",)
    found = CATALOGUE["thermal_drift"].on(nuisance(datasheet).rig, **d.chosen.fit.values[0]).drift
    assert found is not None
    axes = nuisance(datasheet).rig.axes
    at_the_end = found.progress(np.array(300.0 / found.duration_s))
    np.testing.assert_allclose(found.ki_change * at_the_end, [ki[axis] for axis in axes], atol=1.5e-3)
    np.testing.assert_allclose(found.ks_change * at_the_end, [ks[axis] for axis in axes], atol=5e-3)


def test_a_mode_below_the_lines_of_the_check_is_judged_where_it_is() -> None:
    """Its range begins at the lowest line that is fitted; the check has no line below 80 Hz."""
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(datasheet)
    rig = with_effects(true_rig(truth), {"extra_flexible_mode": MODE})
    o, unseen = (observe(sweep(rig, hz, 0.15, seed=k), nu.rig) for k, hz in enumerate((lines(), ABOVE_HZ)))
    part = next(p for p in parts(nu, (o,)) if p.path == "plant")
    ground, name = Ground(nu, part, (o,), np.zeros(len(nu))), ("extra_flexible_mode",)
    stages = (COARSE, MIDDLE, EXACT)
    with Fitter(1) as fitter:
        tasks = [Task(ground, (), ((),), ground.theta, stages), Task(ground, name, ((MODE,),), ground.theta, stages)]
        null, fitted = fitter.run(tasks)
    e = Explained(ground, tuple(ranked(null, [fitted])), residuals(ground, null), residuals(ground, fitted))
    told = held_out(e, unseen)
    assert not told.fails
    assert told.closes > 0.99
    own = residual(fitted.fit.rig, unseen)[..., 8:]  # by the explanation's own rig
    np.testing.assert_allclose(on_sweep(e, fitted, unseen)[1], own, atol=1e-6 * np.abs(own).max())
