"""Noise of the rig's sensors by frequency, from the scatter of an experiment's blocks, and its spectra in a loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.campaign.noise import NoiseSpectra
from service.experiment.data import Sweep
from service.gap.measured.scatter import mean_scatter
from sim.rig import Rig
from sim.twin import LinearModel, linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

BLOCK_S = 0.1
"""Assumed length of a block, s, or one period where that is longer, where the file has none."""
SMALLEST = 1e-60
"""Substitute for a variance of zero, A^2 s or m^2 s, as its logarithm is taken."""
LOWEST_HZ, RESOLUTION_HZ = 0.5, 4.0
"""Grid of a loop's spectra, as in a campaign: narrow peaks of the noise determine the amplitude there."""


@dataclass(frozen=True)
class SensorNoise:
    """Variance E|e|^2 of a complex amplitude measured for one second; it is inversely proportional to that time.

    It has no part in proportion to a signal, such as a twin's own error.
    """

    frequency_hz: Real
    """(F,) rising"""
    of_i: Real
    """(F, n) A^2 s"""
    of_y: Real
    """(F, n) m^2 s"""

    @staticmethod
    def of(sweep: Sweep, rig: Rig) -> SensorNoise:
        """The noise of a sweep; ``rig`` is any reasonable twin, to take the feedback out of the scatter."""
        f, blocks = sweep.harmonics.index(1), sweep.Y.shape[1]
        block_s = np.maximum(BLOCK_S, 1 / sweep.frequency_hz)
        if sweep.block_samples is not None:
            block_s = sweep.block_samples / sweep.sample_rate_hz
        _, of_i, of_y = (v[:, f] * (blocks * block_s)[:, None] for v in mean_scatter(sweep, rig))
        frequency, line = np.unique(sweep.frequency_hz, return_inverse=True)

        def by_line(v: Real) -> Real:
            return np.maximum([np.median(v[line == k], axis=0) for k in range(len(frequency))], SMALLEST)

        return SensorNoise(frequency, by_line(of_i), by_line(of_y))

    def at(self, frequency_hz: Real) -> tuple[Real, Real]:
        """Variances of i and y at frequencies (F',), (F', n) each: interpolated log-log, constant beyond the ends."""
        x, at = np.log(self.frequency_hz), np.log(frequency_hz)
        i, y = (
            np.exp(np.stack([np.interp(at, x, np.log(column)) for column in v.T], axis=-1))
            for v in (self.of_i, self.of_y)
        )
        return i, y

    def spectra(self, rig: Rig, highest_hz: float) -> NoiseSpectra:
        """Densities of u, i and y in a rig's loop, as a record without excitation would show them."""
        fine = np.arange(RESOLUTION_HZ, highest_hz, RESOLUTION_HZ)
        grid = np.concatenate([np.geomspace(LOWEST_HZ, RESOLUTION_HZ, 4)[:-1], fine])
        model, (of_i, of_y) = linear_model(rig, grid), self.at(grid)
        u, i, y = (np.abs(x) ** 2 for x in fed_back(model))
        own = {"u": of_y, "i": of_y, "y": of_y}
        density = {s: 0.5 * np.einsum("fij,fj->fi", p, own[s]) for s, p in (("u", u), ("i", i), ("y", y))}
        density["i"] = density["i"] + 0.5 * of_i
        return NoiseSpectra(grid, density)


def fed_back(model: LinearModel) -> tuple[Complex, Complex, Complex]:
    """u, i and y per noise of the displacement sensors in closed loop, (F, n, n) each."""
    n, C = model.y_per_u.shape[-1], model.controllers / model.log_phase[:, None]  # from y to the logged u
    y = np.linalg.inv(np.eye(n) + model.y_per_u * C[:, None, :]).astype(np.complex128)
    u: Complex = -C[:, :, None] * y
    return u, np.asarray(model.i_per_u @ u), y
