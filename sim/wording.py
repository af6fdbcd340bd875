"""Names of effects, paths and the like as a person says them."""

from __future__ import annotations


def in_words(name: str) -> str:
    """An identifier in words; a mixture of effects is joined by ``+``.

    >>> in_words("loop_delay+sensor_lag")
    'loop delay + sensor lag'
    """
    return name.replace("_", " ").replace("+", " + ")


def times(ratio: float) -> str:
    """How many times as large something is, to two digits and without an exponent.

    >>> times(1.337), times(12.34), times(2498.7)
    ('1.3', '12', '2499')
    """
    return f"{ratio:.2g}" if abs(ratio) < 99.5 else f"{ratio:.0f}"
