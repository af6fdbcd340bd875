"""Workers and their signs of life.

All times are the database's: clocks of machines differ, and a worker whose machine is late is not silent.
"""

from __future__ import annotations

import os
import socket
from datetime import datetime, timedelta

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from service.errors import ConflictError
from service.storage.clock import Clock, told
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
    at = told(session)
    row = session.get(WorkerRow, name)
    if row is not None and row.instance != instance and _lives(row, at):
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
    return row if row is not None and _lives(row, told(session)) else None


def living(session: Session) -> list[WorkerRow]:
    """Workers that gave a sign of life just now, by name."""
    at = told(session)
    return [row for row in listed(session) if _lives(row, at)]


def _lives(row: WorkerRow, at: datetime) -> bool:
    if row.stopped_at is not None or at - row.beat_at > timedelta(seconds=ALIVE_S):
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
    return session.scalar(mine.values(beat_at=Clock()).returning(WorkerRow.name)) is not None


def sign_off(session: Session, name: str, instance: str) -> None:
    """Note that a worker ended in good order."""
    session.execute(
        update(WorkerRow).where(WorkerRow.name == name, WorkerRow.instance == instance).values(stopped_at=Clock())
    )


def silent(session: Session, seconds: float) -> list[str]:
    """Names of workers without a sign of life for so long, or ended."""
    found = session.execute(select(WorkerRow.name, WorkerRow.beat_at, Clock()))
    return [name for name, beat_at, at in found if at - beat_at > timedelta(seconds=seconds)]


def listed(session: Session) -> list[WorkerRow]:
    """All workers by name."""
    return list(session.scalars(select(WorkerRow).order_by(WorkerRow.name)))


def elsewhere(session: Session) -> WorkerRow | None:
    """A worker of another machine that gave a sign of life just now."""
    return next((row for row in living(session) if row.machine != machine()), None)


def count_alive(session: Session) -> int:
    """How many workers gave a sign of life just now."""
    found = session.execute(select(WorkerRow.beat_at, Clock()).where(WorkerRow.stopped_at.is_(None)))
    return sum(at - beat_at <= timedelta(seconds=ALIVE_S) for beat_at, at in found)
