"""When a pass of a fit has converged."""

from service.gap.fitting.stage import COARSE, EXACT

NOISE = 4400.0


def test_an_exact_fit_goes_on_while_a_chi_square_falls_that_evidence_would_see() -> None:
    """Most of this cost is noise: by a share of it, two units, fits ended along flat directions above the optimum."""
    assert EXACT.negligible(NOISE, NOISE) < 1.0
    assert EXACT.negligible(0.9 * NOISE, NOISE) == EXACT.negligible(NOISE, NOISE) > 0.0


def test_what_an_explanation_leaves_far_above_noise_need_not_be_fitted_so_finely() -> None:
    assert EXACT.negligible(1e6, NOISE) > 100.0


def test_a_rough_pass_ends_by_a_share_of_its_cost() -> None:
    assert COARSE.negligible(1000.0, NOISE) == 1000.0 * COARSE.tolerance
    assert COARSE.negligible(0.0, NOISE) == COARSE.tolerance
