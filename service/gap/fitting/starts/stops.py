"""Starts of a stop that the rotor touches: the clearances, on a grid, whose force matches the residuals best.

For the measured motion the force of a stop is proportional to its stiffness, so the response of one soft stop gives the
best stiffness of a clearance by linear regression.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import scipy
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.predict import weight, whole_displacement
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from sim.effect import Effect

CLEARANCES = (0.3, 0.45, 0.6, 0.75, 0.9)
"""Clearances on the grid, as shares of each axis's largest displacement."""
SOFT = 0.02
"""Stiffness of the trial stop over the magnets': small enough for the response to be proportional to it."""
FAINT = 0.1
"""Share of the stiffest side's stiffness below which an axis has no stop on a side."""
OTHER_SIDE = 4.0
"""Clearance on the side on which an axis has no stop, over that on the other."""
WIDER = 1.2
"""Radius of a ring over the free way on the side on which it is touched, which is off centre towards there."""
REACHED = 0.5
"""Share of the largest clearance below which a fitted stop is one that is reached."""
ASIDE = 0.25
"""How far a ring is tried off the centre, over its clearance."""
RING = 0.95
"""Share of a ring from which a fit begins that may end at a whole one."""

Real = NDArray[np.float64]
Ways = Mapping[str, Sequence[float | None]]
"""By axis the free way above and below, m; None where nothing is touched."""


def starts(effect: Effect, base: dict[str, float], residuals: SweepResiduals, count: int = 2) -> list[dict[str, float]]:
    """The best clearances and sides, each with its best stiffness; first with a stop in one axis, if that is better."""
    rig = residuals.rig
    if rig.contact is not None:
        return [base]
    swing = np.abs(residuals.o.Y[:, residuals.o.fundamental]).max(axis=0)
    known = {p.name: p for p in effect.parameters}
    names = [f"clearance_{axis}_m" for axis in rig.axes]
    soft = _Soft(effect, base, residuals)

    def found(where: Sequence[str]) -> list[tuple[float, dict[str, float]]]:
        """(chi-square that it takes off, parameters) of stops in some axes, best first."""
        out = []
        for share, side in product(CLEARANCES, (0.0, 1.0, -1.0)):
            clearances = {
                name: float(np.clip(share * s, known[name].low, known[name].high))
                if name in where
                else known[name].high
                for name, s in zip(names, swing, strict=True)
            }
            if (one := soft.scaled({**base, **clearances, "side": 0.9 * side})) is not None:
                out.append(one)
        return sorted(out, key=lambda one: -one[0])

    everywhere = found(names)
    alone = max((best for name in names for best in found([name])[:1]), key=lambda one: one[0], default=None)
    chosen = everywhere[:count]
    if alone is not None and alone[0] > max((gain for gain, _ in chosen), default=0.0):
        chosen = [alone, *chosen]
    return [values for _, values in chosen] or [base]


def off_centre(
    effect: Effect, basic: Mapping[str, float], residuals: SweepResiduals, count: int = 3
) -> list[dict[str, float]]:
    """Stops that are not centred, as one ring at each bearing and as stops of each axis, each with its best stiffness.

    Soft stops of every axis, side and clearance on the grid are fitted at once, with stiffnesses that are not negative,
    which tells the free way to either side. Rings are also tried about the clearances of ``basic``, the fitted stop
    between like sides. Of all, and of their mirror images, the ``count`` best are taken.
    """
    rig = residuals.rig
    if rig.contact is not None:
        return []
    known = {p.name: p for p in effect.parameters}
    nowhere = {p.name: p.null for p in known.values()}
    nowhere |= {f"clearance_{axis}_m": known[f"clearance_{axis}_m"].high for axis in rig.axes}
    soft = _Soft(effect, nowhere, residuals)
    ways = soft.free_ways()
    planes = range(rig.n_planes)
    laws = [(_by_axis(ways), 0.0)]
    if len(planes) > 1:
        centred = {axis: basic[f"clearance_{axis}_m"] for axis in rig.axes}
        reached = {axis: c for axis, c in centred.items() if c < REACHED * known[f"clearance_{axis}_m"].high}
        aside = {axis: (ASIDE * c, c) for axis, c in reached.items()}
        laws += [(_by_ring(ways), RING), (aside, RING)]
    found = []
    # The fundamental is the same on either side, and outweighs the harmonics that tell one from the other.
    for (middles, ring), signs in product(laws, product((1.0, -1.0), repeat=len(planes))):
        sign = dict(zip("xy", signs, strict=False))
        stop = {**nowhere, "ring": ring}
        for axis, (middle, half) in middles.items():
            p = known[f"clearance_{axis}_m"]
            stop |= {p.name: float(np.clip(half, p.low, p.high)), f"centre_{axis}": sign[axis[0]] * middle / half}
        if (one := soft.scaled(stop)) is not None and middles:
            found.append(one)
    return [stop for _, stop in sorted(found, key=lambda one: -one[0])[:count]]


