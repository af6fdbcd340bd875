"""The reference page of the objects, docs/objects.md: ``python -m drivers.reference docs/objects.md``."""

from __future__ import annotations

import sys
from pathlib import Path

from drivers.canopen import map as canopen
from drivers.canopen.map import LOCKIN_INDEX, RAW_INDEX, RECORD_INDEX, SEGMENT_BYTES, SEGMENT_INDEX, WHOLE_INDEX
from drivers.modbus.map import DEFAULT_MAP, LOCKIN_ADDRESS, RAW_ADDRESS
from drivers.objects import GROUPS, PROTOCOL_VERSION, Group, Object, Refusal, Type
from drivers.pages import DATA_BYTES, PAGE_BYTES, SEGMENT_PAGES

_HEAD = f"""# Objects of a controller, protocol version {PROTOCOL_VERSION}

Generated from `drivers/objects.py` by `python -m drivers.reference docs/objects.md`; do not edit.

A host reads a group as one snapshot and writes a group as one command. A command acts when its last object is
written. The object `crc` is the CRC-32 (zlib) over the group's other objects, big-endian, in order; a command with a
wrong CRC is refused, an answer with a wrong one is asked for again.

- **Modbus**: holding registers (functions 3, 6, 16), big-endian words; addresses count from 0.
- **CANopen**: a record for each group at 0x{RECORD_INDEX:04X} + k, and the whole group as one DOMAIN, little-endian,
  at 0x{WHOLE_INDEX:04X} + k; the EDS file is `amb.eds`. Heartbeat and stop are RPDO 1 and 2 (`beat`, `stop`), progress
  is TPDO 1, a trip sends an EMCY. A host that holds the lease starts this node, and no other, if its boot-up
  message or heartbeat tells that it is pre-operational; not again under a lease under which it was operational.
- **A rig's own map** is a TOML file that moves, retypes, rescales or leaves out objects, for the option `map=` of a
  controller's URL and `--map` of `ambit rig serve`. `drivers/modbus/map.py` and `drivers/canopen/map.py` have examples;
  a map that cannot work is refused when it is read.

## A measurement

1. Write `lease` with a token of your own; write `beat` every 50 ms with a counter that moves. 200 ms without a beat
   while a tone plays: the excitation ramps to zero and a trip latches until `acknowledge`.
2. Write `tone` with a new command number. Asking again under the same number is harmless.
3. Read `status` until `command` is yours and `outcome` is not 0 (on CANopen, TPDO 1 tells).
4. Read `result`, then its payload, and check `payload_crc`. A result never changes under its number.
5. Write `release`. Anyone may write `stop` at any time.

## Data of the last result, 32-bit floats

- **Lock-in payload**: Modbus input registers (function 4) from {LOCKIN_ADDRESS}; CANopen 0x{LOCKIN_INDEX:04X}, DOMAIN.
  For u, i, y in turn (block, part, axis); the parts are the mean, then real and imaginary part of harmonics 1, 2, 3.
  From five blocks on, a shorter form may come (its length tells): the mean over the blocks (part, axis), then what
  each block differs from it, 24-bit floats: 32-bit ones without their last byte.
- **Raw record**: (sample, signal u i y, axis). CANopen 0x{RAW_INDEX:04X}, DOMAIN, and in parts at
  0x{SEGMENT_INDEX:04X}: {SEGMENT_BYTES} bytes of it, or what is left of it.
  Modbus input registers from {RAW_ADDRESS}: {SEGMENT_PAGES} pages of {PAGE_BYTES // 2} registers. A page has
  {DATA_BYTES} bytes of the record, or what is left of it, and their CRC-32, which covers the result's number, the
  page's number from 0 on (32 bits each, big-endian) and these bytes. Which part is shown, `window` says.

Complex amplitudes: x(t) = Re(X exp(j h w t)), the time origin such that r at harmonic 1 is real and positive. r itself
is the tone that was asked for, its amplitude a whole number of microamperes, and is not sent; a host asks for no other
amplitude than a rig's own map can carry both ways, the next lower one where its steps are coarser. The payload's CRC-32
covers the result's number (big-endian) and the bytes as they are sent.

## Refusals

| why | Modbus exception | SDO abort |
|---|---|---|
"""
_WHY = {
    Refusal.ADDRESS: "no such object, or not in this direction",
    Refusal.LIMIT: "outside its limits, or a wrong CRC",
    Refusal.TRIPPED: "a trip is latched",
    Refusal.LEASE: "not the holder of the lease, or busy",
}


def page() -> str:
    """The whole page, Markdown."""
    refusals = "".join(f"| {_WHY[r]} | {r.modbus} | 0x{r.canopen:08X} |\n" for r in Refusal)
    return _HEAD + refusals + "".join(_group(group) for group in GROUPS)


def _group(group: Group) -> str:
    subs = {s.obj.name: s.subindex for s in reversed(canopen.DEFAULT_MAP.of(group.name))}
    rows = "".join(
        f"| `{e.obj.name}` | {e.address} | {subs[e.obj.name]} | {_type(e.obj)} | {_scale(e.obj)} | {_limits(e.obj)} | "
        f"{e.obj.description} |\n"
        for e in DEFAULT_MAP.of(group.name)
    )
    access = "read" if group.access == "ro" else "write"
    return (
        f"\n## `{group.name}` ({access}): {group.description}\n\n"
        f"CANopen 0x{RECORD_INDEX + group.index:04X}, whole 0x{WHOLE_INDEX + group.index:04X}.\n\n"
        "| object | Modbus register | sub-index | type | one count | limits | meaning |\n"
        "|---|---|---|---|---|---|---|\n" + rows
    )


def _type(obj: Object) -> str:
    if obj.type is Type.TEXT:
        return f"text, {obj.count} bytes"
    return str(obj.type.value[1]) + (f" x {obj.count}" if obj.count > 1 else "")


def _scale(obj: Object) -> str:
    return f"{1 / obj.per_unit:g} {obj.unit}".strip() if obj.unit or obj.per_unit > 1 else ""


def _limits(obj: Object) -> str:
    if obj.low is None and obj.high is None:
        return ""
    return f"{'' if obj.low is None else f'{obj.low:g}'} to {'' if obj.high is None else f'{obj.high:g}'}".strip()


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
