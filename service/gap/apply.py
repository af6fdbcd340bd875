"""Add a diagnosed effect to the twin: datasheet and effects, in one file that everything else reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from service.gap.observation import GapError
from sim.datasheet import Datasheet
from sim.effects import effect


def applied(datasheet: Datasheet, document: Mapping[str, Any]) -> Datasheet:
    """The datasheet with the effects that a gap report (gap.json) found, at their fitted parameters.

    An effect that the twin has already is refused: its parameters in the report are what is still missing, not
    the total, and two entries of one effect in a file would hide that.

    Raises
    ------
    GapError
        The report names no effect, is of another rig, or adds an effect that the twin has already.
    """
    if document.get("format") != "amb-gap-report":
        raise GapError('this is no gap report: its "format" is not "amb-gap-report"')
    if document.get("rig") != datasheet.name:
        raise GapError(f"the report is of rig {document.get('rig')!r}, the datasheet of {datasheet.name!r}")
    names = tuple(document["verdict"]["effects"])
    if not names:
        raise GapError(f"the report's verdict is {document['verdict']['kind']}: there is no effect to add")
    present = {name for name, _ in datasheet.effects}
    if present & set(names):
        raise GapError(f"the twin has {', '.join(sorted(present & set(names)))} already; apply to the first datasheet")
    fitted = next((c for c in document["candidates"] if tuple(c["effects"]) == names), None)
    if fitted is None:
        raise GapError(f"the report lists no parameters of {' + '.join(names)}")
    added = []
    for name in names:
        prefix = f"{name}." if len(names) > 1 else ""
        known = [p.name for p in effect(name).parameters]
        values = tuple((p, float(fitted["parameters"][prefix + p]["value"])) for p in known)
        added.append((name, values))
    return replace(datasheet, effects=(*datasheet.effects, *added))
