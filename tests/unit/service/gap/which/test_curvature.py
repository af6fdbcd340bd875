"""The bounded least squares of a curvature: a minimum, between the bounds or at them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.gap.which.curvature import bounded_minimum


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.floats(-2, 2))
def test_no_bounded_change_lowers_it(seed: int, n: int, log_width: float) -> None:
    """The conditions of Karush, Kuhn and Tucker: the slope is null, or points out of the bounds."""
    draws = np.random.default_rng(seed)
    root = draws.standard_normal((n + 3, n))
    hessian, gradient = root.T @ root, draws.standard_normal(n)
    low, high = -(10**log_width) * draws.uniform(0.1, 1, n), 10**log_width * draws.uniform(0.1, 1, n)
    x = bounded_minimum(hessian, gradient, low, high)
    slope = hessian @ x - gradient
    tiny = 1e-6 * np.abs(gradient).max()
    assert np.all((low - 1e-6 <= x) & (x <= high + 1e-6))
    reach = 1e-4 * (high - low)
    assert np.all((np.abs(slope) < tiny) | ((x < low + reach) & (slope > 0)) | ((x > high - reach) & (slope < 0)))
