"""The controller's objects, once: name, type, unit, scale, limits, access. Maps, EDS, codecs and documentation follow.

Objects come in groups. A group is read as one snapshot, or written as one command, and ends with a CRC-32 over
the others (big-endian, in order), for Modbus TCP has none of its own and a command must not act on a flipped bit.

==============  ======  ===================================================================================
group           access  what for
==============  ======  ===================================================================================
identity        ro      who the controller is and what it allows
status          ro      state, trip, excitation, lease, progress of the last command
trip            ro      why a trip latched, in words
result          ro      header of the last finished tone; its payload is read from the data area
lease           wo      take the lease (idempotent under one token)
release         wo      give it back
beat            wo      heartbeat: the counter must move
stop            wo      ramp the excitation to zero; any token, and none, will do. The holder hears of others' stops
acknowledge     wo      clear a latched trip
tone            wo      play a tone (idempotent under one command number)
window          wo      choose which part of a raw record the data area shows
==============  ======  ===================================================================================
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Literal

PROTOCOL_VERSION = 1
MAX_AXES = 4
MAX_BLOCKS = 64
"""Of one tone."""
Access = Literal["ro", "wo"]


class Type(enum.Enum):
    """Type on the wire: struct letter, and the name that CANopen gives it."""

    U16 = ("H", "UNSIGNED16")
    U32 = ("I", "UNSIGNED32")
    I32 = ("i", "INTEGER32")
    F32 = ("f", "REAL32")
    F64 = ("d", "REAL64")
    TEXT = ("s", "VISIBLE_STRING")

    @property
    def letter(self) -> str:
        """Letter of this type for `struct`."""
        return self.value[0]


@dataclass(frozen=True)
class Object:
    """One object of the controller."""

    name: str
    type: Type
    description: str
    unit: str = ""
    per_unit: int = 1
    """Counts on the wire per SI unit."""
    low: float | None = None
    """Least value, SI; None for what the type holds."""
    high: float | None = None
    count: int = 1
    """Number of values, or of bytes of a text (even)."""
    required: bool = True
    """Whether a rig's own map must have it."""
    wraps: bool = False
    """Whether it counts on from zero beyond what its type holds."""

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self.count if self.type is Type.TEXT else self.count * {"H": 2, "d": 8}.get(self.type.letter, 4)


@dataclass(frozen=True)
class Group:
    """Objects that are read or written together. ``index`` is the group's place in every generated map."""

    name: str
    index: int
    access: Access
    description: str
    objects: tuple[Object, ...]

    def __getitem__(self, name: str) -> Object:
        return next(o for o in self.objects if o.name == name)

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return sum(o.size for o in self.objects)


CRC = Object("crc", Type.U32, "CRC-32 over the group's other objects, big-endian, in order", required=False)


def _u16(
    name: str, description: str, low: float | None = None, high: float | None = None, required: bool = True
) -> Object:
    return Object(name, Type.U16, description, low=low, high=high, required=required)


def _u32(name: str, description: str, required: bool = True) -> Object:
    return Object(name, Type.U32, description, required=required)


def _scaled(name: str, description: str, unit: str, per_unit: int, required: bool = True) -> Object:
    return Object(name, Type.U32, description, unit, per_unit, low=0, required=required)


_TOKEN = _u32("token", "token of the lease; the host draws it, 1 to 2^32 - 1")
_TONE = (
    _u16("axis", "excited axis", 0, MAX_AXES - 1),
    _scaled("amplitude_a", "amplitude of the excitation", "A", 1_000_000),
    _u32("periods", "periods in a block"),
    _u32("samples", "samples in a block"),
    _u16("blocks", "consecutive blocks", 1, MAX_BLOCKS),
    _u32("settle_samples", "samples to wait after the ramp"),
    _u16("raw", "1: keep the raw record too", 0, 1, required=False),
)

