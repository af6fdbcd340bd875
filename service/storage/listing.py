"""One row by its id, and pages of a list, newest first.

A page begins after the last id of the one before, however much was added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from service.errors import NotFoundError
from service.storage.tables import Base

Row = TypeVar("Row", bound=Base)

LARGEST_PAGE = 1000


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
    query = select(table).where(*conditions).order_by(column.desc()).limit(limit + 1)
    if after is not None:
        query = query.where(column < after)
    items = list(session.scalars(query))
    more = len(items) > limit
    items = items[:limit]
    return Page(items, told(getattr(items[-1], key)) if more and items else None)
