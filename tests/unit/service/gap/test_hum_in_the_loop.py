"""The amplitude of a hum is told through the loop that it goes round in, as well as that loop is known."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.interference import interference, measured_by
from sim.reference import reference_rig
from sim.twin import linear_model

HUM_HZ, HUM_M, NOISE_M = 50.0, 2e-7, 2e-8
BLOCKS, AXES, HARMONICS = 6, 4, (0, 1, 2, 3)


def test_a_hum_on_the_sensors_is_as_large_as_it_is_though_feedback_makes_most_of_what_is_seen() -> None:
    """A gauge of the loop whose magnets are off takes some of the feedback for the sensors' own, a right one none."""
    rng = np.random.default_rng(4)
    rig = reference_rig()
    rate_hz = 1 / rig.controller.sample_time_s
    samples = np.round(rate_hz * 0.13 * np.ones(120)).astype(int)
    frequency = np.repeat(np.linspace(35.0, 65.0, 30), 4)
    loop = linear_model(rig, np.array([HUM_HZ]))
    of_y = np.linalg.inv(np.eye(AXES) + loop.y_per_u[0] * loop.controller[0])
    assert np.abs(of_y - np.eye(AXES)).max() > 0.5, "feedback counts here"
    block = np.arange(BLOCKS)
    turned = np.exp(2j * np.pi * HUM_HZ * samples[:, None] / rate_hz * block)
    leak = np.sinc((frequency[:, None] * np.array(HARMONICS) - HUM_HZ) * samples[:, None] / rate_hz)
    phase = np.exp(2j * np.pi * rng.random(len(frequency)))
    shape = (len(frequency), BLOCKS, len(HARMONICS), AXES)
    noise = NOISE_M * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    on_sensors = HUM_M * (phase[:, None] * turned)[:, :, None, None] * leak[:, None, :, None] * np.ones(AXES) + noise
    Y = on_sensors @ of_y.T
    U = -loop.controller[0] * Y
    sweep = Sweep(
        "stepped-sine", frequency, np.tile(np.arange(4), 30), np.ones(len(frequency)), HARMONICS,
        np.ones_like(U), U, None, Y, sample_rate_hz=rate_hz, block_samples=samples,
    )  # fmt: skip
    wrong = replace(rig, magnets=replace(rig.magnets, ki=0.6 * rig.magnets.ki))
    heard = interference(sweep, wrong)
    assert [s.effect for s in heard] == ["mains_interference"]
    right = measured_by(heard[0], sweep, rig)
    assert right.parameters["amplitude_m"] == pytest.approx(HUM_M, rel=0.03)
    assert abs(right.parameters["amplitude_m"] - HUM_M) < 3 * right.std
    assert abs(right.parameters["frequency_hz"] - HUM_HZ) < 3 * right.frequency_std_hz < 1.0
    assert heard[0].parameters["amplitude_m"] != pytest.approx(HUM_M, rel=0.05)
