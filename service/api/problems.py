"""Errors as application/problem+json (RFC 9457): one vocabulary for all, the same words as on the command line."""

from __future__ import annotations

import errno
import logging
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import DataError, IntegrityError, SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match

from drivers.errors import BusError, ControllerError, LeaseError
from service.access.errors import ForbiddenError, RateError, UnauthorisedError
from service.api import identifiers
from service.errors import ConflictError, NotFoundError, StorageError
from service.uploads.errors import UploadError
from sim.errors import AmbError, reason

log = logging.getLogger(__name__)
MEDIA_TYPE = "application/problem+json"
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""What a disk says that takes no more,"""
FULL = ("database or disk is full", "No space left on device")
"""and what SQLite and PostgreSQL say of it."""


class Problem(BaseModel):
    """What went wrong, for a program (status, type) and for a person (title, detail)."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "about:blank",
                    "title": "Not Found",
                    "status": 404,
                    "detail": "there is no rig 'rig_0'; list them at /api/v1/rigs",
                    "request_id": "9f2c1f0e",
                }
            ]
        }
    )

    type: str = "about:blank"
    title: str
    status: int
    detail: str = ""
    errors: list[dict[str, Any]] = Field(default_factory=list)
    """Fields of the request that are wrong."""
    request_id: str = ""


class PreconditionError(AmbError):
    """If-Match names another version than the one there is."""


class PreconditionRequiredError(AmbError):
    """A change was sent without the version that it changes."""


class TooLargeError(AmbError):
    """The body is larger than the limit."""


class MediaTypeError(AmbError):
    """The body is of a type that is not taken here."""


class UnprocessableError(AmbError):
    """The request is well formed, but means nothing here."""


class UnknownQueryError(AmbError):
    """Query parameters were sent that the address does not know."""

    def __init__(self, unknown: list[str], known: list[str]) -> None:
        knows = f"it knows {', '.join(known)}" if known else "it knows none"
        many = "s" if len(unknown) > 1 else ""
        super().__init__(f"unknown query parameter{many} {', '.join(map(repr, unknown))} at this address; {knows}")
        self.fields = [{"field": f"query.{name}", "reason": f"unknown; {knows}"} for name in unknown]


class UnavailableError(AmbError):
    """A part of the service is away."""


_STATUS: tuple[tuple[type[Exception], int], ...] = (
    (NotFoundError, 404),
    (ConflictError, 409),
    (LeaseError, 409),
    (UnauthorisedError, 401),
    (ForbiddenError, 403),
    (RateError, 429),
    (PreconditionError, 412),
    (PreconditionRequiredError, 428),
    (TooLargeError, 413),
    (MediaTypeError, 415),
    (BusError, 503),
    (UnavailableError, 503),
    (StorageError, 503),
    (ControllerError, 409),
    (AmbError, 422),
)


def status_of(error: Exception) -> int:
    """HTTP status of an error of the product."""
    if isinstance(error, UploadError):
        return error.status
    return next(status for kind, status in _STATUS if isinstance(error, kind))