IDENTITY = Group(
    "identity", 0, "ro", "who the controller is and what it allows",
    (
        _u16("protocol", "version of this list", required=False),
        _u32("boot_id", "drawn anew at every start", required=False),
        Object("identity", Type.TEXT, "maker, type, name", count=48, required=False),
        _u16("axis_count", "number of axes", 1, MAX_AXES),
        Object("axes", Type.TEXT, "names of the axes, separated by spaces", count=24),
        Object("sample_rate_hz", Type.F64, "sample rate of the controller", "Hz"),
        _scaled("max_amplitude_a", "largest amplitude of the excitation", "A", 1_000_000),
        _scaled("max_frequency_hz", "highest frequency of a tone", "Hz", 1000),
        _u32("max_samples", "most samples of settling and blocks of one tone"),
        _scaled("displacement_limit_m", "displacement that trips", "m", 1_000_000_000),
        _scaled("current_limit_a", "coil current that trips", "A", 1_000_000),
        _u16("raw_records", "1: raw records can be read", 0, 1),
        _scaled("watchdog_s", "silence of the host that trips", "s", 1000, required=False),
        CRC,
    ),
)  # fmt: skip
STATUS = Group(
    "status", 1, "ro", "snapshot; reading it moves nothing and feeds no watchdog",
    (
        Object(
            "snapshot", Type.U32, "counts every reading, so that a stale answer shows", required=False, wraps=True
        ),
        _u32("boot_id", "drawn anew at every start", required=False),
        _u16("state", "0 off, 1 levitated, 2 armed, 3 settling, 4 recording, 5 done, 6 tripped", 0, 6),
        _u16("trip", "0 none, 1 host, 2 displacement, 3 current, 4 fault", 0, 4),
        _scaled("excitation_a", "amplitude of the excitation now", "A", 1_000_000),
        _scaled("lease_seconds_left", "time left of the lease", "s", 1000, required=False),
        _u32("command", "number of the tone that was accepted last"),
        _u16("outcome", "of that tone: 0 under way, 1 done, 2 stopped, 3 tripped, 4 failed, 5 stopped by others", 0, 5),
        _u32("result", "number of the last result"),
        Object("speed_rad_s", Type.F32, "rotational speed, positive from x to y", "rad/s", required=False),
        Object("uptime_s", Type.U32, "time since the start", "s", 1000, low=0, required=False, wraps=True),
        Object("displacement_m", Type.I32, "displacement of each axis", "m", 1_000_000_000, count=MAX_AXES),
        Object("current_a", Type.I32, "coil current of each axis", "A", 1_000_000, count=MAX_AXES),
        Object("lease_holder", Type.TEXT, "holder of the lease, empty when free", count=32, required=False),
        CRC,
    ),
)  # fmt: skip
TRIP = Group(
    "trip", 2, "ro", "why a trip latched, in words",
    (
        _u32("boot_id", "drawn anew at every start", required=False),
        _u16("cause", "as status.trip", 0, 4),
        Object("message", Type.TEXT, "one line, UTF-8", count=208, required=False),
        CRC,
    ),
)  # fmt: skip
RESULT = Group(
    "result", 3, "ro", "header of the last finished tone",
    (
        _u32("boot_id", "drawn anew at every start", required=False),
        _u32("result", "number of this result; it never changes under its number"),
        _u32("command", "number of the tone that gave it"),
        *_TONE,
        Object("peak_displacement_m", Type.F32, "largest displacement while the tone was on", "m"),
        Object("peak_current_a", Type.F32, "largest coil current while the tone was on", "A"),
        _u32("rig_samples", "samples that the tone took, ramps and settling included"),
        _u32("payload_bytes", "length of the lock-in payload"),
        _u32("payload_crc", "CRC-32 over result (big-endian) and payload"),
        _u32("raw_bytes", "length of the raw record, 0 for none", required=False),
        _u32("raw_crc", "CRC-32 over result (big-endian) and raw record", required=False),
        CRC,
    ),
)  # fmt: skip
LEASE = Group(
    "lease", 4, "wo", "take the lease",
    (
        _TOKEN,
        Object("seconds", Type.U32, "time to live, renewed by every heartbeat", "s", 1000, low=0.1, high=3600),
        Object("holder", Type.TEXT, "who asks", count=32, required=False),
        CRC,
    ),
)  # fmt: skip
RELEASE = Group("release", 5, "wo", "give the lease back; ends its excitation", (_TOKEN, CRC))
BEAT = Group("beat", 6, "wo", "heartbeat of the holder", (_TOKEN, _u32("count", "must differ from the last"), CRC))
STOP = Group(
    "stop",
    7,
    "wo",
    "ramp the excitation to zero; needs no lease",
    (_u32("token", "token of the host's lease, or of its last or next one; 0 for none"),),
)
ACKNOWLEDGE = Group("acknowledge", 8, "wo", "clear a latched trip", (_TOKEN, CRC))
TONE = Group("tone", 9, "wo", "play a tone", (_TOKEN, _u32("command", "number of this command, rising"), *_TONE, CRC))
WINDOW = Group(
    "window", 10, "wo", "choose which part of a raw record the data area shows",
    (_u32("result", "number of the result"), _u16("segment", "number of the segment"), CRC),
)  # fmt: skip

GROUPS = (IDENTITY, STATUS, TRIP, RESULT, LEASE, RELEASE, BEAT, STOP, ACKNOWLEDGE, TONE, WINDOW)
BY_NAME = {group.name: group for group in GROUPS}


class Outcome(enum.IntEnum):
    """What became of a command."""

    UNDER_WAY = 0
    DONE = 1
    STOPPED = 2
    TRIPPED = 3
    FAILED = 4
    STOPPED_ELSEWHERE = 5
    """By anyone but the holder of the lease."""


class Refusal(enum.Enum):
    """Why a controller refuses a write: Modbus exception code, SDO abort code."""

    ADDRESS = (2, 0x06020000)
    LIMIT = (3, 0x06090030)
    """A value is out of its limits, or the CRC is wrong."""
    TRIPPED = (4, 0x08000021)
    LEASE = (6, 0x08000022)
    """Not the holder of the lease, or busy with another tone."""

    @property
    def modbus(self) -> int:
        """Modbus exception code."""
        return self.value[0]

    @property
    def canopen(self) -> int:
        """SDO abort code."""
        return self.value[1]
