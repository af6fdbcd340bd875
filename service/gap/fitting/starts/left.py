"""What a rig leaves unexplained of a sweep, for an effect to start from."""

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
class Left:
    """A sweep, and what a fitted rig leaves of a part's signal in it."""

    rig: Rig
    z: Complex
    """(P, H, n) weighted residuals"""
    o: Observation
    ground: Ground

    def datasheet_basis(self) -> Real:
        """What the datasheet's values can do within their tolerances to the weighted fundamentals, (2 P n, a).

        Columns are orthonormal together with the tolerances as data, so that what is projected on them is what is left
        of it once the values have followed.
        """
        o, part = self.o, self.ground.part
        w = weight(o, "y")[:, o.fundamental]
        J = displacement_jacobian(self.ground.nuisance, self.rig, o, part.from_control)[:, :, part.active]
        rows = stacked(J * w[..., None])
        return np.linalg.qr(np.concatenate([rows, np.eye(rows.shape[1])]))[0][: len(rows)]

    def peaks_hz(self, count: int = 2) -> list[float]:
        """Frequencies where most is left, Hz, largest first."""
        o = self.o
        total = np.bincount(
            o.line, weights=np.log1p(np.abs(self.z[:, o.fundamental]) ** 2).sum(axis=1), minlength=len(o.frequency_hz)
        )
        per_line = total / np.maximum(np.bincount(o.line, minlength=len(o.frequency_hz)), 1)
        padded = np.pad(per_line, 1, constant_values=-np.inf)  # a line at the end has one neighbour, one alone none
        inner = (per_line >= padded[:-2]) & (per_line >= padded[2:])
        order = np.argsort(np.where(inner, -per_line, 0.0))
        return [float(o.frequency_hz[k]) for k in order[:count]]
