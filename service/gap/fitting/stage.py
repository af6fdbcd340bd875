"""Stages of a fit, from coarse to exact."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """How exact one Levenberg-Marquardt pass of a fit is.

    ``closed`` compares closed-loop responses, which are smooth where the plant has sharp peaks; ``relative_floor`` is
    an error that is allowed beside the noise, relative to the largest signal of a point; ``tolerance`` is the relative
    decrease of the cost from which the pass has converged.
    """

    closed: bool
    relative_floor: float
    iterations: int
    tolerance: float


COARSE = Stage(closed=True, relative_floor=0.03, iterations=10, tolerance=5e-3)
MIDDLE = Stage(closed=True, relative_floor=0.003, iterations=8, tolerance=5e-3)
PROBE = Stage(closed=False, relative_floor=0.0, iterations=4, tolerance=5e-3)
EXACT = Stage(closed=False, relative_floor=0.0, iterations=15, tolerance=5e-4)
