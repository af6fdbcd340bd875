"""Each part of the loop is diagnosed on its own input: mixtures, logs at fault, interference, one amplitude only."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import parts
from service.gap.fitting.predict import control, weight
from service.gap.interference import interference
from service.gap.measured.observation import observe
from service.gap.weighing.significance import SIGNIFICANT, significance
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def spoiled(measured: Experiment, change) -> Experiment:
    return replace(measured, sweeps=tuple(change(s) for s in measured.sweeps))


def test_effects_of_two_parts_are_both_named_however_different_in_size() -> None:
    """A controller far off and a sensor gain of 4 %: the one does not drown the other."""
    datasheet, truth = known_datasheet(seed=11)
    both = {"controller_mismatch": {"gain_change": 0.08, "derivative_change": 0.0, "lag_samples": 0.0}}
    both["sensor_gain"] = dict.fromkeys((f"gain_change_{a}" for a in ("xB", "yA", "yB")), 0.0) | {
        "gain_change_xA": 0.08
    }
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet))
    assert set(d.verdict.effects) == set(both)
    assert gap_document(d)["where"]["path"] == "controller"


def test_a_stop_that_only_the_larger_amplitude_reaches_is_named() -> None:
    datasheet, truth = known_datasheet(seed=14)
    rig = true_rig(truth)
    quiet = experiment(rig)
    swing = [np.abs(s.Y[:, :, s.harmonics.index(1)]).max() for s in quiet.sweeps]
    assert swing[1] > 1.3 * swing[0]
    clearance = float(np.sqrt(swing[0] * swing[1]))
    stop = {f"clearance_{axis}_m": clearance for axis in rig.axes} | {"stiffness_n_per_m": 3e5, "side": 0.0}
    d = diagnose(*one_plane(experiment(with_effects(rig, {"touchdown_contact": stop})), datasheet))
    assert d.verdict.effects == ("touchdown_contact",)
    assert d.where.depends.amplitude
    assert "every other line" in d.shrinkage.held_out, "what was fitted is not what closure is measured on"
    found = d.chosen.fit.values[0]
    assert found["clearance_xA_m"] == pytest.approx(clearance, rel=0.1)


def test_what_only_the_larger_amplitude_shows_is_no_fault_of_the_log_beside_a_delay() -> None:
    """By the first sweep, which explains the amplifiers, the plant has no gap, with currents or without."""
    datasheet, truth = known_datasheet(seed=16)
    iron = {"saturation_inverse_per_a": 0.0, "flux_share": 0.66, "flux_power": 6.0}
    both = {"magnetic_saturation": iron, "loop_delay": {"delay_s": 1e-5}}
    rig = with_effects(true_rig(truth), both)
    quiet, loud = (experiment(rig, amplitude_a=a) for a in (0.05, 0.2))
    d = diagnose(*one_plane(replace(quiet, sweeps=(quiet.sweeps[0], loud.sweeps[1])), datasheet))
    assert set(d.verdict.effects) == set(both)


def hummed(s: Sweep, hz: float, amplitude_m: float, seed: int) -> Sweep:
    """Displacement with a hum whose phase drifts from block to block, seen where a harmonic comes near it."""
    rng = np.random.default_rng(seed)
    at = s.frequency_hz[:, None] * np.array(s.harmonics)
    near = amplitude_m / (1 + (np.abs(at / hz - 1) / 0.03) ** 2)
    phase = np.exp(2j * np.pi * rng.random((s.n_points, s.Y.shape[1])))
    return replace(s, Y=s.Y + (near[:, None, :] * phase[:, :, None])[..., None])


def test_hum_of_the_mains_is_heard_in_the_scatter_and_named() -> None:
    datasheet, truth = known_datasheet(seed=15)
    measured = experiment(true_rig(truth))
    loud = replace(measured, sweeps=tuple(hummed(s, 50.0, 30e-9, seed=k) for k, s in enumerate(measured.sweeps)))
    rig = nuisance(datasheet).rig
    assert interference(measured.sweeps[0], rig) == []
    heard = interference(loud.sweeps[0], rig)
    assert [s.effect for s in heard] == ["mains_interference"]
    assert 6e-9 < heard[0].parameters["amplitude_m"] < 36e-9, "no line of the sweep meets the mains exactly"
    d = diagnose(loud, datasheet)
    assert d.verdict.effects == ("mains_interference",)
    assert gap_document(d)["where"]["path"] == "additive"


def test_noise_that_is_less_above_the_mains_is_no_hum() -> None:
    """As where low lines are measured in shorter blocks than those above: near 50 Hz it is what it is at 25 Hz."""
    datasheet, truth = known_datasheet(seed=15)
    s, rng = sweep(true_rig(truth), lines(80), 0.15, seed=1), np.random.default_rng(3)
    at = s.frequency_hz[:, None] * np.array(s.harmonics)
    sd = np.where(at < 56.0, 600e-9, 20e-9)[:, None, :, None]
    white = rng.standard_normal(s.Y.shape) + 1j * rng.standard_normal(s.Y.shape)
    assert interference(replace(s, Y=s.Y + sd * white), nuisance(datasheet).rig) == []


def test_without_the_current_amplifier_and_plant_are_one_part() -> None:
    datasheet, truth = known_datasheet()
    nu = nuisance(datasheet)
    o = observe(experiment(true_rig(truth)).sweeps[0], nu.rig)
    assert [p.path for p in parts(nu, [o])] == ["controller", "amplifier", "plant"]
    merged = parts(nu, [replace(o, I=None)])
    assert [p.path for p in merged] == ["controller", "plant"]
    assert {"loop_delay", "eddy_currents"} <= set(merged[1].effects)


def test_a_rotor_at_rest_cannot_tell_modal_from_internal_damping() -> None:
    datasheet, truth = known_datasheet(seed=16)
    ratio = {"mode1_log_ratio": 1.5, "mode2_log_ratio": 1.5}
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), {"modal_damping": ratio})), datasheet))
    assert d.verdict.effects == ("modal_damping",)
    assert ("modal_damping", "internal_damping") in d.verdict.indistinguishable


def test_a_rotor_that_hardly_moves_is_diagnosed_too() -> None:
    """A stop is looked for within a rotor's swing, which may be below the smallest clearance of the catalogue."""
    datasheet, truth = known_datasheet(seed=17)
    small = experiment(true_rig(truth), amplitude_a=0.004)
    assert max(np.abs(s.Y[:, :, 1]).max() for s in small.sweeps) < 1e-6
    assert diagnose(*one_plane(small, datasheet)).verdict.kind == "no_gap"


