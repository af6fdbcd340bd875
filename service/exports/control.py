"""Models as objects of python-control, and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from service.exports.errors import ExportError
from service.exports.linear import Linear, Part, matrix, of_result
from service.identification.result.shape import ResultSpaces
from service.output import read_document


def control_of(result: str | Path, plane: str = "x", part: Part = "plant") -> Any:
    """A plane of a commissioning as a ``control.StateSpace``, from its result.json.

    Parameters
    ----------
    result
        Path of the result.json.
    plane
        Its name there, x or y.
    part
        "plant": from coil currents i_xA, i_xB, A, to displacements y_xA, y_xB, m; "amplifiers": from control signals to
        coil currents; "whole": one after the other. Continuous time; hold and delay of the controller are in none.

    Raises
    ------
    ExportError
        No such plane or part, or a rig that is not identified.
    DocumentError
        The file cannot be read, or is no commissioning result.
    """
    return to_control(of_result(read_document(Path(result), "amb-commissioning-result", ResultSpaces), plane, part))


def to_control(model: Linear) -> Any:
    """A ``control.StateSpace`` with named signals; their units are in its ``params`` under "units"."""
    import control

    # python-control keeps names of signals free of dots: they mark subsystems there
    return control.ss(
        model.A,
        model.B,
        model.C,
        model.D,
        0,  # in continuous time, whatever the user's control.default_dt is
        inputs=list(model.inputs),
        outputs=list(model.outputs),
        states=[s.replace(".", "·") for s in model.states],
        name=model.name.replace(".", "·"),
        params={"units": {"inputs": list(model.input_units), "outputs": list(model.output_units)}},
        remove_useless_states=False,
    )


def from_control(system: Any) -> Linear:
    """The model of a ``control.StateSpace``.

    Raises
    ------
    ExportError
        It is in discrete time.
    """
    if system.dt is not None and system.dt != 0:
        raise ExportError(f"system {system.name} is in discrete time ({system.dt} s); give one in continuous time")
    n, m, p = system.nstates, system.ninputs, system.noutputs
    units = system.params.get("units", {})
    return Linear(
        str(system.name).replace("·", "."),
        matrix(np.asarray(system.A), n, n),
        matrix(np.asarray(system.B), n, m),
        matrix(np.asarray(system.C), p, n),
        matrix(np.asarray(system.D), p, m),
        tuple(s.replace("·", ".") for s in system.state_labels),
        tuple(system.input_labels),
        tuple(system.output_labels),
        tuple(units.get("inputs", ["1"] * m)),
        tuple(units.get("outputs", ["1"] * p)),
    )
