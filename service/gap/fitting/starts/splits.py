"""Starts of gyroscopic moments that split the modes' peaks: no fit from an unsplit peak gets across.

A narrow peak that is split by many of its widths is a minimum of its own. So closed-loop responses, which are smooth,
are compared on a grid of splits, mode by mode.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fit import Problem
from service.gap.fitting.objective import Objective
from service.gap.fitting.stage import COARSE
from sim.errors import AmbError

Real = NDArray[np.float64]
Values = dict[str, float]

SLOPES = ("mode1_slope_per_m_sqrt_kg", "mode2_slope_per_m_sqrt_kg")
"""Tilt of a disc by the modes."""
SMALLEST, SIZES = 1 / 40, 20
"""Smallest value on the grid over the largest one that is possible, and values of each sign: a split is found to a
fifth where it goes with the value's square, to a tenth where it goes with the value."""
SLIGHT = 0.05
"""Imbalance of couplings that are the same on the grid."""
AGAIN = 1
"""Modes that are looked for once more, as the first round knew nothing of the others."""


def by_slopes(problem: Problem, theta: Real, values: Values) -> Values:
    """``values`` with the slopes, at which a disc is tilted by each mode, that fit best; empty where none helps.

    ``theta`` must have modes near where the datasheet has them: values that were fitted without the split have moved a
    mode to one of its peaks.
    """
    largest = {p.name: p.high for p in problem.unknowns.effects[0].parameters if p.name in SLOPES}
    grids = [np.geomspace(SMALLEST * high, high, SIZES) for high in largest.values()]
    return _scanned(problem, theta, grids, lambda at: {**values, **dict(zip(largest, at, strict=True))})


def by_couplings(problem: Problem, theta: Real, values: Values) -> Values:
    """``values`` with a coupling of each mode's copies in the two planes by itself; empty where none helps."""
    known = {p.name: p for p in problem.unknowns.effects[0].parameters}
    modes = min(2, *map(len, problem.ground.nuisance.rig.rotor.modes))
    grid = np.geomspace(SMALLEST, 1.0, SIZES) * known["mode_coupling"].high

    def of_each(at: Sequence[float]) -> Values:
        mean = float(np.mean(at))
        uneven = (at[0] - at[1]) / (2 * mean) if modes > 1 and mean else 0.0
        # at exactly zero it would be held there
        return {**values, "mode_coupling": mean, "coupling_imbalance": float(np.clip(uneven or SLIGHT, -1.0, 1.0))}

    return _scanned(problem, theta, [grid] * modes, of_each) if modes else {}


def _scanned(
    problem: Problem, theta: Real, grids: Sequence[Real], values: Callable[[Sequence[float]], Values]
) -> Values:
    """Values at the best point of a search along one grid, of either sign and with 0, after the other."""
    objective, nuisance = Objective(problem.model, COARSE), theta[problem.unknowns.active]

    def cost(at: Sequence[float]) -> float:
        with suppress(AmbError, np.linalg.LinAlgError):
            return objective.fresh_state(np.concatenate([nuisance, problem.unknowns.scaled((values(at),))])).cost
        return np.inf

    best = [0.0] * len(grids)
    for k in (*range(len(grids)), *range(min(AGAIN, len(grids) - 1))):
        best = min(([*best[:k], float(v), *best[k + 1 :]] for v in (0.0, *grids[k], *-grids[k])), key=cost)
    return values(best) if any(best) else {}
