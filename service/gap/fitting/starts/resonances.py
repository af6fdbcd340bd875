"""Starts of one more resonance, a mode of the rotor or a housing, by a score test over a grid of frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import residue_columns, stacked
from service.gap.fitting.predict import weight
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from sim.effect import Effect

Real = NDArray[np.float64]

GRID_DAMPING = 0.02
"""Damping ratio on the grid: wide enough for a resonance not to fall between two lines."""
ABOVE = np.geomspace(1.04, 2.5, 12)
"""Further frequencies on the grid, over the highest line's: the flank of a mode up there is in the band."""
FINE_DAMPINGS = (0.001, 0.003, 0.006, 0.06)
"""Further damping ratios that are tried near the best frequencies, as a resonance between two lines may show at
one..."""
FINE_FREQUENCIES = 17
"""... at so many frequencies between the neighbours on the grid."""
GRID_APART = 8
"""Least distance of a second resonance from the first, in steps of the grid (lines, and one frequency between each)."""

SAME_FREQUENCY = 0.02
"""Logarithm of the ratio of two frequencies below which they are taken for the same."""
OFF_BETWEEN_LINES = 0.05
"""Logarithm of the ratio by which a resonance may be found off: half the distance of 45 lines over two decades."""


def starts(effect: Effect, base: dict[str, float], residuals: SweepResiduals) -> list[dict[str, float]]:
    """The best resonances, then one at the largest residuals, then the typical one."""
    others = (residuals.peaks_hz(1)[0], base["frequency_hz"])
    found = (*resonances(effect, residuals), *({"frequency_hz": f} for f in dict.fromkeys(others)))
    return [{**base, **f} for f in found]


def unlike_planes(effect: Effect, residuals: SweepResiduals) -> list[dict[str, float]]:
    """Support or mode of another frequency in y: the best resonance of each plane; empty where both are the same."""
    in_x, in_y = (resonances(effect, residuals, 1, plane) for plane in (0, 1))
    if not in_x or not in_y:
        return []
    ratio = in_y[0]["frequency_hz"] / in_x[0]["frequency_hz"]
    known = next(p for p in effect.parameters if p.name == "plane_frequency_ratio")
    # a resonance between two lines is found some per cent off, which may be beyond the end of the range
    within = float(np.clip(ratio, known.low, known.high))
    if abs(np.log(ratio)) < SAME_FREQUENCY or abs(np.log(ratio / within)) > OFF_BETWEEN_LINES:
        return []
    return [{**in_x[0], "frequency_hz": in_y[0]["frequency_hz"] / within, known.name: within}]


def resonances(
    effect: Effect, residuals: SweepResiduals, count: int = 2, plane: int | None = None
) -> list[dict[str, float]]:
    """Resonances that explain most beyond what the nuisance values can, best first: frequency, damping and shape.

    Of all points, or of those in which an axis of one ``plane`` is excited: none where there are no such points.

    A score test: a resonance of small modal participation has a response that is linear in its residues, so these
    follow from a regression of the residuals, with what the nuisance values can explain projected out. A housing moves
    both ends alike and has one residue. A flexible mode has four; it gets the shapes of the nearest residue of rank
    one.
    """
    shaped = effect.id == "extra_flexible_mode"
    if residuals.rig.support is not None and not shaped:
        return []
    o, basis = residuals.o, residuals.datasheet_basis()
    f, w = o.fundamental, weight(o, "y")[:, o.fundamental]
    columns = residue_columns(residuals.rig, o) * w[..., None, None]
    columns = columns.reshape(*w.shape, 4) if shaped else columns.sum(axis=(2, 3))[..., None]
    if plane is not None:
        if not (o.axis // 2 == plane).any():
            return []
        columns = columns * (o.axis // 2 == plane)[:, None, None]
    wanted, s = stacked(residuals.z[:, f, :, None]), 2j * np.pi * o.points_hz
    wanted -= basis @ (basis.T @ wanted)

    def score(own_hz: float, damping_ratio: float) -> tuple[float, Real]:
        """Chi-square that such a resonance takes off, and its residues."""
        own = 2 * np.pi * own_hz
        responses = stacked(columns / (s**2 + 2 * damping_ratio * own * s + own**2)[:, None, None])
        along, known = (responses.T @ wanted)[:, 0], basis.T @ responses
        power = responses.T @ responses - known.T @ known
        residue = np.linalg.solve(power + 1e-9 * np.trace(power) * np.eye(len(power)), along)
        return float(along @ residue) if shaped or residue[0] > 0 else 0.0, residue

    between = np.sqrt(o.frequency_hz[:-1] * o.frequency_hz[1:])
    grid = np.sort(np.concatenate([o.frequency_hz, between]))
    in_band, above = len(grid), o.frequency_hz[-1] * ABOVE
    grid = np.concatenate([grid, above])
    scores = np.array([score(own, GRID_DAMPING)[0] for own in grid])
    order = np.argsort(-scores[:in_band])
    best = [int(order[0])]
    best += [int(k) for k in order if abs(int(k) - best[0]) > GRID_APART][: count - 1]
    flank = in_band + int(np.argmax(scores[in_band:]))
    best = [flank, *best] if scores[flank] > scores[best[0]] else best
    found = []
    for k in best:
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        fine = np.geomspace(low, high, FINE_FREQUENCIES)
        tried = [(own, damping) for damping in (GRID_DAMPING, *FINE_DAMPINGS) for own in fine]
        own, damping = max(tried, key=lambda at: score(*at)[0])
        shape = _shape(effect, score(own, damping)[1]) if shaped else {}
        found.append({"frequency_hz": float(own), "damping_ratio": float(damping), **shape})
    return found


def _shape(effect: Effect, residue: Real) -> dict[str, float]:
    """Mode shapes of the nearest residue of rank one.

    ``residue``, (4,), is displacement at A per force at A and at B, then displacement at B.
    """
    u, size, v = np.linalg.svd(residue.reshape(2, 2))
    at_sensors, at_bearings = np.sqrt(size[0]) * u[:, 0], np.sqrt(size[0]) * v[0]
    known = {p.name: p for p in effect.parameters}
    shapes = {
        f"{place}_{end}_per_sqrt_kg": float(shape[k])
        for place, shape in (("sensor", at_sensors), ("bearing", at_bearings))
        for k, end in enumerate("AB")
    }
    return {name: float(np.clip(v, known[name].low, known[name].high)) for name, v in shapes.items()}
