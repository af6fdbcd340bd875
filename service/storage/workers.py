"""Workers and their signs of life."""

from __future__ import annotations

import os
import socket
from datetime import timedelta

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from service.errors import ConflictError
from service.storage.database import now
from service.storage.tables import WorkerRow

ALIVE_S = 5.0
"""A worker beats every two seconds; one that was silent for so long is no rival for its name."""


def machine() -> str:
    """Name of the machine, or of the container."""
    return socket.gethostname()


def sign_on(session: Session, name: str, instance: str) -> None:
    """Take a worker's name.

    Raises
    ------
    ConflictError
        Another process has it and is alive: two workers of one name would do one job twice.
    """
    at = now()
    row = session.get(WorkerRow, name)
    if row is not None and row.instance != instance and _lives(row):
        raise ConflictError(
            f"a worker named {name!r} runs on {row.machine} as process {row.process}; end it, or give another name"
        )
    session.merge(
        WorkerRow(
            name=name,
            instance=instance,
            machine=machine(),
            process=os.getpid(),
            started_at=at,
            beat_at=at,
            stopped_at=None,
        )
    )


def named(session: Session, name: str) -> WorkerRow | None:
    """Whoever has a worker's name and lives, as far as can be told: one that was just killed may seem to."""
    row = session.get(WorkerRow, name)
    return row if row is not None and _lives(row) else None


def alive(row: WorkerRow) -> bool:
    """Whether a worker gave a sign of life just now."""
    return _lives(row)


def _lives(row: WorkerRow) -> bool:
    if row.stopped_at is not None or now() - row.beat_at > timedelta(seconds=ALIVE_S):
        return False
    if row.machine != machine():
        return True
    try:
        os.kill(row.process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return row.process != os.getpid()


def beat(session: Session, name: str, instance: str) -> bool:
    """Give a sign of life; False when another process has the name."""
    mine = update(WorkerRow).where(WorkerRow.name == name, WorkerRow.instance == instance)
    return session.scalar(mine.values(beat_at=now()).returning(WorkerRow.name)) is not None


def sign_off(session: Session, name: str, instance: str) -> None:
    """Note that a worker ended in good order."""
    session.execute(
        update(WorkerRow).where(WorkerRow.name == name, WorkerRow.instance == instance).values(stopped_at=now())
    )


def silent(session: Session, seconds: float) -> list[str]:
    """Names of workers without a sign of life for so long, or ended."""
    limit = now() - timedelta(seconds=seconds)
    return list(session.scalars(select(WorkerRow.name).where(WorkerRow.beat_at < limit)))


def listed(session: Session) -> list[WorkerRow]:
    """All workers by name."""
    return list(session.scalars(select(WorkerRow).order_by(WorkerRow.name)))


def elsewhere(session: Session) -> WorkerRow | None:
    """A worker of another machine that gave a sign of life just now."""
    return next((row for row in listed(session) if row.machine != machine() and _lives(row)), None)


def count_alive(session: Session) -> int:
    """How many workers gave a sign of life just now."""
    limit = now() - timedelta(seconds=ALIVE_S)
    query = select(func.count()).select_from(WorkerRow)
    return session.scalar(query.where(WorkerRow.beat_at >= limit, WorkerRow.stopped_at.is_(None))) or 0
