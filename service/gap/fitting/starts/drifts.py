"""Where a drift of the magnets starts: at the one that explains most."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.predict import weight, whole_displacement
from service.gap.fitting.starts.left import Left
from sim import imbalance
from sim.effect import Effect

Real = NDArray[np.float64]

SLIGHT = 1e-3
"""Drift that is tried: small enough for its answer to be proportional."""


def starts(effect: Effect, base: dict[str, float], left: Left) -> list[dict[str, float]]:
    """The drift of magnets, and which of them drift most, that explains most that the datasheet's values cannot.

    Of a small drift the answer is proportional to each axis's, so eight answers tell those of all.
    """
    rig, o, basis = left.rig, left.o, left.datasheet_basis()
    f, w = o.fundamental, weight(o, "y")[:, o.fundamental]
    known_by = {p.name: p for p in effect.parameters}
    if rig.drift is not None:  # stated over the same time
        duration = known_by["duration_s"]
        base = {**base, "duration_s": float(np.clip(rig.drift.duration_s, duration.low, duration.high))}
    without, corners = whole_displacement(rig, o)[:, f], list(product((1.0, -1.0), repeat=rig.n_planes))

    def answer(factor: str, corner: tuple[float, ...]) -> Real:
        of = dict(zip(imbalance.NAMES, corner, strict=False))
        small = {**base, "ki_change": 0.0, "ks_change": 0.0, **of, factor: SLIGHT}
        change = (whole_displacement(effect.on(rig, **small), o)[:, f] - without) * w / SLIGHT
        return stacked(change[..., None])[:, 0]

    columns = np.stack([answer(factor, c) for factor in ("ki_change", "ks_change") for c in corners], axis=-1)
    wanted = stacked(left.z[:, f, :, None])[:, 0]
    known = basis.T @ columns
    power = columns.T @ columns - known.T @ known
    along = columns.T @ wanted - known.T @ (basis.T @ wanted)

    def strengths(imbalances: Sequence[float]) -> tuple[float, dict[str, float]]:
        """Chi-square that the best ki and ks with such imbalances take off, and these."""
        share = np.array([np.prod([(1 + s * i) / 2 for s, i in zip(c, imbalances, strict=True)]) for c in corners])
        split = np.kron(np.eye(2), share[:, None])
        found = np.linalg.lstsq(split.T @ power @ split, split.T @ along)[0]
        names = (*imbalance.NAMES[: len(corners[0])], "ki_change", "ks_change")
        return float(found @ split.T @ along), dict(zip(names, (*imbalances, *found), strict=True))

    grid = product(np.linspace(-1.0, 1.0, 9), repeat=rig.n_planes)
    best = max((strengths(imbalances) for imbalances in grid), key=lambda one: one[0])[1]
    return [{**base, **{name: float(np.clip(v, known_by[name].low, known_by[name].high)) for name, v in best.items()}}]
