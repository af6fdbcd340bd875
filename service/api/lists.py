"""Lists, page by page: what a caller asks of one, and how it is answered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Query, Response

from service.api import etags, identifiers
from service.api.shapes import IfNoneMatch, Shape
from service.storage.listing import LARGEST_PAGE, Page
from service.storage.tables import Base

T = TypeVar("T")
After = TypeVar("After", str, int)
Row = TypeVar("Row", bound=Base)
Item = TypeVar("Item", bound=Shape)

AFTER = "The field `next` of the page before."
NEWEST = "Only the newest of each rig, which was made last."
Limit = Annotated[int, Query(description="Items of a page.", ge=1, le=LARGEST_PAGE)]
OfRig = Annotated[str | None, Query(description="Only of this rig.", max_length=40, pattern=identifiers.pattern("rig"))]


class Listed(Shape, Generic[T]):
    """A page of a list, newest first."""

    items: list[T]
    next: str | None
    """``after`` of the next page; null on the last."""


@dataclass(frozen=True)
class Asked(Generic[After]):
    """What a caller asks of a list, and has of it already."""

    after: After | None
    limit: int
    if_none_match: str | None

    def answer(self, listed: type[Listed[Item]], page: Page[Row], shape: Callable[[Row], Item]) -> Response:
        """A page with its ETag, its rows as they are sent; 304 when the caller has it."""
        found = listed(items=[shape(row) for row in page.items], next=page.next)
        return etags.document(found, self.if_none_match)


def asked_of(prefix: str, usual: int = 100) -> Any:
    """A dependency: `Asked` of a list of such resources, of which a page has ``usual`` items unless told otherwise."""
    return _asked_by_text(identifiers.pattern(prefix), usual)


def asked_by_making(prefix: str, usual: int = 100) -> Any:
    """As `asked_of`, of a list of what jobs make, which is ordered by when that was."""
    return _asked_by_text(identifiers.place_pattern(prefix), usual)


def _asked_by_text(pattern: str, usual: int) -> Any:
    begins = Query(None, description=AFTER, max_length=60, pattern=pattern)

    async def asked(after: str | None = begins, limit: Limit = usual, if_none_match: IfNoneMatch = None) -> Asked[str]:
        return Asked(after, limit, if_none_match)

    return Depends(asked)


def asked_by_number(least: int, most: int) -> Any:
    """A dependency: `Asked` of a list that is ordered by a number in this range."""
    begins = Query(None, description=AFTER, ge=least, le=most)

    async def asked(after: int | None = begins, limit: Limit = 100, if_none_match: IfNoneMatch = None) -> Asked[int]:
        return Asked(after, limit, if_none_match)

    return Depends(asked)
