"""A state-space model with the names and units of its signals: what is exported, and what a file gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.exports.documents import VERSION, reading
from service.exports.errors import ExportError
from service.identification.plane.combine import StateSpace, series
from service.identification.result.saved import is_identified
from service.identification.result.shape import ResultSpaces
from service.output import whole

Real = NDArray[np.float64]
Part = Literal["plant", "amplifiers", "whole"]
PARTS: tuple[Part, ...] = ("plant", "amplifiers", "whole")
FORMAT = "amb-state-space"
UNITS = {"u": "A", "r": "A", "i": "A", "y": "m"}
"""By the first letter of a signal's name."""


@dataclass(frozen=True)
class Linear:
    """x' = A x + B u, y = C x + D u in continuous time; inputs and outputs in SI."""

    name: str
    A: Real
    B: Real
    C: Real
    D: Real
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    comment: str = ""

    def __post_init__(self) -> None:
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        wanted = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        for name, shape in wanted.items():
            found = getattr(self, name)
            if found.shape != shape:
                raise ExportError(
                    f"model {self.name}: {name} has shape {found.shape}, its names say {shape}; the file is not whole"
                )
            if not np.all(np.isfinite(found)):
                raise ExportError(f"model {self.name}: {name} has an entry that is not finite")
        if len(self.input_units) != m or len(self.output_units) != p:
            raise ExportError(f"model {self.name}: every input and output needs one unit")


def matrix(values: ArrayLike, rows: int, columns: int) -> Real:
    """Values as (rows, columns), also where one of both is zero or a tool dropped a dimension."""
    found = np.asarray(values, dtype=np.float64)
    if found.size != rows * columns:
        raise ExportError(f"a matrix has {found.size} entries where {rows} x {columns} are needed")
    return found.reshape(rows, columns)


def linear(name: str, space: StateSpace, comment: str = "") -> Linear:
    """A state space of the identification with the units of its signals."""
    return Linear(
        name,
        space.A,
        space.B,
        space.C,
        space.D,
        space.states,
        space.inputs,
        space.outputs,
        tuple(_unit(s) for s in space.inputs),
        tuple(_unit(s) for s in space.outputs),
        comment,
    )


def _unit(signal: str) -> str:
    return UNITS.get(signal[:1], "1")


def of_result(document: Mapping[str, Any], plane: str, part: Part = "plant") -> Linear:
    """A plane of a result.json.

    Parameters
    ----------
    part
        "plant": coil currents to displacements; "amplifiers": control signals to coil currents; "whole": one after
        the other. Hold and delay of the controller are in none of them, nor is the chain of effects that a twin names.

    Raises
    ------
    ExportError
        No such plane or part, or a result whose figures say nothing: no tool that reads the file would tell.
    DocumentError
        The document is not whole.
    """
    document = whole(document, ResultSpaces, "the commissioning result")
    if not is_identified(document):
        raise ExportError(
            f"the rig {document['rig']!r} is not identified, the figures of its model say nothing: it is not exported; "
            "mend what the notes of the result name and identify it once more"
        )
    planes = document["planes"]
    if plane not in planes:
        raise ExportError(f"the result of {document['rig']} has no plane {plane!r}; it has {', '.join(planes)}")
    found = planes[plane]
    plant, amplifiers = (_space(found[k]) for k in ("state_space", "amplifier_state_space"))
    if part == "plant":
        chosen = plant
    elif part == "amplifiers":
        chosen = amplifiers
    elif part == "whole":
        chosen = series(amplifiers, plant)
    else:
        raise ExportError(f"no part {part!r} can be exported; give one of {', '.join(PARTS)}")
    comment = f"identified from {document.get('experiment', '')}"
    if effects := document.get("known_effects"):
        names = ", ".join(str(e["effect"]) for e in effects)
        comment += (
            f"; with effects that the twin names known ({names}): what they put between u and the magnets' flux, or "
            "into the sensors, is in no state of this model"
        )
    return linear(f"{document['rig']} {plane} {part}", chosen, comment)


def _space(document: Mapping[str, Any]) -> StateSpace:
    n, m, p = (len(document[k]) for k in ("states", "inputs", "outputs"))
    return StateSpace(
        matrix(document["A"], n, n),
        matrix(document["B"], n, m),
        matrix(document["C"], p, n),
        matrix(document["D"], p, m),
        tuple(document["states"]),
        tuple(document["inputs"]),
        tuple(document["outputs"]),
    )


def must_be_continuous(name: str, sample_time_s: float) -> None:
    """Refuse the model of a file that was put into discrete time.

    Raises
    ------
    ExportError
        Its sample time is not 0.
    """
    if sample_time_s:
        raise ExportError(f"model {name} is in discrete time ({sample_time_s:g} s); give one in continuous time")


def document(model: Linear) -> dict[str, Any]:
    """As JSON."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": model.name,
        "comment": model.comment,
        "sample_time_s": 0.0,
        "states": list(model.states),
        "inputs": list(model.inputs),
        "outputs": list(model.outputs),
        "input_units": list(model.input_units),
        "output_units": list(model.output_units),
        "A": model.A.tolist(),
        "B": model.B.tolist(),
        "C": model.C.tolist(),
        "D": model.D.tolist(),
    }


def from_document(found: Mapping[str, Any]) -> Linear:
    """The model of a document.

    Raises
    ------
    ExportError
        It is none, not whole, or in discrete time.
    """
    with reading(found, FORMAT, "state space"):
        must_be_continuous(str(found["name"]), found.get("sample_time_s", 0.0))
        names = {k: tuple(str(s) for s in found[k]) for k in ("states", "inputs", "outputs")}
        n, m, p = (len(v) for v in names.values())
        return Linear(
            str(found["name"]),
            matrix(found["A"], n, n),
            matrix(found["B"], n, m),
            matrix(found["C"], p, n),
            matrix(found["D"], p, m),
            names["states"],
            names["inputs"],
            names["outputs"],
            tuple(str(s) for s in found["input_units"]),
            tuple(str(s) for s in found["output_units"]),
            str(found.get("comment", "")),
        )
