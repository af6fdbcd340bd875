"""Products of a line's matrices with the amplitudes at its points are those of numpy, whatever the arrays' layout."""

import numpy as np
import pytest

from sim.at_points import responses


@pytest.mark.parametrize("harmonics", [None, 3])
@pytest.mark.parametrize("turned", [False, True], ids=["in order", "transposed in memory"])
def test_each_point_has_the_matrix_of_its_line(harmonics, turned):
    rng = np.random.default_rng(4)

    def some(*shape: int) -> np.ndarray:
        x = rng.normal(size=shape) + 1j * rng.normal(size=shape)
        return np.asfortranarray(x) if turned else x

    line = rng.integers(0, 5, size=17)
    if harmonics is None:
        matrices, x = some(5, 2, 4), some(17, 4)
        expected = (matrices[line] @ x[..., None])[..., 0]
    else:
        matrices, x = some(harmonics, 5, 2, 4), some(17, harmonics, 4)
        expected = (matrices.swapaxes(0, 1)[line] @ x[..., None])[..., 0]
    x.flags.writeable = False
    np.testing.assert_allclose(responses(matrices, line, x), expected, rtol=1e-12)
    real = responses(matrices.real, line.astype(np.int32), x.real)
    np.testing.assert_allclose(real, responses(matrices.real + 0j, line, x.real + 0j), rtol=1e-12)


@pytest.mark.parametrize(
    ("line", "x", "error"),
    [
        (np.array([0, 5]), np.ones((2, 4)), IndexError),
        (np.array([0, -1]), np.ones((2, 4)), IndexError),
        (np.array([0, 1]), np.ones((3, 4)), ValueError),
        (np.array([0, 1]), np.ones((2, 3)), ValueError),
    ],
)
def test_points_that_no_matrix_is_for_are_refused(line, x, error):
    with pytest.raises(error):
        responses(np.ones((5, 2, 4), dtype=complex), line, x)
