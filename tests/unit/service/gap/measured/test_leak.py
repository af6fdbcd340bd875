"""What the slow rest of a start leaks into the harmonics of the low lines is counted, and nothing else is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.fitting.predict import residual
from service.gap.measured import observation
from service.gap.measured.leak import leaked, periods
from service.gap.measured.observation import Observation, observe
from service.gap.weighing.significance import significance
from sim.reference import reference_rig
from sim.stepping import Simulation

RIG = reference_rig()
RATE_HZ = 1 / RIG.controller.sample_time_s
HARMONICS, BLOCKS = (0, 1, 2, 3), 6


@cache
def low_lines(settle_s: float, offset_a: float) -> Sweep:
    """Low lines of a clean rig, each begun anew: the excitation starts with a step that the integrator takes out."""
    simulation, periods_of = Simulation(RIG, seed=3), np.array([1, 1, 1, 2])
    samples = np.round(periods_of * RATE_HZ / np.array([10.1, 12.3, 14.9, 33.0])).astype(int)
    line, axis = np.repeat(np.arange(4), RIG.n_axes), np.tile(np.arange(RIG.n_axes), 4)
    found: dict[str, list[np.ndarray]] = {s: [] for s in "ruiy"}
    for k, a in zip(line, axis, strict=True):
        start, n = round(settle_s * RATE_HZ), samples[k]
        t = np.arange(start + BLOCKS * n)
        r = np.zeros((len(t), RIG.n_axes))
        r[:, a] = 0.1 * np.cos(2 * np.pi * periods_of[k] * (t - start) / n) * np.minimum(1, t / 400) - offset_a
        simulation.levitate()
        record = simulation.advance(r, check_limits=False)
        turn = np.exp(-2j * np.pi * periods_of[k] * np.outer(HARMONICS, np.arange(n)) / n)
        scale = np.array([1 if h == 0 else 2 for h in HARMONICS])[:, None] / n
        for s in "ruiy":
            blocks = getattr(record, s)[start:].reshape(BLOCKS, n, RIG.n_axes)
            found[s].append(scale * (turn @ blocks))
    R, U, I, Y = (np.array(found[s]) for s in "ruiy")
    return Sweep(
        "stepped-sine", (periods_of * RATE_HZ / samples)[line], axis, np.full(len(axis), 0.1), HARMONICS, R, U, I, Y,
        sample_rate_hz=RATE_HZ, block_samples=samples[line],
    )  # fmt: skip


def at_harmonics(o: Observation) -> float:
    """Significance of what the true twin leaves of y at harmonics 2 and 3."""
    left = residual(RIG, o)[:, :, 2 * RIG.n_axes :]
    return max(significance(left[:, [o.harmonics.index(h)]], o, bound=np.inf) for h in (2, 3))


@pytest.mark.slow
def test_a_clean_rig_whose_integrator_has_not_settled_shows_no_harmonics(monkeypatch: pytest.MonkeyPatch) -> None:
    restless = low_lines(0.3, 0.05)
    assert at_harmonics(observe(restless, RIG)) < 2
    monkeypatch.setattr(observation, "leaked", lambda *_: 0.0)
    assert at_harmonics(observe(restless, RIG)) > 4.5, "it would show some, though its cells have four values each"


def test_a_settled_rig_is_looked_at_as_closely_as_noise_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    settled = low_lines(3.0, 0.0)
    closely = observe(settled, RIG).sd_y
    monkeypatch.setattr(observation, "leaked", lambda *_: 0.0)
    assert np.median(closely[:, 1:] / observe(settled, RIG).sd_y[:, 1:]) < 1.02


def test_a_slope_leaves_as_much_as_its_change_over_a_block_says() -> None:
    """Of y = x in every block, u = x / 2 for a model of 0.6: 0.7 of the leak of x is left."""
    n, k = 400, 3
    x = 1e-6 * np.exp(-np.arange(BLOCKS * n) / (4 * n)).reshape(BLOCKS, n)
    X = {h: (2 if h else 1) / n * x @ np.exp(-2j * np.pi * h * k * np.arange(n) / n) for h in HARMONICS}
    sweep = low_lines(0.3, 0.05).select(np.arange(len(low_lines(0.3, 0.05).axis)) < 1)
    sweep = replace(sweep, frequency_hz=np.array([k * RATE_HZ / n]), block_samples=np.array([n]))
    assert periods(sweep).tolist() == [k]
    for h in (1, 2, 3):
        of_y, of_u = X[0].real[None, :, None], X[0].real[None, :, None] / 2
        left = leaked(sweep, h, np.full((1, 1, 1), 0.6), of_y, of_u)
        assert left[0, 0] == pytest.approx(0.7 * abs(X[h].mean()), rel=0.05)
    assert periods(replace(sweep, block_samples=None)).tolist() == [1], "as few as can be"
