"""API keys: made, shown once, kept as a hash, verified in constant time.

A key reads ``ambit_<id>_<secret>``: the id finds its record, the secret proves it. Only a hash of the secret is kept.
SHA-256 without stretching is enough, because the secret is 192 random bits: no dictionary holds it.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

from service.access.errors import ForbiddenError, UnauthorisedError

SECRET_BYTES = 24
KEY = re.compile(r"ambit_([0-9a-z]{8,40})_([0-9a-f]{48})")
"""A whole key; also what the log looks for, to strike it out."""
_NO_HASH = "0" * 64
REMEDY = (
    "give a valid key: AMBIT_KEY or --key of a command, the page's key field, 'Authorization: Bearer ambit_...' of a "
    "request; an administrator makes one with ambit keys create"
)


class Scope(StrEnum):
    """What a key may do; each scope includes those before it.

    >>> Scope.admin.includes(Scope.operator), Scope.viewer.includes(Scope.operator)
    (True, False)
    """

    viewer = "viewer"
    """Read everything but keys."""
    operator = "operator"
    """Also move rotors: submit, cancel and retry jobs, upload experiments, keep schedules and datasheets."""
    admin = "admin"
    """Also retire rigs."""

    def includes(self, other: Scope) -> bool:
        """Whether this scope reaches as far as the other."""
        order = list(Scope)
        return order.index(self) >= order.index(other)


@dataclass(frozen=True)
class KeyRecord:
    """What is kept of a key. All times are UTC."""

    id: str
    """``key_...``"""
    name: str
    """Who or what holds it."""
    scope: Scope
    hash: str
    """SHA-256 of id and secret, hexadecimal."""
    created: datetime
    expires: datetime | None = None
    revoked: datetime | None = None

    def state(self, now: datetime) -> str:
        """Whether it is "valid", "expired" or "revoked"."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if self.expires is not None and self.expires <= now else "valid"


@dataclass(frozen=True)
class Identity:
    """Who asks."""

    key_id: str
    name: str
    scope: Scope

    def must_reach(self, scope: Scope) -> Identity:
        """Oneself, if the scope reaches so far.

        Raises
        ------
        ForbiddenError
            It does not; names both scopes.
        """
        if not self.scope.includes(scope):
            raise ForbiddenError(
                f"this needs the scope {scope}, the key {self.name!r} has {self.scope}: ask for another key"
            )
        return self


LOCAL = Identity("local", "local", Scope.admin)
"""Whoever sits at a service that has no keys, and so listens on the loopback interface only."""


def issue(
    key_id: str, name: str, scope: Scope, now: datetime | None = None, expires: datetime | None = None
) -> tuple[KeyRecord, str]:
    """A new key: its record, and the key itself, which exists nowhere else.

    Parameters
    ----------
    key_id
        ``key_`` and 8 to 40 lower-case letters and digits.

    Raises
    ------
    ValueError
        The id is of another form, or it expires before it begins.
    """
    now = now or datetime.now(UTC)
    body = key_id.removeprefix("key_")
    if not re.fullmatch(r"[0-9a-z]{8,40}", body):
        raise ValueError(f"{key_id!r} is no id of a key")
    if expires is not None and expires <= now:
        raise ValueError("a key must expire in the future")
    secret = secrets.token_hex(SECRET_BYTES)
    return KeyRecord(key_id, name, scope, hashed(body, secret), now, expires), f"ambit_{body}_{secret}"


def hashed(body: str, secret: str) -> str:
    """Hash that is kept of a secret; the id goes in, so that no hash fits another record."""
    return hashlib.sha256(f"{body}:{secret}".encode()).hexdigest()


def id_of(key: str) -> str | None:
    """Id of the record that a key belongs to, or None if it is no key at all.

    >>> id_of("ambit_018f2a3b4c5d_" + "0" * 48)
    'key_018f2a3b4c5d'
    >>> id_of("password")
    """
    found = KEY.fullmatch(key)
    return f"key_{found[1]}" if found else None


def verify(key: str, record: KeyRecord | None, now: datetime | None = None) -> Identity:
    """Identity of whoever shows a key.

    Parameters
    ----------
    record
        What is kept under `id_of` the key; None if there is nothing. The same work is done then, so that the time
        taken does not tell which ids exist.

    Raises
    ------
    UnauthorisedError
        The key is unknown or wrong (the message does not say which), or expired, or revoked.
    """
    found = KEY.fullmatch(key)
    body, secret = (found[1], found[2]) if found else ("", "")
    right = hmac.compare_digest(hashed(body, secret), record.hash if record else _NO_HASH)
    if record is None or not right or record.id != f"key_{body}":
        raise UnauthorisedError(f"the key is not known; {REMEDY}")
    state = record.state(now or datetime.now(UTC))
    if state != "valid":
        raise UnauthorisedError(f"the key {record.name!r} is {state}; {REMEDY}")
    return Identity(record.id, record.name, record.scope)


def bearer(authorization: str | None) -> str:
    """The key in an Authorization header.

    Raises
    ------
    UnauthorisedError
        There is no header, or it is of another scheme.

    >>> bearer("Bearer ambit_x_y")
    'ambit_x_y'
    """
    scheme, _, key = (authorization or "").partition(" ")
    if scheme.lower() != "bearer" or not key.strip():
        raise UnauthorisedError(f"this needs a key; {REMEDY}")
    return key.strip()
