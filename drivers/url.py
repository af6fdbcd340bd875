"""The one factory of controllers: a URL says which driver, and where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from urllib.parse import SplitResult, parse_qs, urlsplit

from drivers.controller import Controller
from drivers.errors import ControllerError
from drivers.simulated.driver import SimulatedController
from sim.rig import Rig

Opener = Callable[[SplitResult, dict[str, str], Rig | None], Controller]


def _simulated(url: SplitResult, query: dict[str, str], rig: Rig | None) -> Controller:
    if rig is None:
        from sim import datasheet, twin
        from sim.reference import reference_rig

        rig = twin.rig_from_datasheet(datasheet.read(Path(query["rig"]))) if "rig" in query else reference_rig()
    return SimulatedController(rig, seed=int(query.get("seed", "0")))


SCHEMES: dict[str, tuple[Opener, frozenset[str]]] = {
    "simulated": (_simulated, frozenset({"rig", "seed"})),
}
"""scheme: (opener, names of its query)."""


def connect(url: str, rig: Rig | None = None) -> Controller:
    """Controller at a URL.

    ======================================================= ===============================================
    ``simulated://?rig=rig.toml&seed=1``                    simulated rig in this process; without ``rig``
                                                            the reference rig, or the argument ``rig``
    ======================================================= ===============================================

    Raises
    ------
    ControllerError
        An unknown scheme or option; names the ones there are.
    BusError
        Nothing answers there.
    """
    parts = urlsplit(url)
    if parts.scheme not in SCHEMES:
        raise ControllerError(f"{url!r} has no known scheme; use one of {', '.join(f'{s}://' for s in SCHEMES)}")
    opener, known = SCHEMES[parts.scheme]
    query = {name: values[-1] for name, values in parse_qs(parts.query, keep_blank_values=True).items()}
    if unknown := sorted(set(query) - known):
        raise ControllerError(f"{url!r} has an unknown option {unknown[0]!r}; {parts.scheme}:// knows {sorted(known)}")
    return opener(parts, query, rig)
