"""A mean current that holds a static load is where the twin works, too."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.gap.observed import observed
from service.identification.fit import identify
from sim.actuator import operating_point
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

DATASHEET, TRUTH = known_datasheet(seed=21)


def held(rig: Rig, current_a: np.ndarray) -> tuple[Experiment, np.ndarray]:
    """What is logged of a rig whose load is held by a current, the mean of it included, and that current."""
    e = experiment(replace(rig, static_current_a=current_a))

    def logged(X: np.ndarray) -> np.ndarray:
        return X + current_a * (np.array(e.sweeps[0].harmonics) == 0)[:, None]

    return replace(e, sweeps=tuple(replace(s, U=logged(s.U), I=logged(s.I)) for s in e.sweeps)), current_a


@pytest.mark.parametrize("logged", [True, False])
def test_position_stiffness_grows_with_the_current_that_holds_a_lying_rotor(logged: bool) -> None:
    """ks (1 + (i/i0)^2), ki unchanged: Schweitzer and Maslen, Magnetic Bearings, 2009, chapter 4."""
    e, current = held(true_rig(TRUTH), np.array([1.5, 1.2, 1.5, 1.2]))
    if not logged:
        e = replace(e, sweeps=tuple(replace(s, I=None) for s in e.sweeps))
    data = observed(e, DATASHEET)
    point = operating_point(data.nuisance.rig)
    nominal, bias = np.array(DATASHEET.position_stiffness_n_per_m), np.array(DATASHEET.bias_current_a)
    np.testing.assert_allclose(point.ks, nominal * (1 + (current / bias) ** 2), rtol=1e-4)
    np.testing.assert_allclose(point.ki, DATASHEET.current_stiffness_n_per_a, rtol=1e-4)
    assert np.abs(data.o.U[:, 0].mean(axis=0)).max() < 1e-3, "what the twin is driven with is counted from there"
    assert any("static load" in note and "xA 1.50 A" in note for note in data.notes)


def test_a_damaged_point_and_a_sweep_without_means_leave_the_load_known() -> None:
    e, current = held(true_rig(TRUTH), np.array([1.5, 1.2, 1.5, 1.2]))
    main, other = e.sweeps
    damaged = main.U.copy()
    damaged[3] = np.nan
    fundamental = [other.harmonics.index(1)]
    lock_in = {name: getattr(other, name)[:, :, fundamental] for name in "RUIY"}
    sweeps = (replace(main, U=damaged), replace(other, harmonics=(1,), **lock_in))
    data = observed(replace(e, sweeps=sweeps), DATASHEET)
    np.testing.assert_allclose(data.nuisance.rig.static_current_a, current, atol=1e-3)
    assert np.isfinite(data.o.U).all()


def test_the_identification_says_that_it_is_of_the_loaded_bearing() -> None:
    e, current = held(true_rig(TRUTH), np.array([1.5, 1.2, 1.5, 1.2]))
    found = identify(*one_plane(e, DATASHEET))
    assert any("static load (xA 1.50 A" in w for w in found.warnings)
    ks = found.planes["x"].stiffness["ksA"]
    loaded = TRUTH.position_stiffness_n_per_m[0] * (1 + (current[0] / TRUTH.bias_current_a[0]) ** 2)
    # what the force has beyond proportion at 0.15 A is taken as that of an unloaded bearing
    assert ks.value == pytest.approx(loaded, rel=4e-3)


def test_a_hanging_rotor_has_none() -> None:
    data = observed(experiment(true_rig(TRUTH)), DATASHEET)
    assert data.nuisance.rig.static_current_a is None
    assert not any("static load" in note for note in data.notes)


@pytest.mark.slow
def test_a_rotor_off_its_centre_that_an_integrator_holds_is_told() -> None:
    """Without a load its mean current takes the pull off: ki and ks gain 1/(1 - xi^2), a third and a sixth as much."""
    off = {"offset_xA_m": 4.5e-5, "offset_xB_m": -3e-5, "offset_yA_m": 0.0, "offset_yB_m": 0.0}
    rig = with_effects(true_rig(TRUTH), {"off_centre_rotor": off})
    e, _ = held(rig, -rig.magnets.bias_current_a * rig.magnets.offset_m / rig.magnets.gap_m)
    d = diagnose(*one_plane(e, DATASHEET))
    assert d.verdict.effects == ("off_centre_rotor",)
    found = d.chosen.fit.values[0]
    assert [found["offset_xA_m"], found["offset_xB_m"]] == pytest.approx([4.5e-5, -3e-5], rel=0.1)
