"""A signal that the loop saw otherwise than it was logged: told as that, however faint, and not where it is none."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.diagnose import diagnose
from sim.effects import CATALOGUE
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.no_cover  # other tests cover the lines; traced they take a third longer

DISPLACEMENT = "the logged displacement is not the one that the controller used"
CURRENT = "the logged coil current is not the one that moves the rotor"


def later(s: Sweep, signal: str, delay_s: float) -> Sweep:
    """The sweep with one of its signals logged that much later than the loop has it."""
    omega = 2 * np.pi * s.frequency_hz[:, None] * np.array(HARMONICS)
    return replace(s, **{signal: getattr(s, signal) * np.exp(-1j * omega * delay_s)[:, None, :, None]})


@pytest.mark.parametrize(
    ("signal", "delay_s", "reason"),
    [
        ("Y", 50e-6, DISPLACEMENT),
        # the plant shows so little of it that chi-square stays below the number of values
        ("Y", 1e-6, DISPLACEMENT),
        ("I", 50e-6, CURRENT),
        ("I", 5e-6, CURRENT),
    ],
)
def test_a_signal_logged_late_is_a_fault_of_the_log(signal: str, delay_s: float, reason: str) -> None:
    datasheet, truth = known_datasheet(seed=35)
    measured = experiment(true_rig(truth))
    sweeps = tuple(later(s, signal, delay_s) for s in measured.sweeps)
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
