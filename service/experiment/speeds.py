"""Which speeds of a rotor count as one, for what is measured at them."""

from __future__ import annotations

SPEED_APART, SPEED_APART_RAD_S = 0.01, 1.0
"""How far speeds may be apart that count as one: a share of it, and rad/s."""


def same(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds, and the ways in which the shaft turns, count as one.

    >>> same(314.0, 316.0), same(314.0, -314.0), same(0.0, -0.5)
    (True, False, True)
    """
    return abs(other_rad_s - one_rad_s) <= SPEED_APART_RAD_S + SPEED_APART * abs(other_rad_s)


def alike(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds, whichever way the shaft turns, count as one.

    >>> alike(314.0, -316.0), alike(0.0, 314.0)
    (True, False)
    """
    return same(abs(one_rad_s), abs(other_rad_s))
