"""Process data objects to values and back. Pure; groups that travel by SDO are packed by `drivers.packing`."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.controller import TripCause
from drivers.errors import BusError

BEAT_COB = 0x200
STOP_COB = 0x300
PROGRESS_COB = 0x180
EMCY_COB = 0x080
NMT_COB, HEARTBEAT_COB = 0x000, 0x700
NMT_START = 0x01
"""Command of network management (CiA 301, 7.2.8.2): process data go from then on."""
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
"""States that a heartbeat tells; a boot-up message comes before pre-operational."""
_BEAT = struct.Struct("<II")
_STOP = struct.Struct("<I")
_PROGRESS = struct.Struct("<HIH")
_EMCY = struct.Struct("<HB5s")
_EMCY_CODES = {
    TripCause.HOST: 0x8130,
    TripCause.DISPLACEMENT: 0xFF01,
    TripCause.CURRENT: 0x2310,
    TripCause.FAULT: 0x5000,
}


@dataclass(frozen=True)
class Progress:
    """What TPDO 1 tells: in the order of the status group."""

    state: int
    command: int
    outcome: int


def beat_bytes(token: int, count: int) -> bytes:
    """RPDO 1.

    >>> beat_of(beat_bytes(7, 9))
    (7, 9)
    """
    return _BEAT.pack(token, count)


def beat_of(raw: bytes) -> tuple[int, int]:
    """Token and count of RPDO 1."""
    token, count = _unpacked(_BEAT, raw)
    return int(token), int(count)


def stop_bytes(token: int) -> bytes:
    """RPDO 2."""
    return _STOP.pack(token)


def stop_of(raw: bytes) -> int:
    """Token of RPDO 2; a frame too short to hold one is a stop all the same, of nobody."""
    return int(_STOP.unpack_from(raw)[0]) if len(raw) >= _STOP.size else 0


def progress_bytes(progress: Progress) -> bytes:
    """TPDO 1."""
    return _PROGRESS.pack(progress.state, progress.command, progress.outcome)


def progress_of(raw: bytes) -> Progress:
    """What TPDO 1 tells."""
    return Progress(*_unpacked(_PROGRESS, raw))


def emergency_bytes(cause: TripCause) -> bytes:
    """EMCY of a trip; no error once it is acknowledged."""
    return _EMCY.pack(_EMCY_CODES.get(cause, 0), 0 if cause is TripCause.NONE else 1, bytes(5))


def _unpacked(form: struct.Struct, raw: bytes) -> tuple[int, ...]:
    if len(raw) != form.size:
        raise BusError(f"a process data object has {len(raw)} bytes instead of {form.size}")
    return form.unpack(raw)
