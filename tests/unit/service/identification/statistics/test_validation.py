"""Tests of residuals reject what they should, and no more often than they say."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.loop.margins import zone
from service.identification.statistics.evidence import Evidence, best
from service.identification.statistics.portmanteau import _white, portmanteau
from service.identification.statistics.validation import all_pass, independence, nrmse_matrix, nrmse_percent, whiteness

RNG = np.random.default_rng(7)


def noise(n: int) -> np.ndarray:
    return (RNG.normal(size=n) + 1j * RNG.normal(size=n)) / np.sqrt(2)


def test_white_residuals_pass_at_the_stated_level() -> None:
    p = np.array([whiteness("", noise(150)).p_value for _ in range(400)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.035)


def test_the_level_of_whiteness_holds_far_out_where_lags_are_many() -> None:
    """One in a hundred of records of 40 lines: the chi-square of long records would reject three times as many."""
    p = np.array([whiteness("", noise(40)).p_value for _ in range(1500)])
    assert np.mean(p < 0.01) == pytest.approx(0.01, abs=0.01)


@pytest.mark.parametrize(("n", "lags"), [(9, 3), (40, 13), (150, 15)])
def test_a_portmanteau_has_the_moments_that_it_is_judged_by(n: int, lags: int) -> None:
    e = noise(6000 * n).reshape(6000, n)
    power = np.sum(np.abs(e) ** 2, axis=1)
    total = np.zeros(6000)
    for k in range(1, lags + 1):
        rho = np.sum(e[:, :-k].conj() * e[:, k:], axis=1) / power
        total += 2 * n * (n + 1) * np.abs(rho) ** 2 / (n - k)
    assert portmanteau(e[0], np.arange(1, lags + 1))[1] == pytest.approx(total[0])
    mean, std, skewness = _white(n, lags)
    assert mean == pytest.approx(2 * lags)
    assert mean == pytest.approx(total.mean(), abs=4 * std / np.sqrt(6000))
    assert std == pytest.approx(total.std(), rel=0.06)
    assert skewness == pytest.approx(np.mean(((total - mean) / std) ** 3), rel=0.2)


def test_the_level_of_independence_holds_in_short_records() -> None:
    direction = np.exp(1j * np.linspace(0, 6, 16))
    p = np.array([independence("", noise(16), direction).p_value for _ in range(6000)])
    for level in (0.05, 0.5):
        assert np.mean(p < level) == pytest.approx(level, rel=0.2)


def test_independent_residuals_pass_though_the_direction_turns_slowly() -> None:
    direction = np.exp(1j * np.linspace(0, 2, 150))
    p = np.array([independence("", noise(150), direction).p_value for _ in range(400)])
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.035)


def test_a_relative_error_is_seen() -> None:
    direction = np.exp(1j * np.linspace(0, 6, 150))
    test = independence("", noise(150) + 0.6 * direction, direction)
    assert test.p_value < 1e-4
    assert test.correlation[test.lags == 0][0] > test.bound


def test_smooth_residuals_are_not_white() -> None:
    smooth = np.convolve(noise(160), np.ones(5), mode="valid")
    test = whiteness("", smooth)
    assert test.p_value < 1e-6
    assert not all_pass([test])


def test_many_tests_reject_a_right_model_no_more_often_than_one() -> None:
    """Of 16 channels one has a p-value below 0.01 in every seventh experiment."""
    passed = [all_pass([whiteness("", noise(60)) for _ in range(16)]) for _ in range(150)]
    assert np.mean(passed) > 0.95


def test_nrmse_counts_against_the_mean() -> None:
    g = noise(50)
    assert nrmse_percent(g, g + 0.1 * (g - g.mean())) == pytest.approx(90)
    matrix = np.stack([[g, g], [g, g]]).transpose(2, 0, 1)
    assert nrmse_matrix(matrix, matrix).tolist() == [[100.0, 100.0], [100.0, 100.0]]


def test_zones() -> None:
    assert zone(10 ** (9.4 / 20)) == "A"
    assert zone(10 ** (9.6 / 20)) == "B"
    assert zone(3.0, (("good", 6.0), ("bad", float("inf")))) == "bad"


def test_the_simpler_model_is_kept_until_a_richer_one_clearly_pays() -> None:
    simple = Evidence("simple", 4, 500, 520.0)
    same = Evidence("richer, no better", 10, 500, 515.0)
    better = Evidence("richer, better", 10, 500, 400.0)
    assert best([simple, same]) == 0
    assert best([simple, same, better]) == 2
    assert better.mdl - simple.mdl == pytest.approx(500 * np.log(400 / 520) + 6 * np.log(500)), "Rissanen: k log N"
    assert better.aic < simple.aic
    assert better.fpe < simple.fpe
