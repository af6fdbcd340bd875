"""Who asks, and whether they may: `KeyFirst` routes ask before anything else is done, as each one's `require` says.

The application keeps its `Gate` as ``app.state.gate``; ``request.state.identity`` tells the log who asked.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Coroutine
from functools import cache, partial
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import ASGIApp, Receive, Send
from starlette.types import Scope as ASGIScope

from service.access import keys
from service.access.audit import Action
from service.access.errors import ForbiddenError, UnauthorisedError
from service.access.keys import LOCAL, Identity, KeyRecord, Scope
from service.access.loopback import must_be_this_machine
from service.access.rate import Limiter, Rate
from service.api.auditing import audit
from service.api.kept import Kept
from service.api.query import KnownQuery
from service.storage import keys as rows
from service.storage.database import Database, now

log = logging.getLogger(__name__)

FAILURES = Rate(per_s=2.0, burst=20)
"""Wrong keys that one address may try."""
NOTED_EVERY_S = 60.0
THREADS = 4
"""That look up keys: apart from those of the requests, so that who stops a rig is let in while all of these wait."""
REFUSALS = Rate(per_s=1 / 60, burst=1)
"""Lines of the audit log about what one address was refused,"""
ALL_REFUSALS = Rate(per_s=0.1, burst=100)
"""and about all addresses together: whoever has many must not fill the log either."""
NOBODY = Identity("", "nobody", Scope.viewer)
"""Whoever shows no key that holds."""

_scheme = HTTPBearer(
    scheme_name="key",
    description="An API key, `ambit_<id>_<secret>`; `ambit keys create` makes one. A service that has no keys yet "
    "serves its own machine without.",
    auto_error=False,
)


class Gate:
    """Lets callers in.

    Parameters
    ----------
    database
        Where the keys are.
    rate
        Requests that one key may make.
    """

    def __init__(self, database: Database, rate: Rate) -> None:
        self._database = database
        self._limiter = Limiter(rate)
        self._failures = Limiter(FAILURES)
        self._refusals = Limiter(REFUSALS)
        self._all_refusals = Limiter(ALL_REFUSALS, callers=1)
        self._noted: dict[str, float] = {}
        self._threads = CapacityLimiter(THREADS)
        self._records: Kept[KeyRecord | None] = Kept(database, threads=self._threads)
        self._any_key: Kept[bool] = Kept(database, threads=self._threads)

    async def identity(self, key: str | None, address: str | None, request: Request | None = None) -> Identity:
        """Whoever shows this key, or sits at a service without keys.

        Raises
        ------
        UnauthorisedError
            There is no key that holds.
        RateError
            Too many requests by this key, or too many wrong keys from this address.
        """
        try:
            who = await (self._local(address, request) if key is None else self._holder(key, address or ""))
        except UnauthorisedError:
            self._failures.take(f"wrong {address}")
            raise
        self._limiter.take(who.key_id)
        return who

    async def still_lets_in(self, request: Request) -> bool:
        """Whether whoever was let in with a request would be now: a key may have ended meanwhile."""
        header = request.headers.get("authorization")
        address = request.client.host if request.client else None
        try:
            await (
                self._local(address, request) if header is None else self._holder(keys.bearer(header), address or "")
            )
        except UnauthorisedError:
            return False
        return True

    async def refused(self, request: Request, who: Identity, key: str | None, error: Exception) -> None:
        """Note in the audit log that someone was not let in, as often as `REFUSALS` allows."""
        address = request.client.host if request.client else ""
        if not self._refusals.wait_s(address) and not self._all_refusals.wait_s(""):
            key_id = key and keys.id_of(key)
            await to_thread.run_sync(self._note_refusal, request, who, key_id, str(error), limiter=self._threads)

    def _note_refusal(self, request: Request, who: Identity, key_id: str | None, why: str) -> None:
        route = f"{request.method} {getattr(request.scope.get('route'), 'path', '')}"
        try:
            with self._database.write() as session:
                audit(session, request, who, Action.access_refused, key_id or "", why=why, route=route)
        except SQLAlchemyError as error:
            log.warning("a refusal is not in the audit log: %s", str(error).splitlines()[0])

    async def _local(self, address: str | None, request: Request | None) -> Identity:
        if await self._any_key.get("", self._read_any_key):
            raise UnauthorisedError(f"this needs a key; {keys.REMEDY}")
        must_be_this_machine(address, {} if request is None else request.headers)
        return LOCAL

    def _read_any_key(self) -> bool:
        with self._database.read() as session:
            return rows.any_key(session)

    async def _holder(self, key: str, address: str) -> Identity:
        key_id = keys.id_of(key)
        record = await self._records.get(key_id, partial(self._read_record, key_id)) if key_id else None
        who = keys.verify(key, record, now())
        if self._to_be_noted(who.key_id):
            await to_thread.run_sync(self._note, who.key_id, address, limiter=self._threads)
        return who

    def _read_record(self, key_id: str) -> KeyRecord | None:
        with self._database.read() as session:
            row = rows.find(session, key_id)
            return None if row is None else rows.record(row)

    def _to_be_noted(self, key_id: str) -> bool:
        """Whether the use of a key was not noted for a while; whoever asks then does."""
        at = time.monotonic()
        if at - self._noted.get(key_id, -NOTED_EVERY_S) < NOTED_EVERY_S:
            return False
        self._noted[key_id] = at
        return True

    def _note(self, key_id: str, address: str) -> None:
        """Note the use of a key; a database that is busy with better things is left alone."""
        try:
            with self._database.write() as session:
                rows.used(session, key_id, now(), address)
        except SQLAlchemyError:
            self._noted.pop(key_id, None)


async def admitted(request: Request, scope: Scope) -> None:
    """Let whoever asks in, as ``request.state.identity``.

    Raises
    ------
    UnauthorisedError, ForbiddenError, RateError
        There is no key that holds, its scope does not reach so far, or it asks too often.
    """
    gate: Gate = request.app.state.gate
    header = request.headers.get("authorization")
    who, key = NOBODY, None
    try:
        # whoever shows something that is no key is not taken for nobody
        key = None if header is None else keys.bearer(header)
        who = await gate.identity(key, request.client.host if request.client else None, request)
        request.state.identity = who
        who.must_reach(scope)
    except (UnauthorisedError, ForbiddenError) as error:
        await gate.refused(request, who, key, error)
        raise


@cache
def require(scope: Scope) -> Callable[..., Coroutine[Any, Any, Identity]]:
    """Dependency of a route: the identity of whoever asks, if its scope reaches so far.

    ``who: Annotated[Identity, Depends(require(Scope.operator))]`` in a router of `KeyFirst`, which has asked by then;
    a route of another class lets nobody in.
    """

    async def allowed(
        request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Security(_scheme)]
    ) -> Identity:
        who: Identity = request.state.identity
        return who.must_reach(scope)

    return allowed


class KeyFirst(KnownQuery):
    """A route that asks for a key, as its `require` says, before a body is read and before it tells what it knows.

    FastAPI on its own reads the body first, and tells anyone what is wrong with it.
    """

    async def handle(self, scope: ASGIScope, receive: Receive, send: Send) -> None:
        """One request."""
        asked = [dependency.call for dependency in self.dependant.dependencies]
        required = next((wanted for wanted in Scope if require(wanted) in asked), None)
        if required is not None:
            known = self.methods is None or scope["method"] in self.methods
            await admitted(Request(scope), required if known else Scope.viewer)
        await super().handle(scope, receive, send)


class Elsewhere:
    """ASGI application for the addresses that there are not: under ``/api/`` only who has a key is told."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: ASGIScope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] == "http" and scope["path"].startswith("/api/"):
            await admitted(Request(scope), Scope.viewer)
        await self._app(scope, receive, send)