def problem(
    request: Request, status: int, detail: str, errors: list[dict[str, Any]] | None = None, headers: Any = None
) -> Response:
    """A problem as a response."""
    body = Problem(
        title=HTTPStatus(status).phrase,
        status=status,
        detail=detail,
        errors=errors or [],
        request_id=request.scope.get("state", {}).get("request_id", ""),
    )
    return JSONResponse(body.model_dump(exclude_defaults=False), status, headers=headers, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Answer every error of an application with a problem; nothing waits there, so that it needs no thread."""
    app.add_exception_handler(AmbError, _amb_error)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(IntegrityError, _collision)
    app.add_exception_handler(DataError, _unkept)
    app.add_exception_handler(SQLAlchemyError, _database)
    app.add_exception_handler(OSError, _machine)
    app.add_exception_handler(Exception, _defect)


async def _amb_error(request: Request, error: Exception) -> Response:
    status = status_of(error)
    headers: dict[str, str] = {}
    if isinstance(error, RateError):
        headers["Retry-After"] = str(max(1, round(error.retry_after_s + 0.5)))
    elif status == 503:
        headers["Retry-After"] = "2"
    elif status == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="ambit"'
    fields = error.fields if isinstance(error, UnknownQueryError) else None
    return problem(request, status, str(error), fields, headers)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    if isinstance(error.body, bytes):  # what says that it is no JSON is not read
        return problem(request, 415, "the body is not said to be JSON; send Content-Type: application/json")
    if (unknown := _unknown(request, error)) is not None:
        return problem(request, 404, unknown)
    found = [{"field": ".".join(str(p) for p in e["loc"]), "reason": _reason(e)} for e in error.errors()]
    first = f"{found[0]['field']}: {found[0]['reason']}" if found else "the request is not valid"
    return problem(request, 422, first, found)


def _reason(wrong: dict[str, Any]) -> str:
    """What is wrong with a field; a pattern for ids is told in words, which nobody has to decipher."""
    asked = identifiers.WORDS.get(wrong.get("ctx", {}).get("pattern", ""))
    if asked is None:
        return str(wrong["msg"])
    if wrong["loc"][-1] == "after":
        return f"{asked}, the field `next` of the page before; {wrong['input']!r} is none"
    return f"{asked}; {wrong['input']!r} is none"


def _unknown(request: Request, error: RequestValidationError) -> str | None:
    """That there is no thing of such an id, which is none: nobody reads a pattern to find that out."""
    first = error.errors()[0]
    where, name = (*first["loc"], "")[:2]
    if where != "path" or not name.endswith("_id") or not first["type"].startswith("string_"):
        return None
    kind = name.removesuffix("_id")
    listed = request.scope["route"].path_format.partition("/{")[0]
    how = "with ambit jobs, or " if kind == "job" else ""
    return f"there is no {kind} {first['input']!r}; list them {how}at {listed}"


async def _http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    detail = error.detail if error.detail != HTTPStatus(error.status_code).phrase else ""
    if error.status_code == 404 and not detail:
        detail = "there is nothing at this address; the addresses are in /openapi.json"
    elif error.status_code == 405 and not detail:
        detail = f"{request.method} means nothing at this address; what does is in /openapi.json"
    headers = error.headers
    if error.status_code == 405:
        headers = {"Allow": ", ".join(_methods(request))}
    return problem(request, error.status_code, detail, headers=headers)


def _methods(request: Request) -> list[str]:
    """Methods that an address takes; a router tells those of one route only."""
    found = [
        method
        for method in ("DELETE", "GET", "PATCH", "POST", "PUT")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in request.app.routes)
    ]
    return sorted([*found, "HEAD"] if "GET" in found else found)


async def _collision(request: Request, error: Exception) -> Response:
    log.warning("two requests collided: %s", str(error).splitlines()[0])
    return problem(request, 409, "another request changed the same thing at the same time; read it and try again")


async def _unkept(request: Request, error: Exception) -> Response:
    log.warning("the database cannot keep a value: %s", str(error).splitlines()[0])
    return problem(request, 422, "the request holds a value that the database cannot keep: too long, or too large")


async def _database(request: Request, error: Exception) -> Response:
    log.error("the database does not answer: %s", str(error).splitlines()[0])
    headers = {"Retry-After": "2"}
    if any(words in str(error) for words in FULL):
        return problem(request, 503, "the database's disk is full; free space there, then try again", headers=headers)
    return problem(request, 503, "the database does not answer; try again in a moment", headers=headers)


async def _machine(request: Request, error: Exception) -> Response:
    assert isinstance(error, OSError)
    if error.errno not in NO_ROOM:
        return await _defect(request, error)
    log.error("the service's machine cannot keep what a request sent or made: %s", error)
    detail = f"the service's machine cannot write: {reason(error)}; free space there, then try again"
    return problem(request, 503, detail, headers={"Retry-After": "60"})


async def _defect(request: Request, error: Exception) -> Response:
    log.exception("a request met a defect", exc_info=error)
    return problem(request, 500, "the service met an error of its own; report it with the request_id and the log")


_PHRASES = {
    400: "The request is not HTTP or JSON as it should be",
    401: "The key is missing, unknown, expired or revoked",
    403: "The key's scope does not reach so far",
    404: "There is no such resource",
    405: "The resource does not know this method",
    409: "The state of the resource does not allow it",
    412: "If-Match names another version",
    413: "The body is larger than the limit",
    415: "The body is of another type",
    422: "The request means nothing here",
    428: "A change needs If-Match",
    429: "Too many requests",
    503: "A part of the service is away; try again",
}


Documented = dict[int | str, dict[str, Any]]
"""Responses of a route for OpenAPI, by status."""


def documented(*statuses: int) -> Documented:
    """Responses of a route for OpenAPI: these, and those that every route can give."""
    return {
        status: {"description": _PHRASES[status], "content": {MEDIA_TYPE: {"schema": _REFERENCE}}}
        for status in sorted({400, 401, 403, 422, 429, 503, *statuses})
    }


_REFERENCE = {"$ref": "#/components/schemas/Problem"}
