"""The discrete controller: its frequency response and its state-space form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rig import Array, ControlLaw


def response(law: ControlLaw, omega_rad_s: Array) -> NDArray[np.complex128]:
    """C(e^{jwT}) from -y to u, A/m, (F,). Computing delay is not in it: u is logged at the sample that made it."""
    z = np.exp(1j * np.asarray(omega_rad_s) * law.sample_time_s)
    return np.asarray(np.polyval(law.numerator, z) / np.polyval(law.denominator, z))


def transposed_form(law: ControlLaw) -> tuple[Array, Array]:
    """Monic denominator and numerator padded to its length, for the direct form II transposed."""
    a = np.asarray(law.denominator, dtype=float)
    if len(a) == 1:  # a plain gain: give it one state that stays at rest
        return np.array([law.numerator[0] / a[0], 0.0]), np.array([1.0, 0.0])
    b = np.concatenate([np.zeros(len(a) - len(law.numerator)), np.asarray(law.numerator, dtype=float)])
    return b / a[0], a / a[0]
