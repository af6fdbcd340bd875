"""Idempotency-Key: a request that is sent again is done once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from fastapi import Request, Response
from fastapi.responses import JSONResponse
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.access.keys import Identity
from service.api.problems import UnprocessableError
from service.storage import idempotency
from service.storage.database import Database, now
from service.storage.tables import IdempotencyRow
from sim.errors import AmbError


@dataclass(frozen=True)
class Answer:
    """What a request that makes something is answered with."""

    status: int
    location: str
    body: dict[str, Any]

    def response(self, replayed: bool = False) -> Response:
        """As it is sent."""
        headers = {"Location": self.location} | ({"Idempotent-Replayed": "true"} if replayed else {})
        return JSONResponse(self.body, self.status, headers)


def once(
    database: Database,
    who: Identity,
    request: Request,
    key: str | None,
    content: str,
    make: Callable[[Session], Answer],
    before: Callable[[], None] = lambda: None,
) -> tuple[Answer, bool]:
    """Do what a request asks for, in one transaction with the note that it was done.

    Parameters
    ----------
    content
        What the request is, beyond its address: the same key with another content is refused.
    make
        Does it.
    before
        Refuses what is not to be done, by what takes longer than a transaction should.

    Returns
    -------
    answer, replayed
        Whether it had been done before.

    Raises
    ------
    UnprocessableError
        The key was used for another request.
    """
    if key is None:
        before()
        with database.write() as session:
            return make(session), False
    digest = sha256(f"{request.method} {request.url.path}\n{content}".encode()).hexdigest()
    for _ in range(2):
        with database.read() as session:
            found = idempotency.find(session, who.key_id, key)
        if found is not None:
            if found.request_sha256 != digest:
                raise UnprocessableError(f"the Idempotency-Key {key!r} was used for another request; take a new one")
            return Answer(found.status, found.location, found.body), True
        try:
            before()
            with database.write() as session:
                answer = make(session)
                idempotency.keep(
                    session,
                    IdempotencyRow(
                        owner=who.key_id,
                        key=key,
                        request_sha256=digest,
                        status=answer.status,
                        location=answer.location,
                        body=answer.body,
                        created_at=now(),
                    ),
                )
            return answer, False
        except IntegrityError:  # another request with this key was quicker: its answer is there now
            continue
        except AmbError:  # perhaps for what that one did, as a name that it took
            with database.read() as session:
                if idempotency.find(session, who.key_id, key) is None:
                    raise
    raise UnprocessableError(f"the Idempotency-Key {key!r} collides with another request; take a new one")