class _Soft:
    """Responses to soft stops, which are proportional to their stiffness, of the measured motion."""

    def __init__(self, effect: Effect, nowhere: Mapping[str, float], residuals: SweepResiduals) -> None:
        self._effect, self._nowhere = effect, dict(nowhere)
        self._rig, self._o = residuals.rig, residuals.o
        self._without, self._weight = whole_displacement(self._rig, self._o), weight(self._o, "y")
        self._wanted = stacked(residuals.z[..., None])[:, 0]
        self._known = {p.name: p for p in effect.parameters}
        self._stiffness_n_per_m = max(SOFT * float(np.max(self._rig.magnets.ks)), self._known["stiffness_n_per_m"].low)

    def response(self, stop: Mapping[str, float]) -> Real:
        """Weighted response to a stop per its stiffness, (2 P H n,)."""
        soft = {**self._nowhere, **stop, "stiffness_n_per_m": self._stiffness_n_per_m}
        change = whole_displacement(self._effect.on(self._rig, **soft), self._o) - self._without
        return stacked((change * self._weight / self._stiffness_n_per_m)[..., None])[:, 0]

    def scaled(self, stop: Mapping[str, float]) -> tuple[float, dict[str, float]] | None:
        """Chi-square that a stop of its best stiffness takes off, and its parameters; None if it takes off none."""
        change = self.response(stop)
        power, along = float(change @ change), float(change @ self._wanted)
        if power <= 0 or along <= 0:
            return None
        limits = self._known["stiffness_n_per_m"]
        return along**2 / power, {**stop, limits.name: float(np.clip(along / power, limits.low, limits.high))}

    def free_ways(self) -> Ways:
        """How far each axis is free, by the stiffnesses of soft stops on a grid that explain most together."""
        swing = np.abs(self._o.Y[:, self._o.fundamental]).max(axis=0)
        tried = []
        for (axis, s), side, share in product(zip(self._rig.axes, swing, strict=True), (1.0, -1.0), CLEARANCES):
            p = self._known[f"clearance_{axis}_m"]
            tried.append((axis, side, float(np.clip(share * s, p.low, p.high))))
        responses = [self.response({f"clearance_{axis}_m": c, "side": side}) for axis, side, c in tried]
        columns = np.stack(responses, axis=-1)
        size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
        found = scipy.optimize.nnls(columns / size, self._wanted)[0] / size
        of_side = {}
        for axis, side in product(self._rig.axes, (1.0, -1.0)):
            own = [(float(k), c) for (a, s, c), k in zip(tried, found, strict=True) if (a, s) == (axis, side)]
            whole = sum(k for k, _ in own)
            of_side[axis, side] = whole, sum(k * c for k, c in own) / whole if whole else 0.0
        least = FAINT * max(k for k, _ in of_side.values())
        return {
            axis: [c if k > least else None for k, c in (of_side[axis, 1.0], of_side[axis, -1.0])]
            for axis in self._rig.axes
        }


def _by_axis(ways: Ways) -> dict[str, tuple[float, float]]:
    """Middle and half of the free way of the axes that touch something, m."""
    out = {}
    for axis, both in ways.items():
        touched = [c for c in both if c is not None]
        if touched:
            above, below = (OTHER_SIDE * touched[0] if c is None else c for c in both)
            out[axis] = (above - below) / 2, (above + below) / 2
    return out


def _by_ring(ways: Ways) -> dict[str, tuple[float, float]]:
    """The same where the free way of both planes at a bearing is round."""
    out = {}
    for end in "AB":
        at_end = {axis: both for axis, both in ways.items() if axis[1] == end}
        touched = [[c for c in both if c is not None] for both in at_end.values()]
        if not any(touched):
            continue
        radius = WIDER * max(sum(own) / len(own) for own in touched if own)
        for axis, (above, below) in at_end.items():
            # where only one side is touched, that tells the middle
            upper = 2 * radius - (below or radius) if above is None else above
            lower = 2 * radius - upper if below is None else below
            out[axis] = (upper - lower) / 2, radius
    return out
