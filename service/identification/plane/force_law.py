"""The magnet's force law at a finite amplitude: the fundamental of the force beyond ki i + ks x.

Differential drive (notes of `sim.rig.Magnets`): f = ki i0 (a + b)(1 + a b)/(1 - b^2)^2 with a = i/i0, b = x/s0 and
s0 = i0 ki/ks. To third order a + b + a^2 b + 3 a b^2 + 2 b^3; here the fundamental is taken from the whole law.
The bias current i0 is known, so the correction brings no parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SAMPLES = 16
"""Samples of one period: exact for products of up to 14 sinusoids. The law is odd, so half of them tell all."""

_ANGLE = 2 * np.pi * np.arange(SAMPLES // 2) / SAMPLES
_FORTH = np.stack([np.cos(_ANGLE), -np.sin(_ANGLE)], axis=1)
"""(samples, 2) of the real and the imaginary part of an amplitude."""
_BACK = np.stack([np.cos(_ANGLE), -np.sin(_ANGLE)]) * (4.0 / SAMPLES)
"""(2, samples) real and imaginary part of the fundamental."""
NEAREST = 0.9
"""Displacement in units of the gap beyond which the law is not followed."""


@dataclass(frozen=True)
class Waves:
    """Half a period of the currents and displacements at the bearings."""

    current: Real
    """(n, samples, P) A."""
    displacement: Real
    """(n, samples, P) m."""

    @staticmethod
    def of(current: Complex, displacement: Complex) -> Waves:
        """Of complex amplitudes, (P, n) each."""
        return Waves(_wave(current), _wave(displacement))


def _wave(phasor: Complex) -> Real:
    return np.asarray(_FORTH @ np.stack([phasor.real, phasor.imag]).transpose(2, 0, 1))


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
    force, d_ki, d_ks = excess_of_waves(ki, ks, bias_current_a, Waves.of(current, displacement))
    return force.T, d_ki.T, d_ks.T


def excess_of_waves(ki: Real, ks: Real, bias_current_a: Real, waves: Waves) -> tuple[Complex, Complex, Complex]:
    """As `excess_force`, from the waves and with the points last, (n, P) each."""
    scale = ki * bias_current_a
    a, b = _in_gaps(ki, ks, bias_current_a, waves)
    free, total, product = 1.0 / (1.0 - b * b), a + b, 1.0 + a * b
    free2, both = free * free, total * product
    slope = (product + a * total) * free2 + 4.0 * b * both * free2 * free - 1.0
    g, along = _fundamental(both * free2 - total), _fundamental(b * slope)
    return (
        scale[:, None] * g,
        bias_current_a[:, None] * (g - along),
        (scale / ks)[:, None] * along,
    )


def force_beyond_linear(ki: Real, ks: Real, bias_current_a: Real, waves: Waves) -> Complex:
    """The force of `excess_of_waves` alone, (n, P)."""
    a, b = _in_gaps(ki, ks, bias_current_a, waves)
    free, total = 1.0 / (1.0 - b * b), a + b
    return np.asarray((ki * bias_current_a)[:, None] * _fundamental(total * (1.0 + a * b) * free * free - total))


def _in_gaps(ki: Real, ks: Real, bias_current_a: Real, waves: Waves) -> tuple[Real, Real]:
    """Currents in bias currents and displacements in gaps."""
    b = waves.displacement * (ks / (bias_current_a * ki))[:, None, None]
    np.minimum(b, NEAREST, out=b)
    np.maximum(b, -NEAREST, out=b)
    return waves.current / bias_current_a[:, None, None], b


def _fundamental(wave: Real) -> Complex:
    """Complex amplitudes (n, P) of (n, samples, P)."""
    parts = _BACK @ wave
    out = np.empty(wave.shape[::2], dtype=np.complex128)
    out.real, out.imag = parts[:, 0], parts[:, 1]
    return out
