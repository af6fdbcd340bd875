"""Which speeds of a rotor count as one, for figures that were measured at them."""

from __future__ import annotations

SPEED_APART, SPEED_APART_RAD_S = 0.01, 1.0
"""How far speeds may be apart that count as one: a share of it, and rad/s."""


def alike(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds, whichever way the shaft turns, count as one.

    >>> alike(314.0, -316.0), alike(0.0, 314.0)
    (True, False)
    """
    apart = abs(abs(other_rad_s) - abs(one_rad_s))
    return apart <= SPEED_APART_RAD_S + SPEED_APART * abs(other_rad_s)
