"""Values that came over a bus as what they stand for: numbers, whole numbers, codes of ours.

A vendor's controller, read by its own map, may tell codes that ours does not have, and not-a-number from an object
that is a float there. Neither is a fault of the bus: asking again would not help.
"""

from __future__ import annotations

import enum
import math
from typing import TypeVar

from drivers.errors import BusError, ControllerError
from drivers.packing import Value

C = TypeVar("C", bound=enum.IntEnum)
_SEE_TO = "correct its place or type in the map, or have the controller tell {}"


def number(value: Value) -> float:
    """A number that came over a bus; `BusError` for anything else."""
    if isinstance(value, str | tuple):
        raise BusError(f"{value!r} came where a number was expected")
    return value


def numbers(value: Value) -> tuple[float, ...]:
    """Numbers that came over a bus."""
    if isinstance(value, str):
        raise BusError(f"{value!r} came where numbers were expected")
    return value if isinstance(value, tuple) else (value,)


def finite(value: Value, name: str) -> float:
    """A number that is one.

    Parameters
    ----------
    name
        Of the object, as ``result.rig_samples``.

    Raises
    ------
    ControllerError
        Not-a-number or infinite; names the object.
    """
    told = number(value)
    if not math.isfinite(told):
        raise ControllerError(f"the controller tells {name} as {told}; {_SEE_TO.format('a number')}")
    return told


def whole(value: Value, name: str) -> int:
    """A whole number; raises as `finite`.

    >>> whole(6.0, "result.result")
    6
    """
    return int(finite(value, name))


def coded(codes: type[C], value: Value, name: str) -> C:
    """What a code stands for.

    Raises
    ------
    ControllerError
        There is no such code; names the object and those that there are.
    """
    told = number(value)
    for code in codes:
        if code == told:
            return code
    known = ", ".join(f"{code.value} {code.name.lower().replace('_', ' ')}" for code in codes)
    raise ControllerError(
        f"the controller tells {name} as {told:g}, and known are {known}; {_SEE_TO.format('one of these')}"
    )
