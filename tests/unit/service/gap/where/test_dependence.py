"""Sweeps are compared by the condition that differs, and nothing is said of a condition that does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter, Task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.condition import conditions_of, same_condition
from service.gap.measured.observation import Observation, observe
from service.gap.weighing.ranking import ranked
from service.gap.weighing.significance import SIGNIFICANT, alone_hz
from service.gap.where.dependence import dependence
from service.gap.where.where import locate
from service.gap.which.between_sweeps import change_between, relative_error
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from service.gap.which.search import plain_twin
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep, true_rig

DATASHEET, TRUTH = known_datasheet(seed=2)
NU = nuisance(DATASHEET)
LINEAR = {"sensor_lag": {"time_constant_s": 2e-5}}
GROSS = {"sensor_lag": {"time_constant_s": 6e-5}}
RESONANT = {"support_resonance": {"inverse_mass_per_kg": 1e-3, "frequency_hz": 430.0, "damping_ratio": 0.01}}
BENT = {"magnetic_saturation": {"saturation_inverse_per_a": 0.6}}
PLANTS = {"linear": LINEAR, "gross": GROSS, "bent": BENT, "resonant": RESONANT, "none": {}}


@cache
def plant(effect: str) -> tuple[Explained, Observation]:
    """The plant's plain twin on the main sweep of a rig with an effect, and the other sweep at twice the amplitude."""
    rig = with_effects(true_rig(TRUTH), PLANTS[effect])
    main, other = (observe(s, NU.rig) for s in experiment(rig).sweeps)
    part = next(p for p in parts(NU, (main,)) if p.path == "plant")
    ground = Ground(NU, part, (main,), np.zeros(len(NU)))
    with Fitter(1) as fitter:
        null, plain = plain_twin(fitter, ground)
    return Explained(ground, tuple(ranked(null, [])), plain, plain), other


@pytest.mark.parametrize(("effect", "depends"), [("linear", False), ("bent", True), ("none", False)])
def test_only_what_is_not_in_proportion_depends_on_the_amplitude(effect: str, depends: bool) -> None:
    e, other = plant(effect)
    found = dependence(e, other, distorted=False)
    assert found.amplitude is depends
    assert found.speed is None, "both sweeps are at standstill"
    assert found.significance is not None
    assert (found.significance > SIGNIFICANT) is depends


def test_a_resonance_that_lies_in_the_band_of_one_sweep_alone_is_none_that_depends_on_the_amplitude() -> None:
    """Nothing was measured there at the other amplitude."""
    rig = with_effects(true_rig(TRUTH), RESONANT)
    hz = np.geomspace(13.0, 150.0, 14), np.append(np.geomspace(200.0, 930.0, 14), 430.0)
    main, other = (observe(sweep(rig, np.sort(f), a, 5), NU.rig) for f, a in zip(hz, (0.3, 0.9), strict=True))
    ground = Ground(NU, next(p for p in parts(NU, (main,)) if p.path == "plant"), (main,), np.zeros(len(NU)))
    with Fitter(1) as fitter:
        null, plain = plain_twin(fitter, ground)
    e = Explained(ground, tuple(ranked(null, [])), plain, plain)
    assert (alone_hz(ground.part, on_sweep(e, null, other)[1], other) or 0.0) > 200.0, "what may deceive"
    assert change_between(e, other) < SIGNIFICANT


def test_a_linear_gap_that_shows_alone_where_one_sweep_swings_furthest_is_none_that_depends_on_the_amplitude() -> None:
    """The other swings furthest at a lower line, where iron that lags leaves less than a shifted peak could."""
    rig = with_effects(true_rig(TRUTH), {"eddy_currents": {"time_constant_s": 2e-6}})
    hz = np.geomspace(10.0, 1000.0, 40), np.geomspace(30.0, 930.0, 16)
    main, other = (observe(sweep(rig, f, a, 5), NU.rig) for f, a in zip(hz, (0.15, 0.45), strict=True))
    ground = Ground(NU, next(p for p in parts(NU, (main,)) if p.path == "plant"), (main,), np.zeros(len(NU)))
    with Fitter(1) as fitter:
        null, plain = plain_twin(fitter, ground)
        start = {p.name: p.typical for p in CATALOGUE["eddy_currents"].parameters} | {"corner_rad_s": 10.0}
        lag = fitter.run([Task(ground, ("eddy_currents",), ((start,),), ground.theta)])
    e = Explained(ground, tuple(ranked(null, lag)), plain, plain)
    assert e.chosen is lag[0]
    assert alone_hz(ground.part, on_sweep(e, null, other)[1], other) == pytest.approx(30.0), "what may deceive"
    assert change_between(e, other) < SIGNIFICANT


