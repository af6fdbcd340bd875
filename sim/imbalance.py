"""One bearing or plane that an effect changes more than the other: two shapes that such effects share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.effect import Parameter
from sim.rig import Array, Rig

NAMES = ("end_imbalance", "plane_imbalance")


def of_end(what: str, dormant: bool = False) -> Parameter:
    """The shape of an effect on ``what`` there is one of at each bearing, 0 where it is on both alike."""
    return _shape(NAMES[0], f"1: only {what} at A, -1: only {what} at B", dormant)


def of_plane(what: str, dormant: bool = False) -> Parameter:
    """The shape of an effect on ``what`` there is one of in each plane, 0 where it is in both alike."""
    return _shape(NAMES[1], f"1: only {what} in x, -1: only {what} in y; not used on one plane", dormant)


def parameters(what: str, dormant: bool = False) -> tuple[Parameter, Parameter]:
    """The two shapes of an effect on ``what`` there is one of in each axis, 0 where it is on all alike."""
    return of_end(what, dormant), of_plane(what, dormant)


def _shape(name: str, words: str, dormant: bool) -> Parameter:
    return Parameter(name, "1", -1.0, 1.0, 0.0, 0.0, description=words, strength=False, optional=True, dormant=dormant)


def shares(rig: Rig, p: Mapping[str, float]) -> Array:
    """What each axis changes over what all do in the mean, (n,); a plane that is alone has no other to differ from."""
    end, plane = (p[name] for name in NAMES)
    of_end, of_plane = {"A": 1 + end, "B": 1 - end}, {"x": 1 + plane, "y": 1 - plane}
    return np.array([of_end[axis[1]] * (of_plane[axis[0]] if rig.n_planes == 2 else 1.0) for axis in rig.axes])
