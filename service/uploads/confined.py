"""An upload, handed to a process of its own, and what came back: never an exception of a library, never a hang."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any

from service.uploads.errors import BY_STATUS, UploadBusyError, UploadContentError, UploadSizeError
from service.uploads.limits import MIB, Limits
from sim.datasheet import Datasheet
from sim.rig_file import to_toml

AT_ONCE = 2
"""Files that are read at the same time: the memory that uploads can take is this times the limit of one."""
WAIT_S = 10.0
ANSWER_BYTES = MIB
COMMAND = (sys.executable, "-m", "service.uploads.child")
_PLACES = threading.BoundedSemaphore(AT_ONCE)
_TOO_LONG = {signal.SIGPROF, signal.SIGXCPU, signal.SIGVTALRM}


@dataclass(frozen=True)
class Parsed:
    """An upload that is an experiment."""

    summary: dict[str, Any]
    """file_format, rig, axes, sweeps."""
    file: Path
    """What was understood, written anew: nothing of the upload's own bytes is left in it."""


def parse(path: Path, name: str, out: Path, limits: Limits | None = None, datasheet: Datasheet | None = None) -> Parsed:
    """Look at an uploaded file and read it, in a process under limits of memory and time.

    Parameters
    ----------
    path
        The file as it was received.
    name
        Its name where it came from; names the experiment where the file itself does not.
    out
        Where to write what was understood, HDF5.
    limits
        What it may cost.
    datasheet
        Of the rig that it is sent to, whose limits tell units that its values cannot have.

    Raises
    ------
    UploadTypeError, UploadSizeError, UploadContentError
        The file is refused; the message says why.
    UploadBusyError
        Others are being read, for longer than a caller should wait.
    """
    limits = limits or Limits()
    size = path.stat().st_size
    if size > limits.file_bytes:
        raise UploadSizeError(
            f"the file has {size / MIB:,.1f} MiB; at most {limits.file_bytes / MIB:,.0f} MiB are taken"
        )
    if not _PLACES.acquire(timeout=WAIT_S):
        raise UploadBusyError("other uploads are being read; try again in a few seconds")
    try:
        with tempfile.TemporaryDirectory(prefix=".upload-", dir=out.parent) as folder:
            return _parse(path, name, out, limits, datasheet, Path(folder))
    finally:
        _PLACES.release()


def _parse(path: Path, name: str, out: Path, limits: Limits, datasheet: Datasheet | None, folder: Path) -> Parsed:
    seen_as = folder / _safe(name)
    seen_as.symlink_to(path.resolve())
    written = folder / "understood.h5.tmp"
    rig = None if datasheet is None else str(_rig_of(datasheet, folder))
    job = {"file": str(seen_as), "out": str(written), "limits": asdict(limits), "rig": rig}
    with (folder / "answer.tmp").open("w+b") as said:
        status = _run(json.dumps(job), said, limits.wall_s + limits.read_seconds(limits.decoded_bytes) / 2)
        said.seek(0)
        text = said.read(ANSWER_BYTES)
    answer = _answer(text) if status == 0 else None
    if answer is None:
        raise _lost(status, limits)
    if "reason" in answer:
        reason = str(answer["reason"]).replace(f"{folder}/", "")
        raise BY_STATUS.get(answer.get("status", 422), UploadContentError)(reason)
    os.replace(written, out)
    return Parsed(answer["summary"], out)


def _rig_of(datasheet: Datasheet, folder: Path) -> Path:
    """A file for the child; effects change no limit, and a catalogue of them takes a second to load."""
    path = folder / "rig.toml"
    path.write_text(to_toml(replace(datasheet, effects=())), encoding="utf-8")
    return path


def _run(job: str, said: IO[bytes], wall_s: float) -> int:
    """Exit status of the child, negative for a signal; it is gone when this returns."""
    child = subprocess.Popen(
        [*COMMAND, job],
        stdin=subprocess.DEVNULL,
        stdout=said,
        stderr=subprocess.DEVNULL,
        env=_environment(),
        start_new_session=True,
    )
    try:
        return child.wait(wall_s)
    except subprocess.TimeoutExpired:
        return -signal.SIGPROF
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()


def _environment() -> dict[str, str]:
    """Nothing of this process's own: no address of a database, no secret."""
    return {
        "PATH": os.defpath,
        "LANG": "C.UTF-8",
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        "PYTHONDONTWRITEBYTECODE": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "HDF5_USE_FILE_LOCKING": "FALSE",
        "HDF5_PLUGIN_PRELOAD": "::",  # no filter is loaded from anywhere
    }


def _answer(text: bytes) -> dict[str, Any] | None:
    try:
        answer = json.loads(text)
    except ValueError:
        return None
    return answer if isinstance(answer, dict) and ("reason" in answer or "summary" in answer) else None


def _lost(status: int, limits: Limits) -> UploadContentError | UploadSizeError:
    """Why there is no answer."""
    if -status in _TOO_LONG:
        return UploadContentError(
            "reading it takes longer than a file of its size may take; send fewer points, or the demodulated form"
        )
    if -status == signal.SIGXFSZ:
        return UploadSizeError(
            f"it unpacks to more than {limits.decoded_bytes / MIB:,.0f} MiB; send the demodulated form"
        )
    return UploadContentError("the file is damaged: reading it ends in a crash; copy it again from where it was made")


def _safe(name: str) -> str:
    """A file name for a folder of its own.

    >>> _safe("../../etc/pass wd.mat"), _safe("")
    ('pass_wd.mat', 'upload')
    """
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    return re.sub(r"[^\w.-]", "_", last, flags=re.ASCII)[-100:].lstrip(".") or "upload"
