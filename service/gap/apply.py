"""Add a diagnosed effect to the twin: datasheet and effects, in one file that everything else reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

from pydantic import BaseModel, FiniteFloat, ValidationError, model_validator

from service.gap.measured.observation import GapError
from service.gap.origin import datasheet_digest
from sim.datasheet import Datasheet
from sim.effects import effect
from sim.errors import EffectError, LevitationError
from sim.stepping import Simulation
from sim.twin import rig_from_datasheet
from sim.wording import in_words

NO_GAP = "no_gap"
"""Verdict of a diagnosis that found nothing to add."""


class _Verdict(BaseModel):
    kind: str
    effects: list[str]
    outdated: list[str] = []


class _Parameter(BaseModel):
    value: FiniteFloat


class _Candidate(BaseModel):
    effect: str = ""
    effects: list[str] = []
    parameters: dict[str, _Parameter]

    @model_validator(mode="after")
    def _names(self) -> Self:
        self.effects = self.effects or self.effect.split("+")
        return self


class _Report(BaseModel):
    """What is read of a gap.json; the rest may be anything."""

    format: str = ""
    rig: str = ""
    verdict: _Verdict
    candidates: list[_Candidate] = []


def applied(datasheet: Datasheet, document: Mapping[str, Any]) -> Datasheet:
    """The datasheet with the effects that a gap report (gap.json) found, at their fitted parameters.

    Where it found no gap, that is the datasheet as it is: the twin is complete, and what takes it goes on. Where it
    found that the twin names effects that the rig does not show, it is the twin without these.

    An effect that the twin has already is refused: its parameters in the report are what is still missing, not
    the total, and two entries of one effect in a file would hide that.

    Raises
    ------
    GapError
        The report lacks a field, found a gap that no effect explains, is of another rig, adds an effect that the twin
        has already, or takes one out that it does not have.
    """
    if document.get("format") != "amb-gap-report":
        raise GapError('this is no gap report: its "format" is not "amb-gap-report"')
    report = _read(document)
    if report.rig != datasheet.name:
        raise GapError(f"the report is of rig {report.rig!r}, the datasheet of {datasheet.name!r}")
    names = report.verdict.effects
    if gone := set(report.verdict.outdated):
        if missing := gone - {name for name, _ in datasheet.effects}:
            raise GapError(
                f"the report takes {', '.join(sorted(missing))} out of the twin, which does not name it; give the twin "
                "that was diagnosed"
            )
        return replace(datasheet, effects=tuple(one for one in datasheet.effects if one[0] not in gone))
    if not names:
        if report.verdict.kind == NO_GAP:
            return datasheet
        raise GapError(f"the report's verdict is {in_words(report.verdict.kind)}: there is no effect to add")
    present = {name for name, _ in datasheet.effects}
    if present & set(names):
        raise GapError(f"the twin has {', '.join(sorted(present & set(names)))} already; apply to the first datasheet")
    fitted = next((c.parameters for c in report.candidates if c.effects == names), None)
    if fitted is None:
        raise GapError(f"the report lists no parameters of {' + '.join(names)}")
    added = tuple((name, _values(name, f"{name}." if len(names) > 1 else "", fitted)) for name in names)
    return replace(datasheet, effects=(*datasheet.effects, *added))


def of_another(datasheet: Datasheet, document: Mapping[str, Any]) -> bool:
    """Whether a report says that it was made with another datasheet, beside whose values its effects were fitted."""
    made_from = document.get("of")
    told = made_from.get("datasheet_sha256") if isinstance(made_from, Mapping) else None
    return isinstance(told, str) and told != datasheet_digest(datasheet)


def cannot_run(twin: Datasheet) -> str | None:
    """Why a twin is no rig that levitates as it stands, in words; None where it is one.

    An effect was fitted beside the datasheet's own values, of which the twin has the unfitted ones: together they may
    be a rig that does not levitate, although the measured one does.
    """
    try:
        # in time a log is off by whole samples only, and whether the rotor is held does not hang on it
        Simulation(replace(rig_from_datasheet(twin), logging_offset_samples=0.0))
    except LevitationError as error:
        # its remedy is of a rig whose controller is at fault
        return str(error).removeprefix(f"rig {twin.name}: ").partition("; ")[0]
    except EffectError as error:
        return str(error)
    return None


def _read(document: Mapping[str, Any]) -> _Report:
    try:
        return _Report.model_validate(dict(document))
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(map(str, problem["loc"]))
        wrong = f'has no "{where}"' if problem["type"] == "missing" else f'has a wrong "{where}": {problem["msg"]}'
        raise GapError(f"the gap report {wrong}; diagnose again, which writes a whole gap.json") from error


def _values(name: str, prefix: str, fitted: Mapping[str, _Parameter]) -> tuple[tuple[str, float], ...]:
    """Values of an effect's parameters; what its law may do without, and a report does not tell, is null."""
    known = effect(name).parameters
    missing = [p.name for p in known if prefix + p.name not in fitted and not p.optional]
    if missing:
        raise GapError(
            f"the gap report gives {name} no {' and no '.join(missing)}; diagnose again, which writes a whole gap.json"
        )
    told = ((p, fitted[prefix + p.name].value if prefix + p.name in fitted else p.null) for p in known)
    # an imbalance of nought is what a twin that says nothing of it has
    return tuple((p.name, value) for p, value in told if not (p.dormant and value == p.null))
