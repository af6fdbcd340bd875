"""Cubic terms of the force law where many lines excite the rotor at once, as a multisine does on all axes. Pure.

The excess a^2 b + 3 a b^2 + 2 b^3 (`force_law`) of one line then depends on all the others. An experiment file keeps
the columns that the separation of orthogonal experiments gave, and the phases that the excitation had: with both the
time functions of every experiment are known again, and so are the products and what they put at each line, the
same separation done to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from service.experiment.data import Sweep
from service.experiment.multisine import orthogonal
from service.identification.arrays import Complex, Real


@dataclass(frozen=True)
class ManyLines:
    """Points of one plane that excite the rotor together."""

    phasor: Complex
    """(P, B) of r in each realisation."""
    axis: NDArray[np.int64]
    """(P,) excited axis of the column, among all axes."""
    line: NDArray[np.int64]
    """(P,) multiple of the lowest common frequency."""
    n_axes: int

    @staticmethod
    def of(sweep: Sweep, keep: NDArray[np.int64]) -> ManyLines | None:
        """Those of a sweep's points; None for tones, and where the file does not tell the phases."""
        if sweep.kind != "multisine" or sweep.phase_rad is None or sweep.block_samples is None or not len(keep):
            return None
        multiple = np.round(sweep.frequency_hz * sweep.block_samples / sweep.sample_rate_hz).astype(np.int64)
        line = multiple // np.gcd.reduce(multiple)
        return ManyLines(np.exp(1j * sweep.phase_rad[keep]), sweep.axis[keep], line[keep], sweep.Y.shape[3])

    def select(self, keep: NDArray[np.bool_]) -> ManyLines:
        """Some of the points; the others' share in the products is lost."""
        return ManyLines(self.phasor[keep], self.axis[keep], self.line[keep], self.n_axes)

    def products(self, current: Complex, displacement: Complex) -> Complex:
        """What i^2 x, i x^2 and x^3 put at each point's line, after the separation, (B, 3, P, 2).

        Parameters
        ----------
        current, displacement
            (P, 2) columns at the bearings, A and m.
        """
        i, x = (self.in_time(v) for v in (current, displacement))
        return np.stack([self.at_lines(product) for product in (i * i * x, i * x * x, x * x * x)], axis=1)

    @cached_property
    def samples(self) -> int:
        """Of a period: third harmonics fold back on no line."""
        return next_fast_len(4 * int(self.line.max()) + 1, real=True)

    def in_time(self, columns: Complex) -> Real:
        """(B, experiments, n, samples) time functions of columns (P, n)."""
        mixing = orthogonal(self.n_axes)
        blocks, experiments = self.phasor.shape[1], len(mixing)
        half = np.zeros((blocks, experiments, columns.shape[1], self.samples // 2 + 1), dtype=np.complex128)
        for axis in np.unique(self.axis):  # each of its lines once
            own = self.axis == axis
            weight = self.phasor[own].T[:, None] * mixing[:, axis][:, None]  # (B, E, own)
            half[..., self.line[own]] += weight[:, :, None] * columns[own].T
        return np.asarray(irfft(half * (self.samples / 2), self.samples))

    def at_lines(self, x: Real) -> Complex:
        """What time functions, as `in_time` gives them, put at each point's line, after the separation, (B, P, n)."""
        mixing = orthogonal(self.n_axes)
        back = (mixing[:, self.axis].conj() / len(mixing))[None] * self.phasor.T.conj()[:, None]  # (B, E, P)
        spectrum = rfft(x)[..., self.line] * (2 / self.samples)
        return np.asarray(np.einsum("bep,bejp->bpj", back, spectrum))


def excess_of_products(ki: Real, ks: Real, bias_current_a: Real, products: Complex) -> tuple[Complex, Complex, Complex]:
    """As `force_law.excess_force`, to third order, from products (3, P, 2) in A^2 m, A m^2 and m^3."""
    gap = bias_current_a * ki / ks
    one = products[0] / (bias_current_a**2 * gap)
    two = 3 * products[1] / (bias_current_a * gap**2)
    three = 2 * products[2] / gap**3
    g, along = one + two + three, one + 2 * two + 3 * three
    return ki * bias_current_a * g, bias_current_a * (g - along), ki * bias_current_a / ks * along
