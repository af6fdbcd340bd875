"""A raw record in pages, each with a CRC: frames of Modbus TCP have none of their own. Pure.

A page is as much as one Modbus request reads: 246 bytes of the record, and the CRC-32 over the number of the result,
the number of the page (both 32 bits, big-endian) and these bytes. A page that was corrupted, or that is another one,
is asked for again, and not all that went before it: of a long record on a bad bus some page is always wrong.
"""

from __future__ import annotations

import struct
import zlib

from drivers.errors import BusError

PAGE_BYTES = 250
DATA_BYTES = PAGE_BYTES - 4
SEGMENT_PAGES = 384
"""So many are in the registers at once; which ones, the host chooses."""
SEGMENT_BYTES = SEGMENT_PAGES * PAGE_BYTES
_NUMBERS = struct.Struct(">II")
_CRC = struct.Struct(">I")


def _crc(result: int, page: int, data: bytes) -> bytes:
    return _CRC.pack(zlib.crc32(data, zlib.crc32(_NUMBERS.pack(result, page))))


def paged(result: int, record: bytes) -> bytes:
    """The record's pages, one after the other; the last one may be shorter."""
    starts = range(0, len(record), DATA_BYTES)
    parts = (record[at : at + DATA_BYTES] for at in starts)
    return b"".join(data + _crc(result, page, data) for page, data in enumerate(parts))


def paged_bytes(size: int) -> int:
    """Length of the pages of a record of that many bytes."""
    return size + _CRC.size * -(-size // DATA_BYTES)


def page_data(result: int, page: int, raw: bytes) -> bytes:
    """What a page holds of its record.

    Raises
    ------
    BusError
        It was corrupted, or is another page, or that of another result.
    """
    data = raw[: -_CRC.size]
    if _crc(result, page, data) != raw[-_CRC.size :]:
        raise BusError(f"the CRC of page {page} of the raw record is wrong: it was corrupted on the bus")
    return data
