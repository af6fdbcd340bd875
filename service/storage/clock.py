"""The database's clock: the one that all machines of an installation have in common."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.functions import FunctionElement

from service.storage.tables import UtcDateTime


class Clock(FunctionElement[datetime]):
    """The time by the database, as a part of a statement; of its whole transaction it is not one time."""

    type = UtcDateTime()
    inherit_cache = True


@compiles(Clock, "postgresql")
def _of_postgresql(*_: Any, **__: Any) -> str:
    return "clock_timestamp()"


@compiles(Clock, "sqlite")
def _of_sqlite(*_: Any, **__: Any) -> str:
    return "(strftime('%Y-%m-%d %H:%M:%f', 'now') || '000')"  # microseconds, as its columns have them


def told(session: Session) -> datetime:
    """The time by the database, UTC."""
    return session.execute(select(Clock())).scalar_one()
