"""The amplitude of a hum is told through the loop that it goes round in, as well as that loop is known."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.compose import Composition, with_interference
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.interference import Interference, interference, measured_by
from service.gap.weighing.verdict import Ranked, Verdict
from service.gap.which.rivals import left_together
from sim.effects import CATALOGUE
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
    assert heard[0].parameters["amplitude_m"] != pytest.approx(HUM_M, rel=0.05)


def test_an_explanation_beside_a_hum_is_listed_once_and_has_none_without_it_for_a_rival() -> None:
    """The hum was heard: no experiment is needed to tell it from its absence."""
    rig = reference_rig()

    def ranked(effects: tuple[str, ...], evidence: float, probability: float) -> Ranked:
        values = tuple({p.name: p.typical for p in CATALOGUE[name].parameters} for name in effects)
        fit = Fit(effects, np.zeros(1), values, rig, (), 0.0, np.arange(1), np.eye(1), "converged")
        return Ranked(Candidate(effects, fit, 0.0, values), evidence, probability, 0.0, (0.0, 0.0))

    lag, rotor, plain = (
        ranked(("sensor_lag",), -10.0, 0.9),
        ranked(("rotor_inertia",), -12.0, 0.1),
        ranked((), -99.0, 0.0),
    )
    hum = Interference("mains_interference", HUM_HZ, {"amplitude_m": HUM_M}, HUM_M / 10, 0.0, 9.0, 20.0, "y")
    order = with_interference(Composition((lag, rotor, plain)), (hum,)).order
    both = ("sensor_lag", "mains_interference")
    assert [r.candidate.effects for r in order] == [both, ("rotor_inertia",), ()]
    pair = left_together(order, Verdict("effects", both, (), 0.9, ()))
    assert pair is not None
    assert pair[1].effects == ("rotor_inertia",)
    assert left_together((order[0], order[2]), Verdict("effects", both, (), 0.9, ())) is None
    alone = with_interference(Composition((plain, lag)), (hum,)).order
    assert [r.candidate.effects for r in alone] == [("mains_interference",), (), ("sensor_lag",)]
