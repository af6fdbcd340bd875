"""Start of a filter that the controller has and its datasheet has not: by linear regression on a grid of its poles."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.predict import weight
from service.gap.measured.observation import Observation
from sim import control_law
from sim.effect import Effect
from sim.effects.controller_mismatch import ADDED
from sim.rig import Rig

Real = NDArray[np.float64]

FREQUENCIES, BEYOND = 30, 3.0
"""Frequencies of the grid, and how far beyond the lines at either end they go, as a ratio."""
DAMPING_RATIOS = (0.05, 0.15, 0.4, 0.8, 1.5, 4.0, 12.0)


def start(effect: Effect, rig: Rig, o: Observation) -> dict[str, float]:
    """Parameters of the filter that explains most of what the controller of a rig does otherwise than stated.

    Of all axes alike, at the excited frequencies of the sweep ``o``. Its gains far below, at and far above its
    frequency are linear in what the controller answers to a displacement, whatever its poles are. By name: those of
    `sim.effects.controller_mismatch.ADDED` (1), ``filter_frequency_hz`` (Hz) and ``filter_damping_ratio`` (1).
    """
    known, f = {p.name: p for p in effect.parameters}, o.fundamental
    omega = 2 * np.pi * o.points_hz
    early = np.exp(1j * omega * rig.controller.sample_time_s * rig.logging_offset_samples)[:, None]
    stated = -control_law.responses(rig.controller, omega, rig.n_axes) * o.Y[:, f] * early
    w = weight(o, "u")[:, f]
    wanted = stacked(((o.U[:, f] - o.R[:, f] * early - stated) * w)[..., None])[:, 0]
    s = 2j / rig.controller.sample_time_s * np.tan(omega / 2 * rig.controller.sample_time_s)

    def regressed(poles: tuple[float, float]) -> tuple[float, Real]:
        """What is left of the sum of squares, and the filter's three changes."""
        own, zeta = 2 * np.pi * poles[0], poles[1]
        below = s**2 + 2 * zeta * own * s + own**2
        shapes = np.stack([own**2 / below, 2 * zeta * own * s / below, s**2 / below], axis=-1)
        columns = stacked((stated * w)[..., None] * shapes[:, None, :])
        found = np.asarray(np.linalg.lstsq(columns, wanted, rcond=None)[0], dtype=np.float64)
        return float(np.sum((wanted - columns @ found) ** 2)), found

    at = known["filter_frequency_hz"]
    lowest, highest = max(o.frequency_hz[0] / BEYOND, at.low), min(o.frequency_hz[-1] * BEYOND, at.high)
    grid = list(product(np.geomspace(lowest, highest, FREQUENCIES).tolist(), DAMPING_RATIOS))
    (_, found), poles = min(((regressed(poles), poles) for poles in grid), key=lambda one: one[0][0])
    changes = {
        n: float(np.clip(v, known[n].low, known[n].high)) for (n, _), v in zip(ADDED, found.tolist(), strict=True)
    }
    return {**changes, **dict(zip(("filter_frequency_hz", "filter_damping_ratio"), poles, strict=True))}