def test_a_lag_that_amplifiers_of_a_wide_datasheet_could_make_up_for_is_no_fault_of_the_log() -> None:
    datasheet, truth = known_datasheet(seed=54)
    wide = replace(datasheet.tolerance, amplifier_frequency=0.015, amplifier_damping=0.03)
    both = {
        "amplifier_bandwidth": {"frequency_change": 0.02, "damping_change": 0.0},
        "eddy_currents": {"time_constant_s": 5e-9, "corner_rad_s": 1.0},
    }
    quiet = experiment(with_effects(true_rig(truth), both), noise=0.25)
    d = diagnose(*one_plane(quiet, replace(datasheet, tolerance=wide)))
    assert "eddy_currents" in d.verdict.effects


def test_a_drift_beside_a_controller_that_differs_is_no_fault_of_the_log() -> None:
    """Worked out from a controller that is not the rig's, y is so uncertain that it would hide a small drift."""
    datasheet, truth = known_datasheet(seed=18)
    both = {
        "controller_mismatch": {"gain_change": -0.03, "derivative_change": 0.0, "lag_samples": 0.0},
        "thermal_drift": {"ki_change": -0.013, "ks_change": -0.02, "duration_s": 300.0},
    }
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet))
    assert set(d.verdict.effects) == set(both)


@pytest.mark.parametrize("hz", [100.0, 250.0])
def test_the_hum_of_a_rectifier_is_heard_too(hz: float) -> None:
    datasheet, truth = known_datasheet(seed=15)
    measured = experiment(true_rig(truth))
    loud = replace(measured, sweeps=tuple(hummed(s, hz, 30e-9, seed=k) for k, s in enumerate(measured.sweeps)))
    heard = interference(loud.sweeps[0], nuisance(datasheet).rig)
    assert [(s.effect, s.frequency_hz) for s in heard] == [("mains_interference", hz)]


def test_a_controller_is_held_to_its_law_as_closely_as_arithmetic_allows() -> None:
    """It shows where it is off by less than two programs' rotors are."""
    datasheet, truth = known_datasheet(seed=16)
    nu = nuisance(datasheet)
    off = {"gain_change": 2e-4, "derivative_change": 0.0, "lag_samples": 0.0}
    o = observe(experiment(with_effects(true_rig(truth), {"controller_mismatch": off})).sweeps[0], nu.rig)
    assert significance((o.U - control(nu.rig, o)) * weight(o, "u"), o) > SIGNIFICANT
