"""One row by its id, and pages of a list, newest first.

A page begins after the last row of the one before, however much was added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Generic, TypeVar

from sqlalchemy import ColumnElement, Select, and_, or_, select
from sqlalchemy.orm import Session

from service.errors import NotFoundError
from service.storage.tables import Base

Row = TypeVar("Row", bound=Base)

LARGEST_PAGE = 1000
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)


def row(session: Session, table: type[Row], row_id: str, what: str, where: str, for_update: bool = False) -> Row:
    """The row of an id.

    Parameters
    ----------
    what, where
        What such a row is to a user, and where all of them are listed.
    for_update
        Lock it until the transaction ends.

    Raises
    ------
    NotFoundError
        There is none of that id.
    """
    found = session.get(table, row_id, with_for_update=for_update or None)
    if found is None:
        raise NotFoundError(f"there is no {what} {row_id!r}; list them {where}")
    return found


@dataclass(frozen=True)
class Page(Generic[Row]):
    """One page."""

    items: list[Row]
    next: str | None
    """Where the next page begins; None at the end."""


def page(
    session: Session,
    table: type[Row],
    *conditions: ColumnElement[bool],
    after: Any = None,
    limit: int = 100,
    key: str = "id",
    told: Callable[[Any], str] = str,
) -> Page[Row]:
    """Rows of a table, newest first.

    Parameters
    ----------
    after
        Value of the key in the last row of the page before.
    key
        Name of a column that sorts by time and is of one row only, under the conditions: ids are.
    told
        How a value of the key is told as ``next``.
    """
    column: Any = table.__table__.c[key]
    query = select(table).where(*conditions).order_by(column.desc())
    if after is not None:
        query = query.where(column < after)
    return _page(session, query, limit, lambda row: told(getattr(row, key)))


def page_by_making(
    session: Session, table: type[Row], *conditions: ColumnElement[bool], after: str | None = None, limit: int = 100
) -> Page[Row]:
    """Rows of a table, the one that was made last first.

    An id tells when the job was submitted that made the row, and that may be tried again: then it makes it anew. So
    ``after`` and ``next`` tell the time, too, or the next page would begin where the row is by then.
    """
    at, own = table.__table__.c["created_at"], table.__table__.c["id"]
    order = (at.desc(), own.desc())
    placed = select(own).where(*conditions).order_by(*order).limit(limit + 1)  # none of the others' documents is read
    if after is not None:
        last, _, time = after.partition(".")
        made = moment(int(time))
        placed = placed.where(or_(at < made, and_(at == made, own < last)))
    query = select(table).where(own.in_(select(placed.subquery().c.id))).order_by(*order)
    return _page(session, query, limit, lambda row: f"{row.id}.{microseconds(row.created_at)}")


def _page(session: Session, query: Select[Any], limit: int, told: Callable[[Row], str]) -> Page[Row]:
    """The first rows of a query, and how the last one of them is told as ``next``."""
    items: list[Row] = list(session.scalars(query.limit(limit + 1)))
    more = len(items) > limit
    items = items[:limit]
    return Page(items, told(items[-1]) if more and items else None)


def microseconds(at: datetime) -> int:
    """A time as µs since 1970, UTC: a cursor of lists that are ordered by time.

    >>> moment(microseconds(datetime(2026, 3, 1, 6, 0, 0, 7, UTC)))
    datetime.datetime(2026, 3, 1, 6, 0, 0, 7, tzinfo=datetime.timezone.utc)
    """
    return (at - _EPOCH) // _MICROSECOND


def moment(number: int) -> datetime:
    """A time from µs since 1970, UTC."""
    return _EPOCH + number * _MICROSECOND
