"""Models and responses as variables of a MATLAB file, and back: what `scipy.io` saves and loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.exports.errors import ExportError
from service.exports.linear import Linear, matrix, must_be_continuous
from service.exports.responses import Responses


def _cell(texts: Sequence[str]) -> NDArray[np.object_]:
    """Texts as a column cell array."""
    out = np.empty((len(texts), 1), dtype=object)
    for k, text in enumerate(texts):
        out[k, 0] = text
    return out


def _texts(cell: Any) -> tuple[str, ...]:
    """Texts of a cell array as loaded; a text is itself an array of one."""
    found = np.atleast_1d(np.asarray(cell, dtype=object)).ravel()
    return tuple(_string(x) for x in found)


def _string(value: Any) -> str:
    array = np.asarray(value)
    return "" if array.size == 0 else str(array.ravel()[0])


def linear_variables(model: Linear) -> dict[str, Any]:
    """A, B, C, D, cell arrays of names and units; in MATLAB ``ss(A, B, C, D)`` is the system."""
    return {
        "A": model.A,
        "B": model.B,
        "C": model.C,
        "D": model.D,
        "states": _cell(model.states),
        "inputs": _cell(model.inputs),
        "outputs": _cell(model.outputs),
        "input_units": _cell(model.input_units),
        "output_units": _cell(model.output_units),
        "name": model.name,
        "comment": model.comment,
        "sample_time_s": 0.0,
    }


def linear_from_variables(found: Mapping[str, Any]) -> Linear:
    """The model of a loaded MATLAB file.

    Raises
    ------
    ExportError
        A variable is missing or of the wrong size, or the model is in discrete time.
    """
    try:
        states, inputs, outputs = (_texts(found[k]) for k in ("states", "inputs", "outputs"))
        n, m, p = len(states), len(inputs), len(outputs)
        must_be_continuous(_string(found["name"]), float(np.ravel(found.get("sample_time_s", 0.0))[0]))
        return Linear(
            _string(found["name"]),
            matrix(found["A"], n, n),
            matrix(found["B"], n, m),
            matrix(found["C"], p, n),
            matrix(found["D"], p, m),
            states,
            inputs,
            outputs,
            _texts(found["input_units"]),
            _texts(found["output_units"]),
            _string(found.get("comment", "")),
        )
    except KeyError as error:
        raise ExportError(f"the MATLAB file has no variable {error}; it is no state space that ambit wrote") from error


def response_variables(r: Responses) -> dict[str, Any]:
    """``response`` (outputs, inputs, F) as MATLAB's frd has it, frequencies, names and units."""
    out = {
        "frequency_hz": r.frequency_hz[:, None],
        "response": np.moveaxis(r.value, 0, -1),
        "inputs": _cell(r.inputs),
        "outputs": _cell(r.outputs),
        "input_units": _cell(r.input_units),
        "output_units": _cell(r.output_units),
        "name": r.name,
    }
    return out if r.std is None else out | {"response_std": np.moveaxis(r.std, 0, -1)}


def responses_from_variables(found: Mapping[str, Any]) -> Responses:
    """The responses of a loaded MATLAB file.

    Raises
    ------
    ExportError
        A variable is missing or of the wrong size.
    """
    try:
        frequency = np.asarray(found["frequency_hz"], dtype=float).ravel()
        inputs, outputs = _texts(found["inputs"]), _texts(found["outputs"])
        shape = (len(outputs), len(inputs), len(frequency))
        value = np.moveaxis(np.asarray(found["response"], dtype=complex).reshape(shape), -1, 0)
        std = found.get("response_std")
        spread = None if std is None else np.moveaxis(np.asarray(std, dtype=float).reshape(shape), -1, 0)
        return Responses(
            _string(found["name"]),
            frequency,
            value,
            spread,
            inputs,
            outputs,
            _texts(found["input_units"]),
            _texts(found["output_units"]),
        )
    except KeyError as error:
        raise ExportError(f"the MATLAB file has no variable {error}; it is no response that ambit wrote") from error
    except ValueError as error:
        if isinstance(error, ExportError):
            raise
        raise ExportError(f"the MATLAB file's response does not fit its names: {error}") from error
