"""The arrays of an experiment in MATLAB files: v5 (scipy) and v7.3 (HDF5 in MATLAB's own conventions).

MATLAB has no attributes, so all are fields of the same names: at the top ``format, version, rig, axes`` (a JSON
list or a cell of names), and ``sweeps``, a struct array, a cell of structs, or a struct of structs (s0, s1, ...)
whose fields are the datasets and attributes of the contract. A file of one sweep may have its fields at the top.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from service.experiment.contract import FORMAT, VERSION

ATTRIBUTES = ("kind", "speed_rad_s", "sample_rate_hz", "comment")
VECTORS = (
    *("frequency_hz", "axis", "amplitude_a", "harmonics", "sample_start", "block_samples", "time_s"),
    *("point_speed_rad_s", "kurtosis"),
)
RANK = {"R": 4, "U": 4, "I": 4, "Y": 4, "r": 2, "u": 2, "i": 2, "y": 2}
DEFAULTS: dict[str, Any] = {"kind": "stepped-sine", "speed_rad_s": 0.0, "comment": ""}
DEFAULT_AXES = {2: '["xA", "xB"]', 4: '["xA", "xB", "yA", "yB"]'}


class DamagedError(Exception):
    """A file that begins as MATLAB's cannot be read."""


def version_5(path: Path) -> dict[str, Any]:
    """Tree of a v5 file, for `service.experiment.file`.

    Raises
    ------
    DamagedError
        The file is not complete.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, simplify_cells=True, chars_as_strings=True)
    except (MatReadError, ValueError, TypeError, IndexError) as error:
        raise DamagedError(f"not a complete MATLAB v5 file: {error}") from error
    return _tree(path.stem, {k: v for k, v in content.items() if not k.startswith("__")})


def version_73(file: Any) -> dict[str, Any]:
    """Tree of an open v7.3 file, for `service.experiment.file`."""
    content = _attributes(file) | {k: _value(file, v) for k, v in file.items() if not k.startswith("#")}
    return _tree(Path(file.filename).stem, content)


def made_by_matlab(file: Any) -> bool:
    """Whether an HDF5 file without MATLAB's header still follows its conventions."""
    return any("MATLAB_class" in node.attrs for node in file.values())


def _tree(name: str, content: Mapping[str, Any]) -> dict[str, Any]:
    raw = content.get("sweeps", content if "frequency_hz" in content else {})
    if isinstance(raw, Mapping) and "frequency_hz" in raw:
        members: dict[str, Any] = {"0": raw}
    elif isinstance(raw, Mapping):
        members = {str(k): v for k, v in raw.items() if isinstance(v, Mapping)}
    else:
        members = {str(k): v for k, v in enumerate(np.atleast_1d(np.asarray(raw, dtype=object)).ravel())}
    sweeps = {k: _sweep(v) for k, v in members.items() if isinstance(v, Mapping)}
    attributes: dict[str, Any] = {"format": FORMAT, "version": VERSION, "rig": name}
    attributes |= {k: content[k] for k in ("format", "version", "rig", "axes") if k in content}
    if "axes" not in attributes:
        last = {v.shape[-1] for d, _ in sweeps.values() for k, v in d.items() if k in RANK}
        if len(last) == 1 and (n := last.pop()) in DEFAULT_AXES:
            attributes["axes"] = DEFAULT_AXES[n]
    elif isinstance(attributes["axes"], list | tuple):
        attributes["axes"] = np.array(attributes["axes"], dtype=object)
    return {"attributes": attributes, "sweeps": sweeps}


def _sweep(fields: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    attributes = DEFAULTS | {k: fields[k] for k in ATTRIBUTES if k in fields}
    # an empty char array reads as an empty numeric array
    attributes = {k: "" if np.size(v) == 0 and not isinstance(v, str) else v for k, v in attributes.items()}
    datasets: dict[str, Any] = {}
    for key, value in fields.items():
        if key in ATTRIBUTES:
            continue
        array = np.asarray(value)
        if key in VECTORS:
            array = array.ravel()
        elif key in RANK and array.ndim < RANK[key]:
            array = _with_lost_dimensions(array, RANK[key], np.size(fields.get("frequency_hz", [])), fields)
        if key in RANK and array.ndim == RANK[key]:
            array = _points_first(array, np.size(fields.get("frequency_hz", [])))
        datasets[key] = array
    return datasets, attributes


def _points_first(array: Any, n_points: int) -> Any:
    """An array whose dimensions came in MATLAB's order, turned so that points, or samples, come first."""
    if array.ndim == 4:
        return array.T if array.shape[0] != n_points and array.shape[3] == n_points else array
    return array.T if array.shape[0] < array.shape[1] else array


def _with_lost_dimensions(array: Any, rank: int, n_points: int, fields: Mapping[str, Any]) -> Any:
    """A simplified array with the dimensions of length one put back where the contract has them."""
    if rank == 4 and array.ndim == 3:
        harmonics = np.size(fields.get("harmonics", []))
        position = 0 if n_points == 1 else 2 if harmonics == 1 else 1
        return np.expand_dims(array, position)
    return array


def _attributes(node: Any) -> dict[str, Any]:
    """Attributes of a group that MATLAB itself did not put there, for files that other programs laid out."""
    return {k: v for k, v in node.attrs.items() if not k.startswith(("MATLAB", "H5"))}


def _value(file: Any, node: Any) -> Any:
    """One MATLAB variable of a v7.3 file: struct, struct array, cell, char or numbers, dimensions turned back."""
    if isinstance(node, h5py.Group):
        fields = dict(node.items())
        references = [isinstance(v, h5py.Dataset) and v.dtype == h5py.ref_dtype for v in fields.values()]
        classes = [v.attrs.get("MATLAB_class", b"") for v in fields.values()]
        if fields and all(references) and all(c != b"cell" for c in classes):
            columns = {k: [_value(file, file[r]) for r in np.ravel(v[()])] for k, v in fields.items()}
            return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return _attributes(node) | {k: _value(file, v) for k, v in fields.items()}
    raw = node[()]
    if node.dtype == h5py.ref_dtype:
        return [_value(file, file[r]) for r in np.ravel(raw)]
    kind = node.attrs.get("MATLAB_class", b"")
    if node.attrs.get("MATLAB_empty", 0):
        return "" if kind == b"char" else np.zeros(0)
    if kind == b"char" or (isinstance(raw, np.ndarray) and raw.dtype == np.uint16 and kind == b""):
        return "".join(chr(c) for c in np.ravel(raw))
    if isinstance(raw, bytes | str):
        return raw
    if raw.dtype.names and set(raw.dtype.names) == {"real", "imag"}:
        raw = raw["real"] + 1j * raw["imag"]
    value = raw.T if isinstance(raw, np.ndarray) and kind != b"" else raw
    return value.ravel()[0] if isinstance(value, np.ndarray) and value.size == 1 else value
