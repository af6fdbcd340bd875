"""Experiment files: HDF5 in both forms of the contract, and the same arrays in MATLAB files.

`read` takes whatever the contract allows and refuses the rest with one line; `write` puts a whole experiment in
place at once, so that a reader sees the old file or the new one and never half of one.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from service.experiment import contract, matlab
from service.experiment.data import Experiment, Sweep
from service.experiment.errors import ExperimentFileError, ExperimentSizeError
from sim.errors import reason

MATLAB_5 = b"MATLAB 5.0 MAT-file"
MATLAB_73 = b"MATLAB 7.3 MAT-file"


def read(path: Path | str) -> Experiment:
    """Read an experiment from HDF5 (records or demodulated) or from MATLAB v5 or v7.3.

    Raises
    ------
    ExperimentFileError
        One line that names the file, the dataset, what is wrong with it and what to do.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(len(MATLAB_5))
            if head == MATLAB_5:
                return _from_tree(path, matlab.version_5(path))
        if not h5py.is_hdf5(path):
            raise ExperimentFileError(
                f"{path} is no HDF5 or MATLAB file, or its start is cut off; copy it again from the controller"
            )
        with h5py.File(path, "r") as file:
            if head == MATLAB_73 or ("format" not in file.attrs and "sweeps" in file and matlab.made_by_matlab(file)):
                return _from_tree(path, matlab.version_73(file))
            return _from_tree(path, _hdf5_tree(path, file))
    except FileNotFoundError as error:
        remedy = "give the path of an experiment file"
        if path.with_suffix(".journal").exists():
            remedy = "an interrupted campaign lies beside it: resume that"
        raise ExperimentFileError(f"{path} does not exist; {remedy}") from error
    except MemoryError as error:
        raise ExperimentSizeError(
            f"{path} states to hold more than this machine's memory ({reason(error)}): it may be damaged; copy it "
            "again from where it was made, or log fewer samples"
        ) from error
    except (OSError, RuntimeError, KeyError, EOFError, UnicodeDecodeError, matlab.DamagedError) as error:
        why = reason(error)
        raise ExperimentFileError(
            f"{path} cannot be read, it may be truncated or damaged ({why}); copy it again from where it was made"
        ) from error


def _hdf5_tree(path: Path, file: Any) -> dict[str, Any]:
    """Attributes and datasets of an HDF5 file as plain dictionaries."""
    if "format" not in file.attrs:
        raise ExperimentFileError(
            f'{path}: attribute format is missing; it must be "{contract.FORMAT}": is it another file?'
        )
    tree: dict[str, Any] = {"attributes": dict(file.attrs), "sweeps": {}}
    if "sweeps" not in file or not isinstance(file["sweeps"], h5py.Group):
        raise ExperimentFileError(f"{path}: the group /sweeps is missing; an experiment has at least /sweeps/0")
    for name, group in file["sweeps"].items():
        if not isinstance(group, h5py.Group):
            raise ExperimentFileError(f"{path}: /sweeps/{name} is a dataset; it must be a group, one for each sweep")
        datasets = {}
        for key, node in group.items():
            if node is None:  # a name that is damaged, or a link to what is gone
                raise ExperimentFileError(
                    f"{path}: /sweeps/{name} lists {key!r}, which is not there, the file is damaged; copy it again"
                )
            if not isinstance(node, h5py.Dataset):
                continue
            try:
                datasets[key] = node[()]
            except (OSError, RuntimeError) as error:
                raise ExperimentFileError(
                    f"{path}: /sweeps/{name}/{key} cannot be read, the file is truncated or damaged; copy it again"
                ) from error
        tree["sweeps"][name] = (datasets, dict(group.attrs))
    return tree


def _from_tree(path: Path, tree: Mapping[str, Any]) -> Experiment:
    attributes = tree["attributes"]
    for name in ("format", "version", "rig", "axes"):
        if name not in attributes:
            raise ExperimentFileError(f"{path}: attribute {name} is missing; add it as docs/experiment-file.md says")
    contract.format_and_version(str(path), attributes["format"], attributes["version"])
    axes = _axes(path, attributes["axes"])
    if not tree["sweeps"]:
        raise ExperimentFileError(f"{path}: /sweeps holds no sweep; an experiment has at least /sweeps/0")
    sweeps = [
        contract.sweep(f"{path}: /sweeps/{name}", datasets, own, len(axes))
        for name, (datasets, own) in sorted(tree["sweeps"].items(), key=lambda kv: _order(kv[0]))
    ]
    if all(s.kind == "noise" for s in sweeps):
        raise ExperimentFileError(f"{path}: /sweeps holds no excited sweep; there is nothing to identify from")
    known = {"format", "version", "rig", "axes"}
    return Experiment(
        rig=contract.text(attributes["rig"]),
        axes=axes,
        sweeps=tuple(sweeps),
        attributes={k: contract.text(v) for k, v in attributes.items() if k not in known},
    )


