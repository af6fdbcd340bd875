"""Resonances that move the ends of a plane as a support does, and not as a rotor that is not even."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from service.identification.result.parts import ModeResult
    from sim.datasheet import Datasheet

SUPPORTS = np.array([(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
"""How A and B move on a common support, and on the pedestal of either (law of sim/effects/support_resonance.py)."""
MOVES_AS_ONE = 0.02
"""Angle (rad) between one of these and how A and B move in a mode up to which they move as on a support.
Supports of an independent program, their sensors' gains off by 1.5 %, are within 0.001."""
LOPSIDED = 0.1
"""The same of another mode from which on it shows that the rotor has no symmetry that would make its modes so."""
SAME = 0.02
"""Relative difference of frequency up to which two modes are one."""


def move_as_supports(shapes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which modes of one plane only a support explains: (n,), true where both ends move alike, or one end alone.

    A support's reaction moves bearings and sensors of its end by one amount, so that its residues are equal; a mode of
    the rotor does so only where the rotor is even, and then no other mode tells otherwise.

    ``shapes`` (n, 2, 2) at bearings and at sensors, of A and B each; of any scale.
    """
    unit = shapes / np.maximum(np.linalg.norm(shapes, axis=-1, keepdims=True), np.finfo(float).tiny)
    off = _angle(unit, SUPPORTS)
    mirrored = _angle(unit, SUPPORTS * (1, -1))
    others_differ = (np.minimum(off, mirrored) > LOPSIDED).any(axis=0)
    one_sign = (shapes[:, 0] * shapes[:, 1]).sum(axis=-1) > 0
    return np.asarray(one_sign & ((off < MOVES_AS_ONE) & others_differ).any(axis=-1))


def _angle(unit: NDArray[np.float64], moves: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) between unit shapes and what moves as a support, at bearings or sensors, the larger, rad."""
    along = np.abs(unit @ (moves / np.linalg.norm(moves, axis=-1, keepdims=True)).T)
    return np.asarray(np.arccos(np.clip(along, 0.0, 1.0)).max(axis=1))


def told_supports(modes: Sequence[ModeResult], datasheet: Datasheet) -> list[str]:
    """A sentence on every identified mode that seems to be a support's and that the datasheet does not name."""
    rotor = [m for m in modes if m.kind == "rotor"]
    shapes = [[[e.value for e in at] for at in (m.shape_at_bearings, m.shape_at_sensors)] for m in rotor]
    support = move_as_supports(np.array(shapes).reshape(-1, 2, 2))
    found = (m.natural_frequency_rad_s.value / (2 * np.pi) for m, s in zip(rotor, support, strict=True) if s)
    return [
        f"the mode at {f:.1f} Hz moves bearings and sensors as a support does, and no other mode here is as even: look "
        "at the housing and its foundation before it is called the rotor's"
        for f in found
        if not any(abs(f / m.frequency_hz - 1) < SAME for m in datasheet.modes)
    ]
