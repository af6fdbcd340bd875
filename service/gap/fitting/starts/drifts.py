"""Start of a drift of the magnets: by linear regression."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.predict import weight, whole_displacement
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from sim import imbalance
from sim.effect import Effect

Real = NDArray[np.float64]

SLIGHT = 1e-3
"""Relative drift of the trial responses: small enough for them to be proportional to it."""


def starts(effect: Effect, base: dict[str, float], residuals: SweepResiduals) -> list[dict[str, float]]:
    """The drifts of ki and ks, and their imbalances, that explain most beyond what the nuisance values can.

    The response to a small drift is linear in the drift of each axis. An imbalance is a mixture of its corner cases, in
    which only one bearing of one plane drifts, so the responses to these, of ki and ks each, give all others.
    """
    rig, o, basis = residuals.rig, residuals.o, residuals.datasheet_basis()
    f, w = o.fundamental, weight(o, "y")[:, o.fundamental]
    known_by = {p.name: p for p in effect.parameters}
    if rig.drift is not None:  # a further drift is stated over the time of the one that is there
        duration = known_by["duration_s"]
        base = {**base, "duration_s": float(np.clip(rig.drift.duration_s, duration.low, duration.high))}
    without, corners = whole_displacement(rig, o)[:, f], list(product((1.0, -1.0), repeat=rig.n_planes))

    def response(factor: str, corner: tuple[float, ...]) -> Real:
        """Weighted response, (2 P n,), per unit drift of ki or ks of one corner case."""
        of = dict(zip(imbalance.NAMES, corner, strict=False))
        small = {**base, "ki_change": 0.0, "ks_change": 0.0, **of, factor: SLIGHT}
        change = (whole_displacement(effect.on(rig, **small), o)[:, f] - without) * w / SLIGHT
        return stacked(change[..., None])[:, 0]

    columns = np.stack([response(factor, c) for factor in ("ki_change", "ks_change") for c in corners], axis=-1)
    wanted = stacked(residuals.z[:, f, :, None])[:, 0]
    known = basis.T @ columns
    power = columns.T @ columns - known.T @ known
    along = columns.T @ wanted - known.T @ (basis.T @ wanted)

    def strengths(imbalances: Sequence[float]) -> tuple[float, dict[str, float]]:
        """Chi-square that the best drifts of ki and ks with such imbalances take off, and their parameters."""
        share = np.array([np.prod([(1 + s * i) / 2 for s, i in zip(c, imbalances, strict=True)]) for c in corners])
        split = np.kron(np.eye(2), share[:, None])
        found = np.linalg.lstsq(split.T @ power @ split, split.T @ along)[0]
        names = (*imbalance.NAMES[: len(corners[0])], "ki_change", "ks_change")
        return float(found @ split.T @ along), dict(zip(names, (*imbalances, *found), strict=True))

    grid = product(np.linspace(-1.0, 1.0, 9), repeat=rig.n_planes)
    best = max((strengths(imbalances) for imbalances in grid), key=lambda one: one[0])[1]
    return [{**base, **{name: float(np.clip(v, known_by[name].low, known_by[name].high)) for name, v in best.items()}}]
