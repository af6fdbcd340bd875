"""Add diagnosed effects to a twin: a datasheet with effects, in one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from service.gap.measured.observation import GapError
from service.gap.origin import datasheet_digest
from service.gap.shape import Parameter, Report
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.output import first_problem
from sim.datasheet import Datasheet
from sim.effects import effect
from sim.errors import EffectError, LevitationError
from sim.stepping import Simulation
from sim.twin import non_rotating, rig_from_datasheet
from sim.wording import in_words

NO_GAP = "no_gap"
"""Verdict of a diagnosis that found nothing to add."""


def applied(datasheet: Datasheet, document: Mapping[str, Any]) -> Datasheet:
    """The datasheet with the effects that a gap report (gap.json) found, at their fitted parameters.

    Where it found no gap, that is the datasheet as it is: the twin is complete. Where it found that the twin is out of
    date, it is the twin without the effects that the rig does not show.

    An effect that the twin has already is refused: its parameters in the report are what is missing beside it, not the
    total, and two entries of one effect in a file would hide that.

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
    # a gyroscopic moment that is found is the whole one: that of the datasheet would come on top
    still = non_rotating(datasheet) if "gyroscopic_coupling" in names else datasheet
    return replace(still, effects=(*datasheet.effects, *added))


def of_another(datasheet: Datasheet, document: Mapping[str, Any]) -> bool:
    """Whether a report states the digest of another datasheet, so that its effects were fitted beside other values."""
    made_from = document.get("of")
    digest = made_from.get("datasheet_sha256") if isinstance(made_from, Mapping) else None
    return isinstance(digest, str) and digest != datasheet_digest(datasheet)


def not_told_apart(document: Mapping[str, Any]) -> dict[str, list[str]]:
    """Effects that may be in the place of one that a report adds, by that one, as the data do not tell them apart.

    Without those that fit about as well and are far less likely, as in the report's sentence.
    """
    report, open_classes = _read(document), dict[str, list[str]]()
    added = report.verdict.effects
    evidence = {frozenset(c.effects): c.log_evidence for c in report.candidates if c.log_evidence is not None}
    best = evidence.get(frozenset(added))

    def far_less_likely(named: str, other: str) -> bool:
        own = evidence.get(frozenset({*added, other} - {named}))
        return best is not None and own is not None and own < best - ALIKE_LOG_EVIDENCE

    for group in report.verdict.indistinguishable:
        for named in [name for name in group if name in added][:1]:
            if rivals := [e for e in group if e not in added and not far_less_likely(named, e)]:
                open_classes.setdefault(named, []).extend(rivals)
    return open_classes


def cannot_run(twin: Datasheet) -> str | None:
    """Why a twin does not levitate, in words; None where it does.

    An effect was fitted together with the datasheet's values, but the twin has the unfitted ones. With these it may not
    levitate, although the measured rig does.
    """
    try:
        # the simulation takes whole samples only, and levitation does not depend on the log
        Simulation(replace(rig_from_datasheet(twin), logging_offset_samples=0.0))
    except LevitationError as error:
        # the remedy in its message is for a controller that is at fault
        return str(error).removeprefix(f"rig {twin.name}: ").partition("; ")[0]
    except EffectError as error:
        return str(error)
    return None


def _read(document: Mapping[str, Any]) -> Report:
    try:
        return Report.model_validate(dict(document))
    except ValidationError as error:
        raise GapError(
            f"the gap report {first_problem(error)}; diagnose again, which writes a whole gap.json"
        ) from error


def _values(name: str, prefix: str, fitted: Mapping[str, Parameter]) -> tuple[tuple[str, float], ...]:
    """Values of an effect's parameters; optional and dormant ones that the report lacks are at their null."""
    known = effect(name).parameters
    missing = [p.name for p in known if prefix + p.name not in fitted and not (p.optional or p.dormant)]
    if missing:
        raise GapError(
            f"the gap report gives {name} no {' and no '.join(missing)}; diagnose again, which writes a whole gap.json"
        )
    values = ((p, fitted[prefix + p.name].value if prefix + p.name in fitted else p.null) for p in known)
    # a twin need not state a dormant parameter at its null
    return tuple((p.name, value) for p, value in values if not (p.dormant and value == p.null))
