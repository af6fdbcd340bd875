"""How unlike an effect is in the axes: shapes that effects on what there is one of in each axis share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.effect import Parameter
from sim.rig import Array, Rig

NAMES = ("end_imbalance", "plane_imbalance")
OF_PLANES = ("plane_imbalance", "plane_frequency_ratio")
"""How much more a resonance of either kind, a mode or a housing, moves in x than in y, and its frequency in y over that
in x."""
DIAGONAL = "diagonal_imbalance"
"""What no bearing and no plane has more of: with it, any shares of four axes can be told."""
NO_ROOM = 1e-9
"""Range of the third shape below which the other two alone tell the shares, as those of one bearing."""


def of_end(what: str, dormant: bool = False) -> Parameter:
    """The shape of an effect on ``what`` there is one of at each bearing, 0 where it is on both alike."""
    return _shape(NAMES[0], f"1: only {what} at A, -1: only {what} at B", dormant)


def of_plane(what: str, dormant: bool = False) -> Parameter:
    """The shape of an effect on ``what`` there is one of in each plane, 0 where it is in both alike."""
    return _shape(NAMES[1], f"1: only {what} in x, -1: only {what} in y; not used on one plane", dormant)


def parameters(what: str, dormant: bool = False) -> tuple[Parameter, Parameter]:
    """The two shapes of an effect on ``what`` there is one of in each axis, 0 where it is on all alike."""
    return of_end(what, dormant), of_plane(what, dormant)


def of_diagonal(what: str) -> Parameter:
    """The third shape of such an effect, 0 where the ends' shares are the same in both planes."""
    words = f"1: as far to {what} xA and yB alone, -1: to xB and yA, as the other two let it; not on one plane"
    return _shape(DIAGONAL, words, dormant=True)


def _shape(name: str, words: str, dormant: bool) -> Parameter:
    return Parameter(name, "1", -1.0, 1.0, 0.0, 0.0, description=words, strength=False, optional=True, dormant=dormant)


def shares(rig: Rig, p: Mapping[str, float]) -> Array:
    """What each axis changes over what all do in the mean, (n,); a plane that is alone has no other to differ from."""
    end, plane = (p[name] for name in NAMES)
    if rig.n_planes == 1:
        return np.array([1 + _to_a(axis) * end for axis in rig.axes])
    both, diagonal = end * plane, p.get(DIAGONAL, 0.0)
    low, high = _range_of_both(end, plane)
    both += diagonal * (high - both if diagonal > 0 else both - low)
    of_axes = [1 + _to_a(a) * end + _to_x(a) * plane + _to_a(a) * _to_x(a) * both for a in rig.axes]
    return np.maximum(of_axes, 0.0)  # rounding may leave an axis that has none just below it


def of_shares(shares: Mapping[str, float]) -> dict[str, float]:
    """The shapes by name at which `shares` are in proportion to these of each axis, none of which is negative.

    >>> of_shares({"xA": 3.0, "xB": 0.0, "yA": 1.0, "yB": 0.0})
    {'end_imbalance': 1.0, 'plane_imbalance': 0.5, 'diagonal_imbalance': 0.0}
    >>> of_shares({"xA": 0.0, "xB": 1.0, "yA": 1.0, "yB": 0.0})["diagonal_imbalance"]
    -1.0
    """
    whole = sum(shares.values())
    end, plane, both = (
        sum(side(axis) * share for axis, share in shares.items()) / whole
        for side in (_to_a, _to_x, lambda axis: _to_a(axis) * _to_x(axis))
    )
    if {axis[0] for axis in shares} != {"x", "y"}:
        return {NAMES[0]: end, NAMES[1]: 0.0, DIAGONAL: 0.0}
    low, high = _range_of_both(end, plane)
    away = both - end * plane
    room = high - end * plane if away > 0 else end * plane - low
    diagonal = float(np.clip(away / room, -1.0, 1.0)) if room > NO_ROOM else 0.0
    return {NAMES[0]: end, NAMES[1]: plane, DIAGONAL: diagonal}


def _to_a(axis: str) -> float:
    return 1.0 if axis[1] == "A" else -1.0


def _to_x(axis: str) -> float:
    return 1.0 if axis[0] == "x" else -1.0


def _range_of_both(end: float, plane: float) -> tuple[float, float]:
    """Least and largest excess of xA and yB over xB and yA at which no axis has a negative share."""
    return abs(end + plane) - 1, 1 - abs(end - plane)
