"""Provenance of a diagnosis: digests of datasheet and experiment, and the controller that measured it.

They show whether two diagnoses are of the same data, and whether one is of a rig that was served. They are computed
from the inputs of the diagnosis alone, and so hold nothing of what a blind trial withholds.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from typing import Any

import numpy as np

from service.experiment.data import Experiment, Sweep
from sim.datasheet import Datasheet
from sim.rig_file import to_toml


def origin(experiment: Experiment, datasheet: Datasheet) -> dict[str, str]:
    """The entry "of" of gap.json."""
    return {
        "datasheet_sha256": datasheet_digest(datasheet),
        "experiment_sha256": experiment_digest(experiment),
        "controller": experiment.attributes.get("controller", ""),
    }


def datasheet_digest(datasheet: Datasheet) -> str:
    """SHA-256 of a datasheet's content, however its file was laid out.

    >>> from sim.reference import reference_datasheet
    >>> from sim.rig_file import parse
    >>> sheet = reference_datasheet()
    >>> datasheet_digest(parse(to_toml(sheet))) == datasheet_digest(sheet)
    True
    """
    return hashlib.sha256(to_toml(datasheet).encode()).hexdigest()


def experiment_digest(experiment: Experiment) -> str:
    """SHA-256 of what was measured, whichever format and compression the file has."""
    digest = hashlib.sha256(json.dumps([experiment.rig, experiment.axes]).encode())
    for sweep in experiment.sweeps:
        for field in dataclasses.fields(Sweep):
            digest.update(f"\n{field.name} ".encode())
            digest.update(_bytes(getattr(sweep, field.name)))
    return digest.hexdigest()


def _bytes(value: Any) -> bytes:
    if not isinstance(value, np.ndarray):
        return json.dumps(value).encode()
    # integers of different width, as of an axis in a file and in memory, must not differ
    wide = value.astype(np.complex128 if np.iscomplexobj(value) else np.float64)
    return f"{wide.shape} ".encode() + wide.tobytes()
