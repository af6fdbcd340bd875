"""The amplitude of a hum is told through the loop that it goes round in, as well as that loop is known."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.interference import interference, measured_by
from sim.reference import reference_rig
from sim.rig import Rig
from sim.twin import linear_model

HUM_HZ, HUM_M, NOISE_M = 50.0, 2e-7, 2e-8
BLOCKS, AXES, HARMONICS = 6, 4, (0, 1, 2, 3)


def hummed(rig: Rig, seed: int, on_sensors_m: float, on_currents_a: float = 0.0, noise_a: float | None = None) -> Sweep:
    """A rig without an answer to its excitation, whose sensors and currents hear a hum; i is logged with its noise."""
    rng = np.random.default_rng(seed)
    rate_hz = 1 / rig.controller.sample_time_s
    samples = np.round(rate_hz * 0.13 * np.ones(120)).astype(int)
    frequency = np.repeat(np.linspace(35.0, 65.0, 30), 4)
    loop = linear_model(rig, np.array([HUM_HZ]))
    of_y = np.linalg.inv(np.eye(AXES) + loop.y_per_u[0] * loop.controller[0])
    assert np.abs(of_y - np.eye(AXES)).max() > 0.5, "feedback counts here"
    turned = np.exp(2j * np.pi * HUM_HZ * samples[:, None] / rate_hz * np.arange(BLOCKS))
    leak = np.sinc((frequency[:, None] * np.array(HARMONICS) - HUM_HZ) * samples[:, None] / rate_hz)
    phase = np.exp(2j * np.pi * rng.random(len(frequency)))
    hum = (phase[:, None] * turned)[:, :, None, None] * leak[:, None, :, None] * np.ones(AXES)

    def white(size: float) -> np.ndarray:
        return size * (rng.standard_normal(hum.shape) + 1j * rng.standard_normal(hum.shape)) / np.sqrt(2)

    own_i = on_currents_a * hum + white(noise_a or 0.0)
    Y = (on_sensors_m * hum + white(NOISE_M) + own_i @ loop.y_per_i[0].T) @ of_y.T
    U = -loop.controller[0] * Y
    currents = None if noise_a is None else U @ loop.i_per_u[0].T + own_i
    return Sweep(
        "stepped-sine", frequency, np.tile(np.arange(4), 30), np.ones(len(frequency)), HARMONICS,
        np.ones_like(U), U, currents, Y, sample_rate_hz=rate_hz, block_samples=samples,
    )  # fmt: skip


def test_a_hum_on_the_sensors_is_as_large_as_it_is_though_feedback_makes_most_of_what_is_seen() -> None:
    """A gauge of the loop whose magnets are off takes some of the feedback for the sensors' own, a right one none."""
    rig = reference_rig()
    sweep = hummed(rig, 4, HUM_M)
    wrong = replace(rig, magnets=replace(rig.magnets, ki=0.6 * rig.magnets.ki))
    heard = interference(sweep, wrong)
    assert [s.effect for s in heard] == ["mains_interference"]
    right = measured_by(heard[0], sweep, rig)
    assert right.parameters["amplitude_m"] == pytest.approx(HUM_M, rel=0.03)
    assert abs(right.parameters["amplitude_m"] - HUM_M) < 3 * right.std
    assert abs(right.parameters["frequency_hz"] - HUM_HZ) < 3 * right.frequency_std_hz < 1.0
    assert heard[0].parameters["amplitude_m"] != pytest.approx(HUM_M, rel=0.05)


@pytest.mark.parametrize(("on_sensors_m", "on_currents_a", "signal"), [(8e-8, 0.0, "y"), (0.0, 2e-3, "i")])
def test_what_noise_makes_of_a_currents_share_is_no_hum_of_its_own(
    monkeypatch: pytest.MonkeyPatch, on_sensors_m: float, on_currents_a: float, signal: str
) -> None:
    """The controller makes currents of the sensors' hum. Few points tell the size of the currents' own, all its phase.

    A simulated rig with a faint one on its sensors was told to hear it in its currents: a third was noise.
    """
    sweep = hummed(reference_rig(), 0, on_sensors_m, on_currents_a, noise_a=1e-3)
    monkeypatch.setattr("service.gap.interference._amplitude", lambda *_: (3e-4, 1e-4, 0.34))
    (heard,) = interference(sweep, reference_rig())
    assert heard.signal == signal


def test_a_hum_that_only_the_currents_show_and_have_not_of_their_own_is_the_sensors() -> None:
    """The log of the displacement is so noisy that it does not show what the controller heard."""
    sweep = hummed(reference_rig(), 0, 8e-8, noise_a=4e-4)
    noise = 1e-6 * np.random.default_rng(1).standard_normal((*sweep.Y.shape, 2)).view(complex)[..., 0]
    assert not interference(replace(sweep, Y=sweep.Y + noise, I=None), reference_rig()), "it shows nothing by itself"
    (heard,) = interference(replace(sweep, Y=sweep.Y + noise), reference_rig())
    assert heard.signal == "y"


@pytest.mark.parametrize("blocks", [3, 4])
def test_one_hum_in_few_blocks_is_one_source_that_may_be_another(blocks: int) -> None:
    """A rotor that turns at nearly the mains: with more blocks the loudest is taken off, and nothing else is left."""
    heard = hummed(reference_rig(), 4, HUM_M)
    turning = replace(heard.with_blocks(range(blocks)), speed_rad_s=2 * np.pi * 50.05)
    (source,) = interference(turning, reference_rig())
    assert {source.effect, *source.aliases} == {"mains_interference", "runout"}
