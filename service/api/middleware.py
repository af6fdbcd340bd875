"""Around every request: an id, a limit on its body, and a count."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
import time
from math import ceil
from typing import Any

from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import logs
from service.access.rate import Limiter, Rate
from service.api.operations import Metrics
from service.api.problems import MEDIA_TYPE, Problem

log = logging.getLogger(__name__)
_ID = re.compile(rb"[\w.:-]{1,64}")
_UPLOAD = re.compile(r"/api/v1/rigs/[^/]+/experiments")
PUBLIC = Rate(per_s=50.0, burst=200)
"""Requests of one address for what needs no key: pages, description, readiness, metrics."""
GONE = 499
"""What the log and the metrics call a request whose caller went away before it was answered: nobody reads a status."""
_LARGER = "the body is larger than {:,} bytes"
_READING = ("GET", "HEAD", "OPTIONS")
_METHODS = {*_READING, "POST", "PUT", "PATCH", "DELETE", "CONNECT", "TRACE"}
"""Those that HTTP defines; whatever else a caller makes up is one method in the metrics, which are kept for good."""
_TOLD = ("who", "rig", "job", "experiment", "schedule")
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"SAMEORIGIN"),
)


class Around:
    """ASGI middleware.

    Parameters
    ----------
    app
        The application.
    metrics
        Counts requests and their time.
    max_body_bytes, max_upload_bytes
        Limits of a body, and of an experiment file.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, max_body_bytes: int, max_upload_bytes: int) -> None:
        self._app = app
        self._metrics = metrics
        self._max_body = max_body_bytes
        self._max_upload = max_upload_bytes
        self._public = Limiter(PUBLIC)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        given = headers.get(b"x-request-id", b"")
        request_id = given.decode() if _ID.fullmatch(given) else secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id
        limit = self._max_upload if _UPLOAD.fullmatch(scope["path"]) else self._max_body
        body = _Body(receive, limit)
        began = time.perf_counter()
        status = 500
        asked = scope["method"]
        if asked == "HEAD":  # as GET, without the body (RFC 9110, 9.3.2)
            scope["method"] = "GET"

        async def sending(message: Message) -> None:
            nonlocal status
            if body.exceeded and status == 500:
                return  # whatever was made of half a body: the answer is below
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message["headers"], (b"x-request-id", request_id.encode()), *_HEADERS]
            elif asked == "HEAD":
                if body.answered:
                    return
                body.answered = True
                message = {"type": "http.response.body"}
            await send(message)

        with logs.bound(request=request_id):
            try:
                if wait_s := self._wait_s(scope):
                    await _refuse(
                        sending, 429, "too many requests without a key; wait, then try again", request_id, wait_s
                    )
                elif _too_large(headers, limit):
                    await _refuse(sending, 413, _LARGER.format(limit), request_id)
                else:
                    try:
                        await self._app(scope, body.receive, sending)
                    except ClientDisconnect:  # the rest of the body never came, or was too much of it
                        if not body.exceeded and status == 500:
                            status = GONE
                    except asyncio.CancelledError:
                        # By the server, which has waited for it long enough and ends: that is no defect to be told.
                        if status == 500:
                            await _refuse(sending, 503, "the service ends; try again once it is back", request_id)
                    if body.exceeded and status == 500:
                        body.exceeded = False
                        await _refuse(sending, 413, _LARGER.format(limit), request_id)
            finally:
                self._count(scope, status, time.perf_counter() - began)

    def _wait_s(self, scope: Scope) -> float:
        """Seconds that an address has to wait for what needs no key; for the rest, the gate counts keys."""
        if scope["path"].startswith("/api/") or scope["path"] == "/healthz":
            return 0.0
        return self._public.wait_s(scope["client"][0] if scope.get("client") else "")

    def _count(self, scope: Scope, status: int, seconds: float) -> None:
        route = getattr(scope.get("route"), "path", "none")
        method = scope["method"] if scope["method"] in _METHODS else "other"
        self._metrics.requests.labels(method, route, status).inc()
        if not route.endswith("/events"):
            self._metrics.seconds.labels(method, route).observe(seconds)
        level = logging.DEBUG if scope["method"] in _READING else logging.INFO
        about = _about(scope) if log.isEnabledFor(level) else {}
        log.log(level, "%s %s %d in %.1f ms", scope["method"], scope["path"], status, 1e3 * seconds, extra=about)


def _about(scope: Scope) -> dict[str, Any]:
    """Who asked, and about which rig and job: as the audit log has it, or as the address says."""
    state = scope["state"]
    named = {name.removesuffix("_id"): value for name, value in scope.get("path_params", {}).items()}
    found = named | state.get("about", {}) | {"who": getattr(state.get("identity"), "name", None)}
    return {name: value for name, value in found.items() if value is not None and name in _TOLD}


def _too_large(headers: dict[bytes, bytes], limit: int) -> bool:
    length = headers.get(b"content-length", b"")
    return length.isdigit() and int(length) > limit


class _Body:
    """Receives no more than the limit of a body that does not tell its length."""

    def __init__(self, receive: Receive, limit: int) -> None:
        self._receive = receive
        self._limit = limit
        self._size = 0
        self.exceeded = False
        self.answered = False
        """Whether all that the caller of HEAD wants was sent: an answer that goes on for ever ends then."""

    async def receive(self) -> Message:
        """The next part; what comes after the limit is as if the caller had gone."""
        if self.exceeded or self.answered:
            return {"type": "http.disconnect"}
        message = await self._receive()
        if message["type"] == "http.request":
            self._size += len(message.get("body", b""))
            if self._size > self._limit:
                self.exceeded = True
                return {"type": "http.disconnect"}
        return message


async def _refuse(send: Send, status: int, detail: str, request_id: str, wait_s: float = 0.0) -> None:
    titles = {413: "Content Too Large", 429: "Too Many Requests", 503: "Service Unavailable"}
    body = Problem(title=titles[status], status=status, detail=detail, request_id=request_id)
    headers = [(b"content-type", MEDIA_TYPE.encode())]
    headers.append((b"retry-after", str(ceil(wait_s)).encode()) if wait_s else (b"connection", b"close"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body.model_dump_json().encode()})
