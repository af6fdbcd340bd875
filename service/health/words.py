"""What drifted, in the words of a check's sentence. Of its own, for the API imports it, and compares nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def changed(figure: str, change_percent: float) -> str:
    """A figure that drifted, in words, with its change to two digits.

    >>> changed("gain", 112.3), changed("gain", -2.04), changed("gain", 0.00012)
    ('gain +110 %', 'gain -2 %', 'gain +0.00012 %')
    """
    return f"{figure} {float(f'{change_percent:.2g}'):+z.10g} %"


def unexplained(plane: str) -> str:
    """A plane of which more is wrong than its figures."""
    return f"plane {plane} has a change that no parameter explains"


def other_law(*axes: str) -> str:
    """Axes whose controller is another one.

    >>> other_law("xA", "xB")
    'the controller of xA, xB is not the one of the commissioning'
    """
    return f"the controller of {', '.join(axes)} is not the one of the commissioning"


def drifted_words(document: Mapping[str, Any]) -> list[str]:
    """What drifted in a check, by its health.json, in words, the surest first; what has none, by its name."""
    return [_words(name, document["parameters"].get(name, {})) for name in document["drifted"]]


def _words(name: str, figure: Mapping[str, Any]) -> str:
    plane, _, what = name.partition(".")
    if what == "unexplained":
        return unexplained(plane)
    if what.startswith("controller_"):
        return other_law(plane + what.removeprefix("controller_"))
    return changed(figure["description"], figure["change_percent"]) if "description" in figure else name
