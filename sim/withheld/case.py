"""A case: a rig with effects drawn from the catalogue, or with a law from beyond it, and its datasheet.

>>> draw(2, 7).kind
'clean'
>>> redrawn(draw(2, 7).truth()).truth() == draw(2, 7).truth()
True
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.datasheet import Datasheet
from sim.effect import Effect
from sim.effects import CATALOGUE, aliases
from sim.errors import AmbError, EffectError, LevitationError
from sim.rig import Rig
from sim.stepping import Simulation
from sim.withheld import CAMPAIGN_S
from sim.withheld.given import Given, given_in
from sim.withheld.rigs import SPEED_RAD_S, base_rig, datasheet_of
from sim.withheld.strength import strength
from sim.withheld.unlisted_laws import UNLISTED, Drawn, TamperedSimulation, Tampering

Generator = np.random.Generator

SHARES = (("single", 0.56), ("mixture", 0.14), ("clean", 0.14), ("unlisted", 0.16))
"""Kinds of cases and how often they come."""
ATTEMPTS = 60


@dataclass(frozen=True)
class Case:
    """One withheld truth and what goes with it."""

    number: int
    seed: int
    kind: str
    """"single", "mixture", "clean" or "unlisted"."""
    plain: Rig
    """The rig without what is withheld."""
    rig: Rig
    tampering: Tampering
    datasheet: Datasheet
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    """(id, ((parameter, value), ...)) of the catalogue's effects in the rig."""
    law: str = ""
    """Name of an unlisted law."""
    law_parameters: tuple[tuple[str, float], ...] = ()
    given: Given | None = None

    def simulation(self, seed: int, campaign_s: float = CAMPAIGN_S) -> Simulation:
        """The rig in time, with what is withheld; the law's state is the simulation's own.

        Parameters
        ----------
        seed
            Of the noise.
        campaign_s
            Rig time that the campaign will take, s.
        """
        return TamperedSimulation(self.rig, seed, copy.deepcopy(self.tampering), campaign_s)

    def truth(self) -> dict[str, Any]:
        """What is sealed, as plain values."""
        return {
            "case": self.number,
            "seed": self.seed,
            "kind": self.kind,
            "effects": [name for name, _ in self.effects],
            "parameters": {name: dict(values) for name, values in self.effects},
            "law": self.law,
            "law_parameters": dict(self.law_parameters),
            "speed_rad_s": self.plain.speed_rad_s,
            "given": None if self.given is None else self.given.document(),
        }


def draw(number: int, seed: int, given: Given | None = None) -> Case:
    """Case ``number`` of the trial with that seed; the same arguments give the same case.

    Parameters
    ----------
    number, seed
        From 0 on.
    given
        Rig on which to draw, in place of one that is drawn.

    Raises
    ------
    AmbError
        A negative number or seed, or no rig that levitates was found, which a sound catalogue does not let happen.
    LevitationError, EffectError
        The given rig does not levitate, or cannot be what its datasheet says.
    """
    if number < 0 or seed < 0:
        raise AmbError(f"case {number} of seed {seed}: give a number and a seed from 0 on")
    g = np.random.default_rng([seed, number])
    kind = _kind(number)
    if given is not None:
        Simulation(given.rig())
    for _ in range(ATTEMPTS):
        try:
            case = _case(number, seed, kind, given, g)
            Simulation(case.rig)
        except (EffectError, LevitationError):
            continue
        return case
    raise AmbError(f"case {number} of seed {seed}: no rig with its effects levitates; take another seed")


def redrawn(truth: Mapping[str, Any]) -> Case:
    """The case whose truth was sealed, drawn again.

    Raises
    ------
    AmbError
        It comes out as another one: it was sealed by another version of this program.
    """
    try:
        case = draw(truth["case"], truth["seed"], None if truth["given"] is None else given_in(truth["given"]))
        same = {name: truth[name] for name in case.truth()} == case.truth()
    except (KeyError, TypeError) as error:
        raise AmbError(f"the sealed truth cannot be drawn again: {error}; take the version that sealed it") from error
    if not same:
        raise AmbError("the sealed truth comes out otherwise when it is drawn again; take the version that sealed it")
    return case


def _kind(number: int) -> str:
    # van der Corput's idea with the golden ratio: any number of cases has the kinds in their shares
    place = (0.5 + number * 0.6180339887498949) % 1.0
    for name, share in SHARES:
        if place < share:
            return name
        place -= share
    return SHARES[-1][0]


def _case(number: int, seed: int, kind: str, given: Given | None, g: Generator) -> Case:
    plain = base_rig(g) if given is None else given.rig()
    if kind == "unlisted":
        law = str(g.choice(sorted(UNLISTED)))
        drawn: Drawn = UNLISTED[law](plain, g)
        sheet = datasheet_of(plain, g) if given is None else given.datasheet
        numbers = tuple(sorted(drawn.parameters.items()))
        return Case(number, seed, kind, plain, drawn.rig, drawn.tampering, sheet, (), law, numbers, given)
    count = {"single": 1, "mixture": 2, "clean": 0}[kind]
    chosen = _choose(count, plain, {name for name, _ in given.datasheet.effects} if given is not None else (), g)
    if any(e.needs_speed for e in chosen) and plain.speed_rad_s == 0:
        plain = replace(plain, speed_rad_s=float(g.uniform(*SPEED_RAD_S)))
    rig, drawn_effects = plain, []
    for e in chosen:
        values = strength(e, rig, g)
        rig = e.on(rig, **values)
        drawn_effects.append((e.id, tuple(sorted(values.items()))))
    sheet = datasheet_of(plain, g) if given is None else given.datasheet
    return Case(number, seed, kind, plain, rig, Tampering(), sheet, tuple(drawn_effects), given=given)


def _choose(count: int, rig: Rig, told: Collection[str], g: Generator) -> list[Effect]:
    """Distinct effects, none of them ``told``; two of a mixture are no aliases and mostly act on different paths."""
    fitting = [e for e in CATALOGUE.values() if e.needs_axes <= rig.n_axes and e.id not in told]
    while True:
        chosen = [fitting[k] for k in g.choice(len(fitting), count, replace=False)]
        if count < 2:
            return chosen
        a, b = chosen
        alike = aliases(a.id, b.id)
        if not alike and (a.path != b.path or g.uniform() < 0.3):
            return sorted(chosen, key=lambda e: e.id)
