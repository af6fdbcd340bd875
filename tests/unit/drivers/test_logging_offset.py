"""A log whose control signal is samples early or late: what a host gets of it agrees with the r that it asked for."""

import numpy as np
import pytest

from drivers.controller import Tone
from drivers.device.machine import RigDevice
from drivers.simulated.driver import SimulatedController
from sim import control_law
from sim.effects import effect
from sim.reference import reference_rig
from sim.rig import Noise

RATE_HZ = 10_000.0


@pytest.mark.parametrize("samples", [0.0, 1.0, 2.0, -1.0])
@pytest.mark.parametrize(("periods", "frequency_hz"), [(4, 20.0), (160, 800.0)])
def test_u_leads_what_the_controller_makes_of_r_and_y_by_the_offset(samples, periods, frequency_hz):
    rig = reference_rig(noise=Noise())
    if samples:
        rig = effect("logging_offset").on(rig, samples=samples)
    device = RigDevice(rig)
    controller = SimulatedController(device)
    with controller.lease("test"):
        tone = Tone(axis=0, amplitude_a=0.05, periods=periods, samples=2000, blocks=2, settle_samples=20_000)
        point = controller.measure(tone)
    controller.close()
    device.close()
    omega = 2 * np.pi * frequency_hz
    C = control_law.response(rig.controller, np.array([omega]))[0]
    u, r, y = (x[:, 1, 0].mean() for x in (point.U, point.R, point.Y))
    lead = np.angle(u / (r - C * y)) / omega * RATE_HZ
    assert lead == pytest.approx(samples, abs=0.02)
