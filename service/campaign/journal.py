"""The campaign's journal: one line for every finished measurement, on disk before the next one begins.

An append-only text file. Every line is ``crc32 in hexadecimal, a space, one JSON object``; the first object is the
header, the others are entries. Arrays are ``{"dtype", "shape", "base64"}`` of little-endian bytes. A line whose
check sum does not match, or that has no end, was being written when the power went: it is cut off, and all lines
before it are good. See docs/decisions.
"""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.campaign.difference import difference
from service.campaign.platter import Platter
from service.experiment.errors import ExperimentFileError, JournalError
from sim.errors import reason

FORMAT = "amb-campaign-journal"
VERSION = 1
BEGAN = "began_at"
"""When the campaign began, ISO 8601 with its offset to UTC; in a header, under "about"."""
ANEW = "choose another folder, or start anew with ambit commission --no-resume"
"""What there is to do about a journal that a commissioning cannot go on with."""
ALIKE = 1e-6
"""Relative difference of two numbers that are one setting: a plan made by calculation, as that of a health check, has
other last digits on another processor."""

Entry = dict[str, Any]


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
        return {
            "dtype": little.dtype.str,
            "shape": list(little.shape),
            "base64": base64.b64encode(little.tobytes()).decode("ascii"),
        }
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a journal holds no {type(value).__name__}")


def _decoded(value: dict[str, Any]) -> Any:
    if value.keys() == {"dtype", "shape", "base64"}:
        flat: NDArray[Any] = np.frombuffer(base64.b64decode(value["base64"]), dtype=value["dtype"])
        return flat.reshape(value["shape"]).copy()
    return value


def line(entry: Entry) -> bytes:
    r"""One line of a journal.

    >>> line({"phase": "main"})
    b'6952a777 {"phase":"main"}\n'
    """
    text = json.dumps(entry, default=_encoded, separators=(",", ":"), allow_nan=False).encode("ascii")
    return b"%08x %s\n" % (zlib.crc32(text), text)


def entries(content: bytes) -> tuple[list[Entry], int]:
    """Entries of a journal's bytes, and how many bytes are good.

    Reading ends at the first line that is incomplete or does not match its check sum.
    """
    found: list[Entry] = []
    good = 0
    while (end := content.find(b"\n", good)) >= 0:
        check, _, text = content[good:end].partition(b" ")
        if len(check) != 8 or check != b"%08x" % zlib.crc32(text):
            break
        try:
            found.append(json.loads(text, object_hook=_decoded))
        except ValueError:
            break
        good = end + 1
    return found, good


def read(path: Path) -> tuple[Entry, list[Entry]]:
    """Header and entries of a journal; what a crash left unfinished at its end is passed over.

    Raises
    ------
    JournalError
        Not a journal, or one of another version.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise JournalError(f"cannot read the journal {path}: {reason(error)}") from error
    found, _ = entries(content)
    if not found or found[0].get("format") != FORMAT or found[0].get("version") != VERSION:
        raise JournalError(f"{path} is not a campaign journal of version {VERSION}; move it away to start anew")
    return found[0], found[1:]


def began(path: Path) -> datetime | None:
    """When the campaign of a journal began; None where it does not tell.

    Raises
    ------
    JournalError
        As of `read`.
    """
    told = read(path)[0].get("about", {}).get(BEGAN)
    return None if told is None else datetime.fromisoformat(told)


class Journal:
    """A journal that is open for appending.

    Parameters
    ----------
    path
        The file. It is made with ``header`` when it does not exist, or holds not even a whole header.
    header
        What the campaign is; an existing journal must have the same, but for the last digits of numbers and for what
        is under "about".
    anew
        What there is to do about an existing journal of another campaign, as an error tells it.

    Raises
    ------
    JournalError
        The journal belongs to another rig or plan.
    ExperimentFileError
        The folder cannot be written.
    """

    def __init__(self, path: Path, header: Entry, anew: str = ANEW) -> None:
        self.path, self._anew = path, anew
        header = {"format": FORMAT, "version": VERSION, **header}
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise ExperimentFileError(f"cannot write {path}: {reason(error)}; choose another folder") from error
        self.count = 0
        """Entries that it holds."""
        self.header: Entry = {}
        """As the file has it: of the run that began it, where this one goes on."""
        self._platter = Platter(self._descriptor)
        try:
            self.found = self._recover(header)
            self.count = len(self.found)
        except BaseException:
            self.close()
            raise

    def _recover(self, header: Entry) -> list[Entry]:
        content = self.path.read_bytes()
        found, good = entries(content)
        if not found and b"\n" in content:
            raise JournalError(f"{self.path} is not a campaign journal; move it away to start anew")
        wanted = json.loads(json.dumps(header, default=_encoded))
        if found and not _alike(_compared(found[0]), _compared(wanted)):
            raise JournalError(
                f"{self.path} belongs to another campaign: {difference(found[0], wanted)}; to go on with it, give what "
                f"it had; otherwise {self._anew}"
            )
        os.ftruncate(self._descriptor, good)
        os.lseek(self._descriptor, good, os.SEEK_SET)
        if not found:
            self.append(header)
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        self.header = found[0] if found else wanted
        return found[1:]

    def append(self, entry: Entry) -> None:
        """Add an entry.

        When this returns the entry survives the end of this process, however sudden. It is being forced to the
        disk's platter while the rig measures the next point, and is there before the next entry is written: a power
        failure can cost one point.
        """
        data = memoryview(line(entry))
        try:
            self._platter.wait()
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError as error:
            raise ExperimentFileError(f"cannot write {self.path}: {reason(error)}; free space and resume") from error
        self.count += 1
        self._platter.force()

    def close(self) -> None:
        """Close the file; it stays on disk. Safe twice."""
        if self._descriptor < 0:
            return
        with suppress(OSError):
            self._platter.wait()
        self._platter.close()
        os.close(self._descriptor)
        self._descriptor = -1


def _compared(header: Entry) -> Entry:
    return {k: v for k, v in header.items() if k != "about"}


def _alike(one: Any, other: Any) -> bool:
    """Whether two settings are the same but for the last digits of a processor."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[name], other[name]) for name in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=ALIKE)
    return bool(one == other)
