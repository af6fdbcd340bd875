"""Frequency responses with names and units: what is exported, and what a file gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Experiment
from service.exports.documents import VERSION, reading
from service.exports.errors import ExportError
from service.exports.linear import UNITS
from service.identification.measured.etfe import FrequencyResponse, Path, etfe
from service.identification.measured.points import plane_points, planes_of
from service.identification.measured.sweeps import chosen_sweeps

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
FORMAT = "amb-frequency-response"
PATHS: tuple[Path, ...] = ("u->y", "u->i", "i->y", "r->u", "r->y")


@dataclass(frozen=True)
class Responses:
    """A matrix of frequency responses."""

    name: str
    frequency_hz: Real
    """(F,) rising."""
    value: Complex
    """(F, n_out, n_in)"""
    std: Real | None
    """(F, n_out, n_in) standard deviation of the complex entry, E|dG|^2 = std^2; None where it is not known."""
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]

    def __post_init__(self) -> None:
        shape = (len(self.frequency_hz), len(self.outputs), len(self.inputs))
        if self.value.shape != shape or (self.std is not None and self.std.shape != shape):
            raise ExportError(f"response {self.name}: its values have shape {self.value.shape}, its names say {shape}")
        if len(self.input_units) != shape[2] or len(self.output_units) != shape[1]:
            raise ExportError(f"response {self.name}: every input and output needs one unit")
        if not (np.all(np.isfinite(self.frequency_hz)) and np.all(np.diff(self.frequency_hz) > 0)):
            raise ExportError(f"response {self.name}: frequencies must be finite and rise")


def of_experiment(
    experiment: Experiment, path: Path = "u->y", sweep: str = "", plane: str | None = None
) -> dict[str, Responses]:
    """Measured responses by plane.

    Parameters
    ----------
    sweep
        Comment of the sweep; the main one without it.
    plane
        The only one that is wanted, whatever the others lack; every excited one without it.

    Raises
    ------
    AmbError
        No such sweep, no such plane excited, no currents logged, or no frequency with both axes excited.
    """
    if path not in PATHS:
        raise ExportError(f"no response {path!r} can be exported; give one of {', '.join(PATHS)}")
    found = chosen_sweeps(experiment).main.sweep if not sweep else experiment.named(sweep)
    if found is None:
        names = ", ".join(s.comment for s in experiment.sweeps)
        raise ExportError(f"the experiment has no sweep {sweep!r}; it has {names}")
    axes = tuple(experiment.axes)
    excited = [
        name for name, pair in planes_of(axes).items() if np.any(np.isin(found.axis, pair) & (found.amplitude_a > 0))
    ]
    if plane is not None and plane not in excited:
        raise ExportError(f"the sweep excites no plane {plane!r}; it excites {', '.join(excited)}")
    return {
        name: responses(f"{experiment.rig} {name} {path}", etfe(plane_points(found, axes, name), path), path, name)
        for name in ([plane] if plane else excited)
    }


def responses(name: str, measured: FrequencyResponse, path: Path, plane: str) -> Responses:
    """A measured response with the names of its signals."""
    source, target = path.split("->")
    return Responses(
        name,
        measured.frequency_hz,
        measured.value,
        measured.std,
        tuple(f"{source}_{plane}{a}" for a in "AB"),
        tuple(f"{target}_{plane}{a}" for a in "AB"),
        (UNITS[source],) * 2,
        (UNITS[target],) * 2,
    )


def document(r: Responses) -> dict[str, Any]:
    """As JSON."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": r.name,
        "inputs": list(r.inputs),
        "outputs": list(r.outputs),
        "input_units": list(r.input_units),
        "output_units": list(r.output_units),
        "frequency_hz": r.frequency_hz.tolist(),
        "real": r.value.real.tolist(),
        "imag": r.value.imag.tolist(),
        "std": None if r.std is None else r.std.tolist(),
    }


def from_document(found: Mapping[str, Any]) -> Responses:
    """The responses of a document.

    Raises
    ------
    ExportError
        It is none, or not whole.
    """
    with reading(found, FORMAT, "frequency response"):
        names = {k: tuple(str(s) for s in found[k]) for k in ("inputs", "outputs", "input_units", "output_units")}
        frequency = np.asarray(found["frequency_hz"], dtype=float)
        shape = (len(frequency), len(names["outputs"]), len(names["inputs"]))
        real, imag = (np.asarray(found[k], dtype=float).reshape(shape) for k in ("real", "imag"))
        std = None if found.get("std") is None else np.asarray(found["std"], dtype=float).reshape(shape)
        return Responses(str(found["name"]), frequency, real + 1j * imag, std, **names)
