"""The fields of a health check in a history that are read back, with their types; others may be anything."""

from __future__ import annotations

from typing import Annotated

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, FiniteFloat


class _Read(BaseModel):
    model_config = ConfigDict(strict=True)


class _Value(_Read):
    value: FiniteFloat
    std: FiniteFloat


class _Figure(_Read):
    baseline: _Value
    now: _Value
    change_percent: FiniteFloat
    drifted: bool


class CheckRead(_Read):
    """One line of history.jsonl."""

    checked_at: Annotated[AwareDatetime, Field(strict=False)]
    parameters: dict[str, _Figure]
    false_alarms_per_year: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    speed_rad_s: FiniteFloat | None = None
