"""The process that reads an upload: it limits itself, looks, reads, writes what it understood, and says so.

``python -m service.uploads.child JOB`` where JOB is JSON: file, out, limits, rig. One line of JSON on stdout:
``{"summary": ...}`` or ``{"status": 422, "reason": ...}``. Anything else, or a signal, means that the file won.
"""

from __future__ import annotations

import json
import resource
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py

from service.uploads import hdf5, matlab5
from service.uploads.errors import UploadContentError, UploadError, UploadSizeError, UploadTypeError
from service.uploads.limits import MIB, Limits

if TYPE_CHECKING:
    from service.experiment.data import Experiment, Sweep

TEXT = 200
"""Characters of a text of the file that a summary repeats."""
OPEN_FILES = 64


def confine(limits: Limits) -> None:
    """Limit memory, files and processor time of this process for good."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _has_proc() else 0
    bounds = {
        resource.RLIMIT_AS: used + limits.memory_bytes,
        resource.RLIMIT_FSIZE: 2 * limits.decoded_bytes,
        resource.RLIMIT_NOFILE: OPEN_FILES,
        resource.RLIMIT_CORE: 0,
    }
    for what, bound in bounds.items():
        hard = resource.getrlimit(what)[1]
        least = bound if hard == resource.RLIM_INFINITY else min(bound, hard)
        resource.setrlimit(what, (least, least))
    cpu_seconds(limits.check_cpu_s)


def cpu_seconds(seconds: float) -> None:
    """Let SIGPROF end this process after so much more processor time; 0 for never."""
    signal.setitimer(signal.ITIMER_PROF, seconds)


def look(path: Path, limits: Limits) -> tuple[str, int]:
    """Format of a file, and the bytes it would unpack to, without reading its data.

    Raises
    ------
    UploadError
        As `hdf5.decoded_bytes` and `matlab5.decoded_bytes`; another type; larger than the limits.
    """
    size = path.stat().st_size
    if size > limits.file_bytes:
        raise UploadSizeError(
            f"the file has {size / MIB:,.1f} MiB; at most {limits.file_bytes / MIB:,.0f} MiB are read"
        )
    with path.open("rb") as stream:
        head = stream.read(len(matlab5.SIGNATURE))
    if head == matlab5.SIGNATURE:
        return "MATLAB 5", matlab5.decoded_bytes(path, limits)
    if not h5py.is_hdf5(path):
        raise UploadTypeError(
            "this is neither an HDF5 nor a MATLAB file, or its start is cut off; send an experiment file"
        )
    try:
        with h5py.File(path, "r") as opened:
            return ("MATLAB 7.3" if head == matlab5.SIGNATURE_73 else "HDF5"), hdf5.decoded_bytes(opened, limits)
    except UploadError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise UploadContentError(
            f"the file is truncated or damaged ({_first_line(error)}); copy it again from where it was made"
        ) from error


def understood(path: Path, limits: Limits, out: Path, rig: Path | None = None) -> dict[str, Any]:
    """Summary of an experiment file; what was understood of it is written to ``out``, as this product writes it.

    ``rig`` is the datasheet of the rig that it is of: values that only another unit makes are refused by its limits.

    Raises
    ------
    UploadError
        The file is refused.
    """
    kind, decoded = look(path, limits)
    cpu_seconds(0)
    # only now what reads: most hostile files are refused by their structure, in half the time
    from service.experiment import file
    from service.experiment.errors import ExperimentFileError, ExperimentSizeError
    from service.experiment.units import must_be_in_si
    from sim import rig_file

    datasheet = None if rig is None else rig_file.read(rig)
    if kind == "MATLAB 5":
        import scipy.io.matlab  # noqa: F401  the reader's own loading is no fault of the file

    cpu_seconds(limits.read_seconds(decoded))
    try:
        experiment = file.read(path)
        if datasheet is not None and experiment.axes == datasheet.axes:  # that it is another rig's is told first
            must_be_in_si(experiment, datasheet)
        file.write(out, experiment)
    except (ExperimentSizeError, MemoryError) as error:
        raise UploadSizeError(f"reading it needs more than {limits.memory_bytes / MIB:,.0f} MiB of memory") from error
    except ExperimentFileError as error:
        raise UploadContentError(_line(str(error))) from error
    except Exception as error:  # whatever a file provokes in a reader is the file's fault here
        raise UploadContentError(
            f"it cannot be read as an experiment ({type(error).__name__}: {_first_line(error)}); "
            "write it as docs/experiment-file.md says"
        ) from error
    return summary(kind, experiment)


def summary(kind: str, experiment: Experiment) -> dict[str, Any]:
    """What an experiment holds, as JSON."""
    from service.experiment.incomplete import INCOMPLETE

    why = experiment.attributes.get(INCOMPLETE)
    return {
        "file_format": kind,
        "rig": _line(experiment.rig),
        "axes": [_line(a) for a in experiment.axes],
        "sweeps": [_sweep(s) for s in experiment.sweeps],
        "incomplete": None if why is None else _line(str(why)),
    }


def _sweep(s: Sweep) -> dict[str, Any]:
    return {
        "kind": s.kind,
        "comment": _line(s.comment),
        "points": s.n_points,
        "from_hz": float(s.frequency_hz.min()),
        "to_hz": float(s.frequency_hz.max()),
        "blocks": int(s.R.shape[1]),
        "harmonics": list(map(int, s.harmonics)),
        "speed_rad_s": s.speed_rad_s,
        "sample_rate_hz": s.sample_rate_hz,
        "coil_current": s.I is not None,
    }


def _line(text: str) -> str:
    r"""Text of the file as one short line that any database and terminal takes.

    >>> _line("a\x00\x1b[2J\ud800")
    'a??[2J?'
    """
    text = " ".join(text[: 4 * TEXT].split())
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean if len(clean) <= 2 * TEXT else clean[: 2 * TEXT - 1] + "…"


def _first_line(error: BaseException) -> str:
    return _line(str(error).splitlines()[0]) if str(error) else type(error).__name__


def answer(job: Mapping[str, Any]) -> dict[str, Any]:
    """What the child says of its job."""
    limits = Limits(**job["limits"])
    confine(limits)
    try:
        rig = job.get("rig")
        return {"summary": understood(Path(job["file"]), limits, Path(job["out"]), Path(rig) if rig else None)}
    except UploadError as error:
        return {"status": error.status, "reason": str(error)}


def _has_proc() -> bool:
    return Path("/proc/self/statm").exists()


if __name__ == "__main__":
    json.dump(answer(json.loads(sys.argv[1])), sys.stdout)