def _order(name: str) -> tuple[int, str, str]:
    """10 after 9; as text, since not all that Unicode has for digits, nor thousands of them, are a number to Python."""
    digits = "".join(c for c in name if c in "0123456789").lstrip("0")
    return (len(digits), digits, name)


def _axes(path: Path, value: Any) -> tuple[str, ...]:
    """Axes from a JSON list, or from an array of names."""
    try:
        names: Any
        if isinstance(value, np.ndarray) and value.size > 1:
            names = [contract.text(v) for v in value.ravel()]
        else:
            names = json.loads(contract.text(value))
    except json.JSONDecodeError:
        names = None
    if not isinstance(names, list) or not names or not all(isinstance(n, str) and n for n in names):
        raise ExperimentFileError(
            f'{path}: attribute axes is {contract.text(value)!r}; it must be a JSON list such as ["xA", "xB"]'
        )
    if len(set(names)) != len(names):
        raise ExperimentFileError(f"{path}: attribute axes names an axis twice: {', '.join(names)}")
    return tuple(names)


def write(path: Path, experiment: Experiment) -> None:
    """Write an experiment, demodulated form, in one piece: a temporary file that takes the place of ``path``.

    Raises
    ------
    ExperimentFileError
        The folder cannot be written.
    """
    path = Path(path)
    content = _hdf5(experiment)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            stream.write(content.getbuffer())
        _to_disk(temporary)
        os.replace(temporary, path)
        _to_disk(path.parent)
    except OSError as error:
        raise ExperimentFileError(
            f"cannot write {path}: {reason(error)}; free space or choose another folder"
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _hdf5(experiment: Experiment) -> io.BytesIO:
    """An experiment as HDF5 in memory: the library does not survive a disk that is full when it closes a file."""
    content = io.BytesIO()
    with h5py.File(content, "w", libver="v110") as file:  # check sums on all that describes the data
        file.attrs.update(
            format=contract.FORMAT,
            version=contract.VERSION,
            rig=experiment.rig,
            axes=json.dumps(list(experiment.axes)),
        )
        file.attrs.update(experiment.attributes)
        for k, sweep in enumerate(experiment.sweeps):
            _write_sweep(file.create_group(f"sweeps/{k}"), sweep)
    return content


def _write_sweep(group: Any, sweep: Sweep) -> None:
    group.attrs.update(
        kind=sweep.kind, speed_rad_s=sweep.speed_rad_s, sample_rate_hz=sweep.sample_rate_hz, comment=sweep.comment
    )
    group["frequency_hz"] = sweep.frequency_hz
    group["axis"] = sweep.axis.astype(np.int8)
    group["amplitude_a"] = sweep.amplitude_a
    group["harmonics"] = np.array(sweep.harmonics, dtype=np.int8)
    if sweep.block_samples is not None:
        group["block_samples"] = sweep.block_samples
    if sweep.time_s is not None:
        group["time_s"] = sweep.time_s
    if sweep.point_speed_rad_s is not None:
        group["point_speed_rad_s"] = sweep.point_speed_rad_s
    if sweep.kurtosis is not None:
        group["kurtosis"] = sweep.kurtosis
    if sweep.phase_rad is not None:
        group["phase_rad"] = sweep.phase_rad
    if sweep.flags:
        group.create_dataset("flags", data=list(sweep.flags), dtype=h5py.string_dtype())
    for name in ("R", "U", "I", "Y"):
        value = getattr(sweep, name)
        if value is not None:
            group.create_dataset(
                name, data=value, compression="gzip", compression_opts=1, shuffle=True, fletcher32=True
            )


def _to_disk(path: Path) -> None:
    """Make a file, or the names in a folder, survive a power failure."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
