"""The discrete controller: its frequency response and its state-space form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rig import Array, ControlLaw

Complex = NDArray[np.complex128]


def response(law: ControlLaw, omega_rad_s: Array) -> Complex:
    """C(e^{jwT}) from -y to u, A/m, (F,), of all axes in the mean.

    Computing delay is not in it: u is logged at the sample that made it.
    """
    return _response(law.numerator, law.denominator, law, omega_rad_s)


def responses(law: ControlLaw, omega_rad_s: Array, n_axes: int) -> Complex:
    """The same of each axis, (F, n)."""
    if not law.apart:
        return np.repeat(response(law, omega_rad_s)[:, None], n_axes, axis=1)
    return np.stack([_response(b, a, law, omega_rad_s) for b, a in law.apart], axis=1)


def _response(numerator: Array, denominator: Array, law: ControlLaw, omega_rad_s: Array) -> Complex:
    z = np.exp(1j * np.asarray(omega_rad_s) * law.sample_time_s)
    return np.asarray(np.polyval(numerator, z) / np.polyval(denominator, z))


def transposed_forms(law: ControlLaw, n_axes: int) -> tuple[Array, Array]:
    """Numerators and monic denominators of each axis, for the direct form II transposed, (n, order + 1).

    One of less order than another has poles and zeros at z = 0.
    """
    laws = law.apart or ((law.numerator, law.denominator),) * n_axes
    longest = max(len(a) for _, a in laws)
    forms = [_transposed(b, a, longest) for b, a in laws]
    return np.stack([b for b, _ in forms]), np.stack([a for _, a in forms])


def _transposed(numerator: Array, denominator: Array, length: int) -> tuple[Array, Array]:
    """Both over the denominator's first coefficient, at a length; a plain gain gets one state that stays at rest."""
    b, a = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    more = np.zeros(max(length, 2) - len(a))
    return np.concatenate([np.zeros(len(a) - len(b)), b, more]) / a[0], np.concatenate([a, more]) / a[0]
