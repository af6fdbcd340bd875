"""Names of effects, paths and the like as a person says them."""

from __future__ import annotations


def in_words(name: str) -> str:
    """An identifier in words; a mixture of effects is joined by ``+``.

    >>> in_words("loop_delay+sensor_lag")
    'loop delay + sensor lag'
    """
    return name.replace("_", " ").replace("+", " + ")
