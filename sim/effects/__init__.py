"""The catalogue of effects that a twin can lack: one small file each, found by its name.

A file ``sim/effects/<id>.py`` defines ``EFFECT``; nothing else has to be registered.

>>> effect("loop_delay").path
'amplifier'
"""

from __future__ import annotations

import importlib
import pkgutil

from sim.effect import Effect
from sim.errors import EffectError


def _discover() -> dict[str, Effect]:
    found = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(__path__)):
        found[module] = importlib.import_module(f"{__name__}.{module}").EFFECT
    return found


CATALOGUE: dict[str, Effect] = _discover()


def aliases(one: str, other: str) -> bool:
    """Whether two effects are known to look alike.

    >>> aliases("sensor_lag", "eddy_currents"), aliases("sensor_lag", "runout")
    (True, False)
    """
    return other in CATALOGUE[one].aliases or one in CATALOGUE[other].aliases


def effect(name: str) -> Effect:
    """The effect of that id.

    Raises
    ------
    EffectError
        No such id; the message lists the known ones.
    """
    try:
        return CATALOGUE[name]
    except KeyError:
        raise EffectError(f"no effect {name!r} in the catalogue; known are {', '.join(CATALOGUE)}") from None
