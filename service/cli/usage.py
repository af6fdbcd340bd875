"""Values of options that cannot be meant: bad usage, told with the option and what is valid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from service.remarks import one_line
from sim.errors import AmbError


@contextmanager
def value_of(option: str, kind: type[AmbError] = AmbError) -> Iterator[None]:
    """An error of this kind is one of an option's value: it names the option, and the status is 2."""
    try:
        yield
    except kind as error:
        raise typer.BadParameter(one_line(str(error)), param_hint=option) from error


def finite(value: float | None) -> float | None:
    """Callback of an option that is a number: infinity and what is no number are refused."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is no finite number")
    return value


def speed(value: float | None) -> float | None:
    """Callback of an option that is a rotor's speed, rad/s: one at which none turns is refused."""
    from service.experiment.speeds import impossible

    if finite(value) is not None and (why := impossible(float(value or 0.0))):
        raise typer.BadParameter(f"it {why}")
    return value


def job_id(value: str) -> str:
    """Callback of an argument that is a job's id."""
    if not value.startswith("job_"):
        raise typer.BadParameter(f"{value!r} is no id of a job, which begins with job_; ambit jobs lists them")
    return value
