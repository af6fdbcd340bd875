"""Where one more resonance starts: of a rotor's mode or of a housing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import residue_columns, stacked
from service.gap.fitting.predict import weight
from service.gap.fitting.starts.left import Left
from sim.effect import Effect

Real = NDArray[np.float64]

DAMPED = 0.02
"""Damping ratio of a resonance that is looked for: wide enough not to fall between two lines."""
DAMPINGS = (0.001, 0.003, 0.006, 0.06)
"""Those at which the best is looked at more closely: it may stand between two lines and show at one of them alone..."""
GRID_BETWEEN = 17
"""... at so many frequencies from the one beside it to the other."""
LINES_APART = 8
"""Frequencies looked at, lines and what lies between two, between which a second resonance is not looked for."""


def starts(effect: Effect, base: dict[str, float], left: Left) -> list[dict[str, float]]:
    """The best resonances, then one where most is left, then the typical one."""
    others = (left.peaks_hz(1)[0], base["frequency_hz"])
    found = (*resonances(effect, left), *({"frequency_hz": f} for f in dict.fromkeys(others)))
    return [{**base, **f} for f in found]


def resonances(effect: Effect, left: Left, count: int = 2) -> list[dict[str, float]]:
    """Where one more resonance would explain most that the datasheet's values cannot, best first.

    A score test: the resonance is so light that its answer is proportional to its residues, and what the values of the
    datasheet could do as well is projected out. A housing moves both ends alike; what is ``shaped`` moves them by the
    residue of rank one that is nearest, and gets that shape.
    """
    shaped = effect.id == "extra_flexible_mode"
    if left.rig.support is not None and not shaped:
        return []
    o, basis = left.o, left.datasheet_basis()
    f, w = o.fundamental, weight(o, "y")[:, o.fundamental]
    columns = residue_columns(left.rig, o) * w[..., None, None]
    columns = columns.reshape(*w.shape, 4) if shaped else columns.sum(axis=(2, 3))[..., None]
    wanted, s = stacked(left.z[:, f, :, None]), 2j * np.pi * o.points_hz
    wanted -= basis @ (basis.T @ wanted)

    def score(own_hz: float, damping_ratio: float) -> tuple[float, Real]:
        own = 2 * np.pi * own_hz
        light = stacked(columns / (s**2 + 2 * damping_ratio * own * s + own**2)[:, None, None])
        along, known = (light.T @ wanted)[:, 0], basis.T @ light
        power = light.T @ light - known.T @ known
        residue = np.linalg.solve(power + 1e-9 * np.trace(power) * np.eye(len(power)), along)
        return float(along @ residue) if shaped or residue[0] > 0 else 0.0, residue

    between = np.sqrt(o.frequency_hz[:-1] * o.frequency_hz[1:])
    grid = np.sort(np.concatenate([o.frequency_hz, between]))
    order = np.argsort([-score(own, DAMPED)[0] for own in grid])
    best = [int(order[0])]
    best += [int(k) for k in order if abs(int(k) - best[0]) > LINES_APART][: count - 1]
    found = []
    for k in best:
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        tried = [(own, damping) for damping in (DAMPED, *DAMPINGS) for own in np.geomspace(low, high, GRID_BETWEEN)]
        own, damping = max(tried, key=lambda at: score(*at)[0])
        shape = _shape(effect, score(own, damping)[1]) if shaped else {}
        found.append({"frequency_hz": float(own), "damping_ratio": float(damping), **shape})
    return found


def _shape(effect: Effect, residue: Real) -> dict[str, float]:
    """The mode shape whose residue, (4,), is nearest: displacement at A and B for forces at A, then at B."""
    u, size, v = np.linalg.svd(residue.reshape(2, 2))
    at_sensors, at_bearings = np.sqrt(size[0]) * u[:, 0], np.sqrt(size[0]) * v[0]
    known = {p.name: p for p in effect.parameters}
    shapes = {
        f"{place}_{end}_per_sqrt_kg": float(shape[k])
        for place, shape in (("sensor", at_sensors), ("bearing", at_bearings))
        for k, end in enumerate("AB")
    }
    return {name: float(np.clip(v, known[name].low, known[name].high)) for name, v in shapes.items()}
