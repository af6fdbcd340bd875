"""A signal that the loop saw otherwise than it was logged: told as that, however faint, and not where it is none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.diagnose import diagnose
from service.gap.doubts.log import as_the_controller_saw
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

DISPLACEMENT = "the logged displacement is not the one that the controller used"
CURRENT = "the logged coil current is not the one that moves the rotor"


def late(s: np.ndarray, delay_s: float) -> np.ndarray:
    return np.exp(-s * delay_s)


def filtered(s: np.ndarray, corner_hz: float) -> np.ndarray:
    return 1 / (1 + s / (2 * np.pi * corner_hz))


def logged_through(sweep: Sweep, signal: str, law: Callable[[np.ndarray, float], np.ndarray], value: float) -> Sweep:
    """The sweep with one signal logged through a law of s = j omega that the loop does not see."""
    s = 2j * np.pi * sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    return replace(sweep, **{signal: getattr(sweep, signal) * law(s, value)[:, None, :, None]})


@pytest.mark.parametrize(
    ("signal", "law", "value", "reason"),
    [
        ("Y", late, 50e-6, DISPLACEMENT),
        # the plant shows so little of it that chi-square stays below the number of values
        ("Y", late, 1e-6, DISPLACEMENT),
        ("I", filtered, 4e3, CURRENT),
        ("I", filtered, 30e3, CURRENT),
    ],
)
def test_a_signal_that_is_logged_otherwise_is_no_effect_of_the_rig(signal, law, value, reason) -> None:
    """Two parts of the loop seem off, but neither is."""
    datasheet, truth = known_datasheet(seed=35)
    measured = experiment(true_rig(truth))
    sweeps = tuple(logged_through(s, signal, law, value) for s in measured.sweeps)
    verdict = diagnose(*one_plane(replace(measured, sweeps=sweeps), datasheet)).verdict
    assert (verdict.kind, verdict.reasons) == ("none_of_these", (reason,))


def test_a_lagging_sensor_beside_another_controller_is_no_fault_of_the_log() -> None:
    """Both parts have a gap then as well, the plant's as faint."""
    datasheet, truth = known_datasheet(seed=35)
    rig = CATALOGUE["controller_mismatch"].on(true_rig(truth), gain_change=0.02)
    rig = CATALOGUE["sensor_lag"].on(rig, time_constant_s=1.5e-6)
    verdict = diagnose(*one_plane(experiment(rig), datasheet)).verdict
    assert verdict.kind == "effects"
    assert verdict.effects[0] == "controller_mismatch"
    assert {"sensor_lag", "eddy_currents"} & {*verdict.effects, *(n for g in verdict.indistinguishable for n in g)}


@pytest.mark.parametrize("samples", [0.0, 1.0])
def test_the_displacement_is_computed_through_the_log_that_the_twin_names(samples: float) -> None:
    datasheet, truth = known_datasheet(seed=35)
    late = {"logging_offset": {"samples": samples}}
    nu = nuisance(replace(datasheet, effects=tuple((name, tuple(v.items())) for name, v in late.items())))
    o = observe(sweep(with_effects(true_rig(truth), late), lines(), 0.15, seed=1), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    point, axis = np.arange(len(o.axis)), o.axis
    seen, logged = (x.Y[point, o.fundamental, axis] for x in (as_the_controller_saw(ground, o), o))
    assert np.median(np.abs(seen / logged - 1)) < 1e-3
