"""The deviations of u and y are those of what the true rig leaves of their means, however stiff the loop."""

from functools import cache

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.measured.block_ends import NEIGHBOURS
from service.gap.measured.scatter import block_scatter, mean_scatter
from sim.harmonic_balance import time_points
from sim.rig import Rig
from sim.stepping import Simulation
from sim.twin import linear_model
from tests.support.whole_rigs import levitating

HARMONICS, BLOCKS, LINES_HZ = (0, 1, 2, 3), 6, np.geomspace(10, 200, 24)
LOW_HZ = 40.0


@cache
def stiff() -> Rig:
    """A rig whose loop hides nine tenths of the sensors' noise below 40 Hz."""
    _, rig, _, _ = next(levitating([4]))
    return rig


@cache
def measured() -> Sweep:
    """Its lines, one after the other, at an amplitude at which it is linear."""
    rig, rate = stiff(), 1 / stiff().controller.sample_time_s
    samples = np.round(rate / LINES_HZ).astype(int)
    line, axis = np.repeat(np.arange(len(samples)), rig.n_axes), np.tile(np.arange(rig.n_axes), len(samples))
    simulation, amplitude = Simulation(rig, seed=1), 2e-3 * float(rig.magnets.bias_current_a[0])
    simulation.levitate()
    found: dict[str, list[np.ndarray]] = {s: [] for s in "ruiy"}
    for k, a in zip(line, axis, strict=True):
        n = samples[k]
        turn = 2 * np.pi * np.arange((BLOCKS + 3) * n) / n
        r = np.zeros((len(turn), rig.n_axes))
        r[:, a] = amplitude * np.sin(turn)
        record = simulation.advance(r, check_limits=False)
        scale = np.array([1 if h == 0 else 2 for h in HARMONICS])[:, None] / n
        for s in "ruiy":
            blocks = getattr(record, s)[3 * n :].reshape(BLOCKS, n, rig.n_axes)
            found[s].append(scale * (np.exp(-1j * np.outer(HARMONICS, turn[:n])) @ blocks))
    R, U, I, Y = (np.array(found[s]) for s in "ruiy")
    return Sweep(
        "stepped-sine", (rate / samples)[line], axis, np.full(len(axis), amplitude), HARMONICS, R, U, I, Y,
        sample_rate_hz=rate, block_samples=samples[line],
    )  # fmt: skip


def left_of_y(harmonic: int) -> np.ndarray:
    """What the true rig leaves of the mean of y, (P, n), m."""
    sweep, k = measured(), HARMONICS.index(harmonic)
    frequency, line = time_points(sweep.frequency_hz)
    G = linear_model(stiff(), np.maximum(harmonic * frequency, 1e-2)).y_per_u[line]
    U, Y = sweep.U[:, :, k].mean(axis=1), sweep.Y[:, :, k].mean(axis=1)
    return np.asarray(Y - np.einsum("pij,pj->pi", G, U))


@pytest.mark.parametrize("harmonic", HARMONICS)
@pytest.mark.parametrize("low", [True, False])
def test_the_deviations_are_those_of_the_mean(harmonic: int, low: bool) -> None:
    there = (measured().frequency_hz < LOW_HZ) == low
    _, _, of_y = mean_scatter(measured(), stiff())
    ratio = np.mean(np.abs(left_of_y(harmonic)[there]) ** 2 / of_y[there, HARMONICS.index(harmonic)])
    assert 0.75 < np.sqrt(ratio) < 1.25


def test_what_y_shows_itself_is_much_less_and_independent_blocks_would_be_much_more() -> None:
    sweep, k, low = measured(), HARMONICS.index(2), measured().frequency_hz < LOW_HZ / 2
    left = np.sqrt(np.mean(np.abs(left_of_y(2)[low]) ** 2))
    assert np.sqrt(np.var(sweep.Y[low, :, k], axis=1).mean() / (BLOCKS - 1)) < left / 2
    assert np.sqrt(np.median(block_scatter(sweep, stiff())[2][low, k])) > 1.5 * left
    assert low.sum() > NEIGHBOURS