def test_where_only_the_speed_differs_the_amplitude_is_not_blamed() -> None:
    e, _ = plant("none")
    hz = np.geomspace(13.0, 930.0, 16)
    whirling = with_effects(true_rig(TRUTH), {"cross_coupled_stiffness": {"stiffness_n_per_m": 4e5}})
    there = observe(replace(sweep(whirling, hz, 0.15, 8), speed_rad_s=300.0), NU.rig)
    found = dependence(e, there, distorted=False)
    assert (found.amplitude, found.speed) == (None, True)


def test_two_sweeps_of_one_condition_test_nothing_and_that_is_said() -> None:
    e, _ = plant("linear")
    again = observe(sweep(true_rig(TRUTH), np.geomspace(13.0, 930.0, 16), 0.15, 9), NU.rig)
    assert conditions_of(e.ground.observations[0], again) == (False, False)
    assert "same amplitude and speed" in (same_condition(e.ground.observations[0], again) or "")
    found = dependence(e, again, distorted=False)
    assert (found.amplitude, found.speed, found.significance) == (None, None, None)
    assert dependence(e, again, distorted=True).amplitude is True, "harmonics prove it at one amplitude"


def test_another_amplitude_needs_no_such_note() -> None:
    e, other = plant("linear")
    assert same_condition(e.ground.observations[0], other) is None


def test_bands_and_channels_have_a_significance_and_are_of_the_blamed_part() -> None:
    e, other = plant("linear")
    where = locate([e], other, ("sensor_lag",))
    assert where.blamed == "plant"
    assert max(s for *_, s in where.bands) > 5, "the lag shows at the high end"
    own = [s for a, b, _, s in where.channels if a == b]
    across = [s for a, b, _, s in where.channels if a[0] != b[0]]
    assert min(own) > 5 > max(across)
    clean, other = plant("none")
    quiet = locate([clean], other)
    assert max(s for *_, s in (*quiet.bands, *quiet.channels)) < 5


def test_an_effect_that_is_not_in_proportion_depends_on_the_amplitude_by_its_law() -> None:
    e, other = plant("linear")
    assert locate([e], other, ("touchdown_contact",)).depends.amplitude is True
    assert locate([e], other, ("sensor_lag",)).depends.amplitude is False


def test_a_log_so_coarse_that_it_shows_nothing_is_compared_without_a_division_by_zero() -> None:
    e, other = plant("none")
    Y, sd_y = other.Y.copy(), other.sd_y.copy()
    Y[::2, other.fundamental] = 0.0
    sd_y[::3] = np.inf
    coarse = replace(other, Y=Y, sd_y=sd_y)
    z = np.zeros_like(Y)
    z[::2] = 100.0
    z[::3] = 0.0
    error, variance = relative_error(z, coarse, "y")
    assert np.isfinite(error).all()
    assert np.isfinite(variance).all()
    assert np.all(variance[::2] > 1e20)
    assert change_between(e, replace(other, sd_y=sd_y)) < SIGNIFICANT


@pytest.mark.parametrize(("amplitude_a", "differs"), [(0.15, False), (0.6, True)])
def test_sweeps_of_one_plane_each_are_compared_by_their_amplitudes(amplitude_a: float, differs: bool) -> None:
    """No axis is excited in both."""
    x, y = (sweep(true_rig(TRUTH), np.geomspace(15.0, 900.0, 12), a, seed=3) for a in (0.15, amplitude_a))
    conditions = conditions_of(observe(x.select(x.axis < 2), NU.rig), observe(y.select(y.axis >= 2), NU.rig))
    assert conditions == (differs, False)
