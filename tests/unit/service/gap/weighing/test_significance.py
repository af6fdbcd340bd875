"""Noise is hardly ever significant, however few values there are; what was not weighed says nothing."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from service.gap.weighing.significance import OUTLIER, SIGNIFICANT, mean_power, overall, worst

RUNS, CELLS, CHANNELS = 2000, 6, 16


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Complex residuals in units of their standard deviation, as a right twin leaves them."""
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("bound", [OUTLIER, np.inf])
@pytest.mark.parametrize("points", [1, 2, 3, 5, 12, 40])
def test_noise_alone_is_not_significant(points: int, bound: float) -> None:
    """The deviate after the number of cells is 5: by chance in one of three million."""
    rng = np.random.default_rng(points)
    alarms = 0
    for _ in range(RUNS):
        alarms += worst(list(noise(rng, CELLS, points, CHANNELS)), bound) > SIGNIFICANT
    assert alarms <= 1


def test_of_many_cells_the_worst_is_as_rarely_significant_as_one_alone() -> None:
    """Of 96 channels the worst is two deviates high nearly always; after that number of tests, in one of 40."""
    rng = np.random.default_rng(7)
    alarms = [worst(list(noise(rng, CELLS, 40, CHANNELS))) > norm.isf(0.025) for _ in range(RUNS)]
    assert np.mean(alarms) == pytest.approx(0.025, abs=0.025)


@pytest.mark.parametrize("values", [4, 8, 12, 20, 31])
def test_a_few_values_are_as_rarely_significant_as_is_said(values: int) -> None:
    """Cells of one size that are all at the square that noise exceeds once in a thousand million."""
    p = 1e-9
    z = np.full((values, 1), np.sqrt(2 * chi2.isf(p, values) / values), dtype=complex)
    assert norm.sf(worst([z])) == pytest.approx(p, rel=1e-3)


def test_a_gap_of_a_few_values_is_significant() -> None:
    rng = np.random.default_rng(1)
    assert worst([noise(rng, 4, 3) + 8.0]) > SIGNIFICANT


def test_what_was_not_weighed_dilutes_nothing() -> None:
    z = 1.2 * noise(np.random.default_rng(2), 72, 4, 12)
    padded = np.concatenate([z, np.zeros_like(z)], axis=2)
    assert overall(padded) == pytest.approx(overall(z))
    assert overall(padded) > SIGNIFICANT
    assert mean_power(padded) == pytest.approx(1.44, rel=0.05)
    assert mean_power(np.zeros(3, dtype=complex)) == 0.0
