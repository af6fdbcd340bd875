"""What multiplies the answer scatters only where there is one; noise and the rest of a transient do not pass for it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.doubts.modulated_stiffness import LATE, SWINGS, modulated_stiffness, scatter_of_answer
from tests.support.synthetic import experiment, known_datasheet, true_rig

RIG = true_rig(known_datasheet(seed=6)[1])
MEASURED = experiment(RIG).sweeps


def answering(s: Sweep, gain: Callable[[np.random.Generator, tuple[int, int]], np.ndarray]) -> Sweep:
    """The sweep of a rotor whose displacement has such a gain in each block of each point, (P, B)."""
    factor = gain(np.random.default_rng(7), s.Y.shape[:2])
    return replace(s, Y=s.Y * factor[:, :, None, None])


def told(gain: Callable[[np.random.Generator, tuple[int, int]], np.ndarray]) -> str | None:
    return modulated_stiffness([answering(s, gain) for s in MEASURED], RIG)


def test_a_rig_that_only_makes_noise_does_not_swing() -> None:
    assert modulated_stiffness(MEASURED, RIG) is None
    assert all(abs(z) < LATE for s in MEASURED for z in scatter_of_answer(s, RIG)[:2])


def test_a_gain_that_swings_by_a_hundredth_is_told() -> None:
    said = told(lambda rng, shape: 1 + 0.01 * rng.standard_normal(shape))
    assert said is not None
    assert "scatter more where their own plane is driven" in said


@pytest.mark.parametrize("effect", ["logging_offset", "magnetic_hysteresis", "touchdown_contact"])
def test_a_twin_whose_effects_scatter_the_answer_is_not_doubted_for_it(effect: str) -> None:
    swinging = [answering(s, lambda rng, shape: 1 + 0.01 * rng.standard_normal(shape)) for s in MEASURED]
    assert modulated_stiffness(swinging, RIG, ["loop_delay", effect]) is None
    assert modulated_stiffness(swinging, RIG, ["loop_delay", "magnetic_saturation"]) is not None


def test_a_transient_that_decays_is_no_swing() -> None:
    def decaying(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
        return 1 + 0.03 * np.exp(-3.0 * np.arange(shape[1])) * rng.standard_normal((shape[0], 1))

    z, late, _ = scatter_of_answer(answering(MEASURED[0], decaying), RIG)
    assert z > SWINGS
    assert late < LATE
    assert told(decaying) is None


def test_noise_that_a_tone_takes_away_is_told() -> None:
    """Steps of a converter that noise alone does not cross, the other way round: here the tone lies on a step."""

    def quiet(s: Sweep) -> Sweep:
        own = s.axis[:, None] // 2 == np.arange(s.Y.shape[2]) // 2
        mean = s.Y.mean(axis=1, keepdims=True)
        return replace(s, Y=mean + (s.Y - mean) * np.where(own, 0.2, 1.0)[:, None, None])

    said = modulated_stiffness([quiet(s) for s in MEASURED], RIG)
    assert said is not None
    assert "scatter less" in said


@pytest.mark.parametrize("axes", [[0, 1], [0]])
def test_one_plane_or_one_axis_alone_cannot_tell(axes: list[int]) -> None:
    swings = answering(MEASURED[0], lambda rng, shape: 1 + 0.01 * rng.standard_normal(shape))
    assert scatter_of_answer(swings.select(np.isin(swings.axis, axes)), RIG)[0] == 0
