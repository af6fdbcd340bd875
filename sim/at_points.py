"""Responses at many points of a few lines, compiled: numpy would copy a line's matrix for each of its points.

>>> import numpy as np
>>> responses(np.array([[[2j]], [[3j]]]), np.array([1, 1, 0]), np.ones((3, 1), dtype=complex))[:, 0].imag
array([3., 3., 2.])
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Index = NDArray[np.int64]


def responses(matrices: Complex, line: Index, x: Complex) -> Complex:
    """Matrices of lines times the amplitudes at each point of theirs.

    Parameters
    ----------
    matrices : (F, a, b), or (H, F, a, b) of each harmonic
    line : (P,) index of each point's line
    x : (P, b), or (P, H, b)

    Returns
    -------
    (P, a), or (P, H, a)

    Raises
    ------
    IndexError
        No such line.
    ValueError
        Other numbers of points or harmonics.
    """
    if matrices.ndim == 3:
        return np.asarray(responses(matrices[None], line, x[:, None])[:, 0])
    given = _as_read_only(matrices, complex), _as_read_only(line, np.int64), _as_read_only(x, complex)
    return np.asarray(_responses(*given))


def _as_read_only(a: NDArray[np.generic], dtype: type[complex] | type[np.int64]) -> NDArray[np.generic]:
    """Of the one kind that the function is compiled for."""
    out = np.ascontiguousarray(a, dtype=dtype).view()
    out.flags.writeable = False
    return out


def _kind(dtype: numba.types.Type, dimensions: int) -> numba.types.Type:
    return numba.types.Array(dtype, dimensions, "C", readonly=True)


# Made ready as the module is loaded, and numba with it, which takes 0.4 s: processes that begin as copies of one that
# has loaded it share that.
_RESULT = numba.types.Array(numba.complex128, 3, "C")


@numba.njit(
    _RESULT(_kind(numba.complex128, 4), _kind(numba.int64, 1), _kind(numba.complex128, 3)), cache=True, nogil=True
)
def _responses(matrices, line, x):  # type: ignore[no-untyped-def]  # pragma: no cover (compiled)
    harmonics, lines, rows, columns = matrices.shape
    if x.shape != (len(line), harmonics, columns):
        raise ValueError("amplitudes of other numbers of points, harmonics or axes than lines and matrices have")
    if len(line) and not (line.min() >= 0 and line.max() < lines):
        raise IndexError("a point on a line of which there is no matrix")
    out = np.zeros((len(line), harmonics, rows), dtype=np.complex128)
    for p in range(len(line)):
        for h in range(harmonics):
            for a in range(rows):
                total = 0j
                for b in range(columns):
                    total += matrices[h, line[p], a, b] * x[p, h, b]
                out[p, h, a] = total
    return out
