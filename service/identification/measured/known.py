"""Effects that a twin names, in the identification: signals led back to where its model begins, and what is told.

The model of a plane begins where u reaches the amplifiers. Crosstalk before them, an offset of the log and a lag that
stands with the amplifiers are taken out of the logged signals; what comes behind is in `plane.parameters.Known.chain`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.identification.measured.points import PlanePoints
from sim.chain import Chain
from sim.datasheet import Datasheet
from sim.folded import Folded, KnownEffect, folded

ENTRY = "known_effects"
"""Of result.json: the effects that the twin named, and what became of each."""


def led_back(experiment: Experiment, chain: Chain) -> Experiment:
    """The experiment with u as it reached the amplifiers, and i as it were without their further lag."""
    if not chain.is_in_log:
        return experiment
    return replace(experiment, sweeps=tuple(_led_back(s, chain) for s in experiment.sweeps))


def _led_back(sweep: Sweep, chain: Chain) -> Sweep:
    u, i = sweep.U.astype(complex), None if sweep.I is None else sweep.I.astype(complex)
    for place, h in enumerate(sweep.harmonics):
        omega = 2 * np.pi * h * np.asarray(sweep.frequency_hz, dtype=float)
        u[:, :, place] = np.einsum("pau,pbu->pba", chain.drive_per_logged(omega), u[:, :, place])
        if i is not None:
            i[:, :, place] /= chain.current_lag(omega)[:, None, :]
    return replace(sweep, U=u, I=i)


def computed(points: PlanePoints, chain: Chain) -> PlanePoints:
    """The points with u as the controller computed it, before crosstalk."""
    if not chain.has_crosstalk:
        return points
    return replace(points, U=np.asarray(points.U @ np.linalg.inv(chain.crosstalk).T))


def document(effects: tuple[KnownEffect, ...]) -> list[dict[str, Any]]:
    """The entry of result.json."""
    return [
        {
            "effect": e.effect,
            "parameters": dict(e.parameters),
            "in_model": list(e.in_model),
            "not_in_model": list(e.not_in_model),
        }
        for e in effects
    ]


def as_identified(datasheet: Datasheet, result: Mapping[str, Any]) -> tuple[Folded, tuple[str, ...]]:
    """What a result's model holds: the datasheet with the effects that the result names, and what to know of it.

    A model goes with the effects that it was identified with. Where the twin names others by now, that is said: they
    are in none of its figures, or some of them, as a delay, are in them already.

    Raises
    ------
    KeyError, TypeError, AttributeError
        A damaged entry.
    EffectError
        An effect that this version does not know.
    """
    entry = result.get(ENTRY) or []
    then = tuple((str(e["effect"]), tuple((str(k), float(v)) for k, v in e["parameters"].items())) for e in entry)
    found = folded(replace(datasheet, effects=then))
    notes = [sentence for e in found.effects for sentence in e.sentences()]
    differing = sorted(set(datasheet.effects) ^ set(then))
    if differing:
        names = ", ".join(dict.fromkeys(name for name, _ in differing))
        notes.append(
            f"the twin's effects are not those that this result was identified with ({names}): its model is the one "
            "of then; identify the experiment once more with this twin (ambit identify)"
        )
    return found, tuple(notes)
