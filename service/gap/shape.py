"""The fields of a gap.json that are read back, with their types; others may be anything."""

from __future__ import annotations

from typing import Any, Self

from pydantic import BaseModel, FiniteFloat, model_validator


class Verdict(BaseModel):
    """What a diagnosis found."""

    kind: str
    effects: list[str]
    outdated: list[str] = []
    indistinguishable: list[list[str]] = []
    probability: FiniteFloat | None = None


class Parameter(BaseModel):
    """A parameter of an explanation."""

    value: FiniteFloat
    std: FiniteFloat | None = None
    at_bound: str | None = None


class _Candidate(BaseModel):
    effect: str = ""
    effects: list[str] = []
    parameters: dict[str, Parameter]
    log_evidence: FiniteFloat | None = None

    @model_validator(mode="after")
    def _names(self) -> Self:
        self.effects = self.effects or self.effect.split("+")
        return self


class Report(BaseModel):
    """What is read to apply a report."""

    format: str = ""
    rig: str = ""
    of: Any = None
    verdict: Verdict
    candidates: list[_Candidate] = []
    datasheet_off: list[str] = []


class _ScoredVerdict(Verdict):
    indistinguishable: list[list[str]]
    probability: FiniteFloat


class ScoredReport(Report):
    """What is read to score a report."""

    verdict: _ScoredVerdict
