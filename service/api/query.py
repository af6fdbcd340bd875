"""What stands behind the question mark of an address: names that a route does not know are refused, not passed over.

A filter that is misspelt would otherwise give the whole list, as if it had been asked for.
"""

from __future__ import annotations

from collections.abc import Iterator

from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.datastructures import QueryParams
from starlette.types import Receive, Scope, Send

from service.api.problems import UnknownQueryError


class KnownQuery(APIRoute):
    """A route that refuses query parameters which it does not know.

    Raises
    ------
    UnknownQueryError
        From ``handle``, before a body is read; it names them and those that there are.
    """

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if self.methods is None or scope["method"] in self.methods:  # a method that there is not is told as that
            known = set(_names(self.dependant))
            unknown = set(QueryParams(scope["query_string"])) - known
            if unknown:
                raise UnknownQueryError(sorted(unknown), sorted(known))
        await super().handle(scope, receive, send)


def _names(dependant: Dependant) -> Iterator[str]:
    """Query parameters of a route and of what it depends on."""
    yield from (field.alias for field in dependant.query_params)
    for each in dependant.dependencies:
        yield from _names(each)
