"""Stages of a fit, from coarse to exact."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """How exact one Levenberg-Marquardt pass of a fit is.

    ``closed`` compares closed-loop responses, which are smooth where the plant has sharp peaks; ``relative_floor`` is
    an error that is allowed beside the noise, relative to the largest signal of a point; ``tolerance`` is the relative
    decrease of the cost from which the pass has converged. With a ``smallest_drop``, a chi-square, it is relative to
    what the cost is above noise, and no smaller than that: where most of the cost is noise, fits would else end along a
    flat direction, several units above the optimum. The derivatives with respect to the datasheet's values, and to
    inherited ones, are reused for ``chord`` steps: near the optimum they change little, far from it they soon mislead.
    A pass with a nonlinear effect begins with up to ``approach`` steps of the datasheet's values alone.
    """

    closed: bool
    relative_floor: float
    iterations: int
    tolerance: float
    smallest_drop: float | None = None
    chord: int = 4
    approach: int = 0

    def negligible(self, cost: float, noise: float) -> float:
        """Decrease of the cost up to which a pass has converged; ``noise`` is what noise alone is expected to cost."""
        if self.smallest_drop is None:
            return self.tolerance * max(1.0, cost)
        return max(self.tolerance * (cost - noise), self.smallest_drop)


COARSE = Stage(closed=True, relative_floor=0.03, iterations=10, tolerance=5e-3, chord=1, approach=6)
MIDDLE = Stage(closed=True, relative_floor=0.003, iterations=8, tolerance=5e-3, smallest_drop=0.5)
PROBE = Stage(closed=False, relative_floor=0.0, iterations=4, tolerance=5e-3)
WHOLE_PROBE = Stage(closed=False, relative_floor=0.0, iterations=8, tolerance=5e-3, smallest_drop=0.5)
EXACT = Stage(closed=False, relative_floor=0.0, iterations=15, tolerance=5e-4, smallest_drop=0.5)
