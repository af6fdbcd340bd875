"""Options of a job, checked when it is submitted: a job that cannot be done is refused before it waits."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.json_schema import models_json_schema
from pydantic_core import PydanticCustomError

from drivers.objects import MAX_BLOCKS
from service.api.problems import UnprocessableError
from service.campaign.aims import Profile
from service.campaign.multisine.plan import MultisineProfile
from service.health import budget

PRIORS = "Whether the datasheet's values count as priors, as wide as its tolerances."
_BAND = "band"
_STEPPED, _MULTISINE = Profile(), MultisineProfile()


def _must_rise(from_hz: float, to_hz: float) -> None:
    if from_hz >= to_hz:
        raise PydanticCustomError(_BAND, "from_hz must be below to_hz")


class ProfileOptions(BaseModel):
    """Figures of the plan; those left out are as in the standard profile."""

    model_config = ConfigDict(extra="forbid")

    accuracy: float = Field(
        _STEPPED.accuracy,
        gt=0,
        le=0.5,
        description="Wanted relative standard deviation of every column of the frequency response, each point.",
    )
    points: int = Field(
        _STEPPED.points,
        ge=4,
        le=2000,
        description="Log-spaced frequencies of the main sweep, each with every axis; peaks come on top.",
    )
    from_hz: float = Field(_STEPPED.from_hz, gt=0, le=10_000, description="Lowest frequency of the main sweep, Hz.")
    to_hz: float = Field(_STEPPED.to_hz, gt=0, le=20_000, description="Highest frequency of the main sweep, Hz.")
    validation_points: int = Field(
        _STEPPED.validation_points, ge=0, le=1000, description="Frequencies of the sweep that no fit sees."
    )
    validation_gain: float = Field(
        _STEPPED.validation_gain, gt=0, le=10, description="Amplitude of the validation sweep against the main one."
    )
    amplifier_points: int = Field(
        _STEPPED.amplifier_points,
        ge=0,
        le=1000,
        description="Frequencies of the sweep that is for the amplifiers alone.",
    )
    amplifier_to_hz: float = Field(_STEPPED.amplifier_to_hz, gt=0, le=50_000, description="Its highest frequency, Hz.")
    coarse_points: int = Field(
        _STEPPED.coarse_points, ge=4, le=500, description="Frequencies of the first, coarse look."
    )
    coarse_accuracy: float = Field(
        _STEPPED.coarse_accuracy, gt=0, le=1, description="Wanted relative standard deviation there."
    )
    blocks: int = Field(
        _STEPPED.blocks,
        ge=2,
        le=MAX_BLOCKS,
        description="Blocks of whole periods at every point; their scatter tells the noise.",
    )
    displacement_share: float = Field(
        _STEPPED.displacement_share,
        gt=0,
        le=0.5,
        description="Share of the linear range, and of the displacement limit, that the main sweep may use.",
    )
    current_share: float = Field(
        _STEPPED.current_share,
        gt=0,
        le=0.5,
        description="Share of the bias current, and of the current limit, that the main sweep may use.",
    )
    nonlinearity: float = Field(
        _STEPPED.nonlinearity,
        gt=0,
        le=10,
        description="Share of the accuracy that the cubic terms of the magnets' force may take.",
    )
    rig_seconds: float = Field(
        _STEPPED.rig_seconds,
        gt=0,
        le=100_000,
        description="Time of the rig that a campaign over four axes should need, s; others in proportion.",
    )
    peak_points: int = Field(
        _STEPPED.peak_points, ge=0, le=50, description="Points within the half-power width of a peak that resolve it."
    )
    tries: int = Field(
        _STEPPED.tries, ge=1, le=20, description="Attempts at one point: longer settling, other amplitudes."
    )

    @model_validator(mode="after")
    def _a_band(self) -> Self:
        _must_rise(self.from_hz, self.to_hz)
        return self


class MultisineProfileOptions(BaseModel):
    """Figures of the plan of multisines; those left out are as in the standard profile."""

    model_config = ConfigDict(extra="forbid")

    from_hz: float = Field(_MULTISINE.from_hz, gt=0, le=10_000, description="Lowest line of the main sweep, Hz.")
    to_hz: float = Field(_MULTISINE.to_hz, gt=0, le=20_000, description="Highest line of the main sweep, Hz.")
    lines: int = Field(
        _MULTISINE.lines,
        ge=8,
        le=2000,
        description="Odd lines of the main sweep, the detection lines among them included.",
    )
    period_s: float = Field(_MULTISINE.period_s, ge=0.05, le=20, description="Period of main and validation sweep, s.")
    periods: int = Field(_MULTISINE.periods, ge=2, le=50, description="Recorded periods of every experiment.")
    realisations: int = Field(
        _MULTISINE.realisations,
        ge=2,
        le=50,
        description="Draws of the phases, each played in as many experiments as there are axes.",
    )
    settle_s: float = Field(
        _MULTISINE.settle_s,
        gt=0,
        le=60,
        description="Settling to begin with, main and validation sweep, s; longer where the pilot's model rings on, "
        "doubled while the periods still change.",
    )
    short_settle_s: float = Field(
        _MULTISINE.short_settle_s, gt=0, le=60, description="Settling of the pilot and of the amplifier sweep, s."
    )
    validation_realisations: int = Field(
        _MULTISINE.validation_realisations,
        ge=2,
        le=50,
        description="Draws of the phases of the sweep that no fit sees.",
    )
    validation_gain: float = Field(
        _MULTISINE.validation_gain, gt=0, le=10, description="Level of the validation sweep against the main one."
    )
    amplifier_realisations: int = Field(
        _MULTISINE.amplifier_realisations,
        ge=2,
        le=50,
        description="Draws of the phases of the sweep that is for the amplifiers alone.",
    )
    amplifier_to_hz: float = Field(_MULTISINE.amplifier_to_hz, gt=0, le=50_000, description="Its highest line, Hz.")
    amplifier_lines: int = Field(_MULTISINE.amplifier_lines, ge=8, le=1000, description="Its lines.")
    amplifier_period_s: float = Field(_MULTISINE.amplifier_period_s, ge=0.02, le=20, description="Its period, s.")
    displacement_share: float = Field(
        _MULTISINE.displacement_share,
        gt=0,
        le=0.5,
        description="Share of the linear range, and of the displacement limit, that predicted peaks may take.",
    )
    current_share: float = Field(
        _MULTISINE.current_share,
        gt=0,
        le=0.5,
        description="Share of the bias current, and of the current limit, that predicted peaks may take.",
    )
    stiffness_hz: float = Field(
        _MULTISINE.stiffness_hz,
        gt=0,
        le=10_000,
        description="Below it the amplitude rises as the inverse of frequency, Hz.",
    )
    seed: int = Field(
        _MULTISINE.seed, ge=0, le=2**31, description="Of lines and phases: equal campaigns ask equal questions."
    )
    tries: int = Field(
        _MULTISINE.tries, ge=1, le=20, description="Attempts at one realisation: lower level, longer settling."
    )

    @model_validator(mode="after")
    def _a_band(self) -> Self:
        _must_rise(self.from_hz, self.to_hz)
        return self


class _ExperimentOptions(BaseModel):
    model_config = ConfigDict(extra="forbid")

    identify: bool = Field(True, description="Whether the experiment is identified once it is measured.")
    priors: bool = Field(False, description=PRIORS)


class SteppedSineOptions(_ExperimentOptions):
    """Options of an experiment with one tone after the other."""

    excitation: Literal["stepped-sine"] = "stepped-sine"
    profile: Literal["standard", "quick"] | ProfileOptions = "standard"


class MultisineOptions(_ExperimentOptions):
    """Options of an experiment with multisines on all axes at once, a tenth of the time; controllers must play them."""

    excitation: Literal["multisine"]
    profile: Literal["standard", "quick"] | MultisineProfileOptions = "standard"


class IdentificationOptions(BaseModel):
    """Options of an identification."""

    model_config = ConfigDict(extra="forbid")

    priors: bool = Field(False, description=PRIORS)


class HealthOptions(BaseModel):
    """Options of a health check."""

    model_config = ConfigDict(extra="forbid")

    budget_s: float = Field(
        budget.USUAL_S,
        ge=budget.SMALLEST_S,
        le=budget.LARGEST_S,
        description="Time of the rig that the check may take, s.",
    )
    false_alarms_per_year: float = Field(
        0.2, ge=1e-6, le=1.0, description="False alarms of the rig a year that are accepted, over all figures."
    )


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
    """Options of a job as they were given; what is left out is as it is by default when the job runs.

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
        # of alternatives, the one that was meant
        deepest = max(error.errors(), key=lambda e: (len(e["loc"]), e["type"] == _BAND))
        names = [str(part) for part in deepest["loc"] if "[" not in str(part) and part not in _ALTERNATIVES]
        why = deepest["msg"]
        if deepest["type"] == "extra_forbidden" and len(names) == 1:
            why = f"there is no such option of this kind of job; it has {', '.join(shape.model_fields) or 'none'}"
        raise UnprocessableError(f"{'.'.join(['options', *names])}: {why}") from error


_SHAPES = (SteppedSineOptions, MultisineOptions, IdentificationOptions, HealthOptions, NoOptions)
_REFERENCE = "#/components/schemas/{model}"
OF_A_JOB: dict[str, Any] = {"anyOf": [{"$ref": _REFERENCE.format(model=shape.__name__)} for shape in _SHAPES]}
"""Schema of a job's options: which of them it must be, its kind tells."""
OF_A_CHECK: dict[str, Any] = {"anyOf": [{"$ref": _REFERENCE.format(model=HealthOptions.__name__)}]}


def schemas() -> dict[str, Any]:
    """Schemas of all options by name, for OpenAPI."""
    _, found = models_json_schema([(shape, "validation") for shape in _SHAPES], ref_template=_REFERENCE)
    return dict(found["$defs"])
