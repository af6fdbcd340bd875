"""The structure of a MATLAB v5 file, before anything in it is read: are its parts whole, and what would they unpack to.

Runs in the child process. Source: MathWorks, MAT-File Format, chapter 1 (level 5).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from service.uploads.errors import UploadContentError, UploadSizeError
from service.uploads.limits import MIB, Limits

SIGNATURE = b"MATLAB 5.0 MAT-file"
SIGNATURE_73 = b"MATLAB 7.3 MAT-file"
"""The beginning of a newer file, which is HDF5 behind its header."""
HEADER = 128
MATRIX, COMPRESSED = 14, 15
BEGINNING = 4096
"""Packed bytes that surely hold the first tag, after the code table of the packing."""
TAG = 8


def decoded_bytes(path: Path, limits: Limits) -> int:
    """Bytes that all variables say they unpack to.

    Raises
    ------
    UploadContentError
        A part is cut off, or is no variable.
    UploadSizeError
        More than the limits allow, or packed so tightly that it was made to be large.
    """
    end = path.stat().st_size
    total = 0
    with path.open("rb") as stream:
        header = stream.read(HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        if order is None:
            raise UploadContentError("the MATLAB file is cut off in its header; copy it again from where it was made")
        count = 0
        while (at := stream.tell()) < end:
            count += 1
            if count > limits.objects:
                raise UploadContentError(f"the MATLAB file holds more than {limits.objects} variables")
            tag = stream.read(8)
            kind, size = struct.unpack(f"{order}II", tag) if len(tag) == 8 else (0, end)
            if at + 8 + size > end:
                raise UploadContentError(
                    f"the MATLAB file is cut off: variable {count} needs {size} bytes and {max(0, end - at - 8)} are "
                    "there; copy it again from where it was made"
                )
            if kind not in (MATRIX, COMPRESSED):
                raise UploadContentError(f"variable {count} of the MATLAB file is of type {kind}, which is not read")
            total += (
                _unpacked(stream.read(min(size, BEGINNING)), order, count, size, limits) if kind == COMPRESSED else size
            )
            if total > limits.decoded_bytes:
                raise UploadSizeError(
                    f"the MATLAB file unpacks to {total / MIB:,.0f} MiB or more; "
                    f"at most {limits.decoded_bytes / MIB:,.0f} MiB are read"
                )
            stream.seek(at + 8 + size)
    return total


def _unpacked(packed: bytes, order: str, count: int, size: int, limits: Limits) -> int:
    """What a compressed variable says it unpacks to; a lie costs the reader its limits of memory and time."""
    try:
        begin = zlib.decompressobj().decompress(packed, TAG)
        claimed = int(struct.unpack(f"{order}II", begin)[1])
    except (zlib.error, struct.error) as error:
        raise UploadContentError(
            f"variable {count} of the MATLAB file cannot be unpacked ({error}); copy it again"
        ) from error
    if claimed > limits.ratio_from_bytes and claimed > limits.ratio * max(1, size):
        raise UploadSizeError(
            f"variable {count} of the MATLAB file says that {size} bytes unpack to {claimed / MIB:,.0f} MiB; "
            "measured data do not pack so tightly"
        )
    return claimed
