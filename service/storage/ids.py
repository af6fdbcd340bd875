"""Identifiers that sort by the time of their making."""

from __future__ import annotations

import secrets
import threading
import time

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford's base 32: no letter that is read as another."""
_LENGTH = 26

_LOCK = threading.Lock()
_last = 0


def new_id(prefix: str) -> str:
    """``prefix_`` and 26 letters: 48 bits of milliseconds, 80 random ones; of one process each is above the last.

    Lists are by id: of two lines of one millisecond the later one must not come first (ULID's monotonic order).

    >>> new_id("job")[:4], len(new_id("job"))
    ('job_', 30)
    """
    global _last
    with _LOCK:
        value = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
        _last = value = max(value, _last + 1 + secrets.randbits(64))
    return f"{prefix}_" + "".join(_ALPHABET[(value >> 5 * k) & 31] for k in reversed(range(_LENGTH)))


def derived_id(prefix: str, of: str) -> str:
    """Identifier that belongs to another one, so that what is made twice is the same thing.

    >>> derived_id("exp", "job_01k")
    'exp_01k'
    """
    return f"{prefix}_{of.partition('_')[2]}"
