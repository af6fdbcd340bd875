"""The speed of a rotor while it is measured: which speeds count as one, and what is said of one that changed."""

from __future__ import annotations

from service.experiment.data import Experiment

SPEED_APART, SPEED_APART_RAD_S = 0.01, 1.0
"""How far speeds may be apart that count as one: a share of it, and rad/s."""
SPEED_CHANGED = "speed_changed"
"""Attribute of a file whose rotor turned otherwise when the campaign had ended: from which speed to which."""


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


def changed_speed(experiment: Experiment) -> list[str]:
    """That the rotor's speed changed while the experiment was measured, in a sentence."""
    how = experiment.attributes.get(SPEED_CHANGED)
    if how is None:
        return []
    return [
        f"the rotor's speed changed {how} while it was measured, and every point is taken for one at the first: what "
        "goes by the speed, as gyroscopic coupling and runout, is wrong by that; measure at one speed"
    ]
