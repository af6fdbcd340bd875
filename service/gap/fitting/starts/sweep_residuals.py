"""Residuals of a sweep, from which the starts of effects are estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import displacement_jacobian, stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import weight
from service.gap.measured.observation import Observation
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class SweepResiduals:
    """A sweep with the residuals of a fitted rig in one part's signal."""

    rig: Rig
    z: Complex
    """(P, H, n) weighted residuals"""
    o: Observation
    ground: Ground

    def datasheet_basis(self) -> Real:
        """Basis Q, (2 P n, a), of what the nuisance values can explain of the weighted fundamentals.

        By QR of the Jacobian with the priors as further rows: v - Q Q^T v is what remains of residuals v once the
        nuisance values have been refitted under their priors.
        """
        o, part = self.o, self.ground.part
        w = weight(o, "y")[:, o.fundamental]
        J = displacement_jacobian(self.ground.nuisance, self.rig, o, part.from_control)[:, :, part.active]
        rows = stacked(J * w[..., None])
        return np.linalg.qr(np.concatenate([rows, np.eye(rows.shape[1])]))[0][: len(rows)]

    def peaks_hz(self, count: int = 2) -> list[float]:
        """Frequencies of the largest local maxima of the residuals, Hz, largest first."""
        o = self.o
        total = np.bincount(
            o.line, weights=np.log1p(np.abs(self.z[:, o.fundamental]) ** 2).sum(axis=1), minlength=len(o.frequency_hz)
        )
        per_line = total / np.maximum(np.bincount(o.line, minlength=len(o.frequency_hz)), 1)
        padded = np.pad(per_line, 1, constant_values=-np.inf)  # the first and the last line may be maxima, too
        maximum = (per_line >= padded[:-2]) & (per_line >= padded[2:])
        order = np.argsort(np.where(maximum, -per_line, 0.0))
        return [float(o.frequency_hz[k]) for k in order[:count]]
