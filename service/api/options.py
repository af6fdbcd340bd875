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


class ExperimentOptions(BaseModel):
    """Options of an experiment."""

    model_config = ConfigDict(extra="forbid")

    profile: Literal["standard", "quick"] | ProfileOptions = "standard"
    identify: bool = True
    comment: str = Field("", max_length=500)


class HealthOptions(BaseModel):
    """Options of a health check."""

    model_config = ConfigDict(extra="forbid")

    budget_s: float = Field(90.0, ge=20.0, le=3600.0)


class NoOptions(BaseModel):
    """No options."""

    model_config = ConfigDict(extra="forbid")


_BY_KIND: dict[str, type[BaseModel]] = {
    "experiment": ExperimentOptions,
    "identification": NoOptions,
    "gap": NoOptions,
    "health": HealthOptions,
}


def checked_options(kind: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options of a job, those left out filled in.

    Raises
    ------
    UnprocessableError
        One is unknown or out of range; names it.
    """
    try:
        return _BY_KIND[kind].model_validate(options).model_dump(mode="json", exclude_unset=True)
    except ValidationError as error:
        deepest = max(error.errors(), key=lambda e: len(e["loc"]))  # of alternatives, the one that was meant
        names = [str(part) for part in deepest["loc"] if "[" not in str(part) and part != "ProfileOptions"]
        raise UnprocessableError(f"{'.'.join(['options', *names])}: {deepest['msg']}") from error
