"""Options of a job, checked when it is submitted: a job that cannot be done is refused before it waits."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from service.api.problems import UnprocessableError


class ProfileOptions(BaseModel):
    """Figures of the plan; those left out are as in the standard profile."""

    model_config = ConfigDict(extra="forbid")

    accuracy: float = Field(0.002, gt=0, le=0.5)
    points: int = Field(200, ge=4, le=2000)
    from_hz: float = Field(10.0, gt=0, le=10_000)
    to_hz: float = Field(1000.0, gt=0, le=20_000)
    validation_points: int = Field(50, ge=0, le=1000)
    validation_gain: float = Field(2.5, gt=0, le=10)
    amplifier_points: int = Field(50, ge=0, le=1000)
    amplifier_to_hz: float = Field(3000.0, gt=0, le=50_000)
    coarse_points: int = Field(28, ge=4, le=500)
    coarse_accuracy: float = Field(0.02, gt=0, le=1)
    blocks: int = Field(6, ge=2, le=100)
    displacement_share: float = Field(0.1, gt=0, le=0.5)
    current_share: float = Field(0.25, gt=0, le=0.5)
    nonlinearity: float = Field(0.2, gt=0, le=10)
    rig_seconds: float = Field(1000.0, gt=0, le=100_000)
    peak_points: int = Field(5, ge=0, le=50)
    tries: int = Field(5, ge=1, le=20)


class MultisineProfileOptions(BaseModel):
    """Figures of the plan of multisines; those left out are as in the standard profile."""

    model_config = ConfigDict(extra="forbid")

    from_hz: float = Field(10.0, gt=0, le=10_000)
    to_hz: float = Field(1000.0, gt=0, le=20_000)
    lines: int = Field(220, ge=8, le=2000)
    period_s: float = Field(1.0, ge=0.05, le=20)
    periods: int = Field(2, ge=2, le=50)
    realisations: int = Field(5, ge=2, le=50)
    settle_s: float = Field(0.8, gt=0, le=60)
    short_settle_s: float = Field(0.3, gt=0, le=60)
    validation_realisations: int = Field(2, ge=2, le=50)
    validation_gain: float = Field(0.6, gt=0, le=10)
    amplifier_realisations: int = Field(2, ge=2, le=50)
    amplifier_to_hz: float = Field(3000.0, gt=0, le=50_000)
    amplifier_lines: int = Field(60, ge=8, le=1000)
    amplifier_period_s: float = Field(0.2, ge=0.02, le=20)
    displacement_share: float = Field(0.25, gt=0, le=0.5)
    current_share: float = Field(0.25, gt=0, le=0.5)
    stiffness_hz: float = Field(100.0, gt=0, le=10_000)
    seed: int = Field(1, ge=0, le=2**31)
    tries: int = Field(4, ge=1, le=20)


class _ExperimentOptions(BaseModel):
    model_config = ConfigDict(extra="forbid")

    excitation: Literal["stepped-sine", "multisine"] = "stepped-sine"
    identify: bool = True
    priors: bool = False
    comment: str = Field("", max_length=500)


class SteppedSineOptions(_ExperimentOptions):
    """Options of an experiment with one tone after the other."""

    profile: Literal["standard", "quick"] | ProfileOptions = "standard"


class MultisineOptions(_ExperimentOptions):
    """Options of an experiment with multisines on all axes at once."""

    profile: Literal["standard", "quick"] | MultisineProfileOptions = "standard"


class IdentificationOptions(BaseModel):
    """Options of an identification."""

    model_config = ConfigDict(extra="forbid")

    priors: bool = False
    """Whether the datasheet's values count as priors, as wide as its tolerances."""


class HealthOptions(BaseModel):
    """Options of a health check."""

    model_config = ConfigDict(extra="forbid")

    budget_s: float = Field(90.0, ge=20.0, le=3600.0)


class NoOptions(BaseModel):
    """No options."""

    model_config = ConfigDict(extra="forbid")


_BY_KIND: dict[str, type[BaseModel]] = {
    "experiment": SteppedSineOptions,
    "identification": IdentificationOptions,
    "gap": NoOptions,
    "health": HealthOptions,
}
_ALTERNATIVES = (ProfileOptions.__name__, MultisineProfileOptions.__name__)


def checked_options(kind: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of a job, those left out filled in.

    Raises
    ------
    UnprocessableError
        One is unknown or out of range; names it.
    """
    multisine = kind == "experiment" and options.get("excitation") == "multisine"
    shape = MultisineOptions if multisine else _BY_KIND[kind]
    try:
        return shape.model_validate(options).model_dump(mode="json", exclude_unset=True)
    except ValidationError as error:
        deepest = max(error.errors(), key=lambda e: len(e["loc"]))  # of alternatives, the one that was meant
        names = [str(part) for part in deepest["loc"] if "[" not in str(part) and part not in _ALTERNATIVES]
        raise UnprocessableError(f"{'.'.join(['options', *names])}: {deepest['msg']}") from error
