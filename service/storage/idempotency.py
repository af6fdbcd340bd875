"""Answers to requests with an Idempotency-Key: a request that is sent again gets the first answer."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import delete
from sqlalchemy.orm import Session

from service.storage.database import now
from service.storage.tables import IdempotencyRow

KEPT = timedelta(days=2)


def find(session: Session, owner: str, key: str) -> IdempotencyRow | None:
    """The answer that was given, or None."""
    return session.get(IdempotencyRow, (owner, key))


def keep(session: Session, row: IdempotencyRow) -> None:
    """Keep an answer, in the transaction of what it tells of; IntegrityError when another request was quicker."""
    session.add(row)
    session.flush()


def forget_old(session: Session) -> None:
    """Drop answers that nobody will ask for again."""
    session.execute(delete(IdempotencyRow).where(IdempotencyRow.created_at < now() - KEPT))
