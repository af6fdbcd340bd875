"""API keys as rows; what a key is, and when it holds, is service.access.keys."""

from __future__ import annotations

from datetime import datetime, timedelta

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from service.access.keys import KeyRecord, Scope
from service.storage import listing
from service.storage.database import now
from service.storage.tables import KeyRow

_USED_EVERY = timedelta(minutes=1)
"""How exactly the last use of a key is kept."""


def record(row: KeyRow) -> KeyRecord:
    """A row as what the rules of access know."""
    return KeyRecord(
        row.id, row.name, Scope(row.scope), row.secret_hash, row.created_at, row.expires_at, row.revoked_at
    )


def row(of: KeyRecord, created_by: str) -> KeyRow:
    """A row that keeps a key."""
    return KeyRow(
        id=of.id,
        name=of.name,
        scope=str(of.scope),
        secret_hash=of.hash,
        created_at=of.created,
        created_by=created_by,
        expires_at=of.expires,
        revoked_at=of.revoked,
        used_at=None,
        used_from="",
    )


def add(session: Session, row: KeyRow) -> KeyRow:
    """A new key."""
    session.add(row)
    session.flush()
    return row


def find(session: Session, key_id: str) -> KeyRow | None:
    """A key, or None."""
    return session.get(KeyRow, key_id)


def any_key(session: Session) -> bool:
    """Whether there is a key, revoked and expired ones too: then nobody comes in without."""
    return bool(session.scalar(select(func.count()).select_from(KeyRow)))


def listed(session: Session) -> list[KeyRow]:
    """All keys, newest first."""
    return list(session.scalars(select(KeyRow).order_by(KeyRow.id.desc())))


def revoke(session: Session, key_id: str) -> KeyRow:
    """Revoke a key from now on; again changes nothing.

    Raises
    ------
    NotFoundError
        There is none of that id.
    """
    found = listing.row(session, KeyRow, key_id, "key", "with ambit keys list")
    found.revoked_at = found.revoked_at or now()
    return found


def used(session: Session, key_id: str, at: datetime, address: str = "") -> None:
    """Note the use of a key, to the minute, and where it came from."""
    stale = KeyRow.used_at.is_(None) | (KeyRow.used_at < at - _USED_EVERY) | (KeyRow.used_from != address)
    values = {"used_at": at, "used_from": address[:60]}
    session.execute(update(KeyRow).where(KeyRow.id == key_id, stale).values(**values))
