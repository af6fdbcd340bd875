"""The magnet's force law at a finite amplitude: the fundamental of the force beyond ki i + ks x.

Differential drive (notes of `sim.rig.Magnets`): f = ki i0 (a + b)(1 + a b)/(1 - b^2)^2 with a = i/i0, b = x/s0 and
s0 = i0 ki/ks. To third order a + b + a^2 b + 3 a b^2 + 2 b^3; here the fundamental is taken from the whole law.
The bias current i0 is known, so the correction brings no parameter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SAMPLES = 16
"""Samples of one period: exact for products of up to 14 sinusoids."""

_ANGLE = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
_WAVE = np.exp(1j * _ANGLE)


def excess_of_many(
    ki: Real,
    ks: Real,
    bias_current_a: Real,
    current: Complex,
    displacement: Complex,
    group: NDArray[np.int64],
    kurtosis: Real,
) -> tuple[Complex, Complex, Complex]:
    """The same where all lines of a group are there at once, as in a multisine, and their phases are not known.

    To third order the excess of many lines with random phases is, on the average over phases, what the derivatives'
    means make of each line (Bussgang): (2 E[ab] + 3 E[b^2]) a + (E[a^2] + 6 E[ab] + 6 E[b^2]) b. Where the phases are
    known `many_lines` is exact.

    Parameters
    ----------
    ki, ks, bias_current_a, current, displacement
        As for `excess_force`.
    group
        (P,) lines of the same number are there together.
    kurtosis
        (n,) fourth moment of the displacement over a Gaussian's: phases chosen for small peaks make it less than 1.
    """
    a, b = current / bias_current_a, displacement / (bias_current_a * ki / ks)
    members = (group[:, None] == np.unique(group)).astype(float)
    shared = members @ members.T

    def moment(x: Complex, y: Complex) -> Real:
        return np.asarray(kurtosis * (shared @ (x * y.conj()).real) / 2)

    aa, ab, bb = moment(a, a), moment(a, b), moment(b, b)
    g = (2 * ab + 3 * bb) * a + (aa + 6 * ab + 6 * bb) * b
    along = (2 * ab + 6 * bb) * a + (aa + 12 * ab + 18 * bb) * b  # b dg/db
    return ki * bias_current_a * g, bias_current_a * (g - along), ki * bias_current_a / ks * along


def excess_force(
    ki: Real, ks: Real, bias_current_a: Real, current: Complex, displacement: Complex
) -> tuple[Complex, Complex, Complex]:
    """Fundamental of f - ki i - ks x for sinusoidal current and displacement.

    Parameters
    ----------
    ki, ks, bias_current_a
        (2,) N/A, N/m, A: factors of the small signal.
    current, displacement
        (P, 2) complex amplitudes at the bearings, A and m.

    Returns
    -------
    force, d_force_d_ki, d_force_d_ks
        (P, 2) each, N, N per (N/A), N per (N/m); the amplitudes are held fixed.
    """
    gap = bias_current_a * ki / ks
    a = (current[..., None] / bias_current_a[:, None] * _WAVE).real
    b = np.clip((displacement[..., None] / gap[:, None] * _WAVE).real, -0.9, 0.9)
    free = 1.0 / (1.0 - b**2)
    sum_, product = a + b, 1.0 + a * b
    excess = sum_ * product * free**2 - sum_
    slope = (product + a * sum_) * free**2 + 4.0 * b * sum_ * product * free**3 - 1.0
    back = np.conj(_WAVE) * (2.0 / SAMPLES)
    g = excess @ back
    along = (b * slope) @ back
    return ki * bias_current_a * g, bias_current_a * (g - along), ki * bias_current_a / ks * along
