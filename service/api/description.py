"""The description of the API, OpenAPI: what FastAPI makes of the routes, and what only we know of their answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from service.api import problems
from service.api.resources import options
from service.api.shapes import Shape, Wanted

_TEXT = {"type": "string"}


def _header(description: str, schema: dict[str, Any] | None = None, required: bool = False) -> dict[str, Any]:
    return {"description": description, "schema": schema or _TEXT, "required": required}


REQUEST_ID = _header(
    "Id of the request: the one that was sent, or a new one. Logs, audit log and problems carry it.", required=True
)
ETAG = _header("Version of what is sent: for If-None-Match and If-Match.", required=True)
LOCATION = _header("Address of what was made.", required=True)
REPLAYED = _header(
    "Sent when this Idempotency-Key was used before: this is the first answer.", {"type": "string", "const": "true"}
)
RETRY_AFTER = _header("Seconds after which it is worth trying again.", {"type": "integer", "minimum": 1})
AUTHENTICATE = _header("How to show a key.")


def described(app: FastAPI) -> dict[str, Any]:
    """The description, with our problems in place of FastAPI's own errors, options of jobs and headers of answers."""
    if app.openapi_schema:
        return app.openapi_schema
    found = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas["Problem"] = problems.Problem.model_json_schema()
    schemas |= options.schemas()
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for name, examples in (*_examples(Shape), *_examples(Wanted)):
        if name in schemas:
            schemas[name]["examples"] = examples
    for operations in found["paths"].values():
        for operation in operations.values():
            _with_headers(operation)
    app.openapi_schema = found
    return found


def _examples(shape: type[BaseModel]) -> Iterator[tuple[str, Any]]:
    """Examples of all shapes of a kind, as they are written: FastAPI leaves out what is null in them."""
    for one in shape.__subclasses__():
        extra = one.model_config.get("json_schema_extra")
        if isinstance(extra, dict) and "examples" in extra:
            yield one.__name__, extra["examples"]
        yield from _examples(one)


def _with_headers(operation: dict[str, Any]) -> None:
    """Tell the headers of an operation's answers: they follow from its own headers and from the status."""
    sent = {p["name"].lower() for p in operation.get("parameters", ()) if p["in"] == "header"}
    for status, response in operation["responses"].items():
        headers = {"X-Request-Id": REQUEST_ID}
        if status in ("200", "304") and sent & {"if-none-match", "if-match"}:
            headers["ETag"] = ETAG
        if status in ("201", "202") and "idempotency-key" in sent:
            headers |= {"Location": LOCATION, "Idempotent-Replayed": REPLAYED}
        if status in ("429", "503"):
            headers["Retry-After"] = RETRY_AFTER
        if status == "401":
            headers["WWW-Authenticate"] = AUTHENTICATE
        response["headers"] = headers | response.get("headers", {})
