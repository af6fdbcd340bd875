"""ETags: a caller that has the newest version is not sent it again, and changes only what it has read."""

from __future__ import annotations

from hashlib import sha256
from typing import Any

from fastapi import Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from service.api.problems import Documented, PreconditionError, PreconditionRequiredError, documented
from service.storage.blobs import Blobs

REVALIDATE = "private, no-cache"
JSON, HTML = "application/json", "text/html; charset=utf-8"


def quoted(tag: str) -> str:
    """A strong ETag."""
    return f'"{tag}"'


def of_content(content: bytes) -> str:
    """Tag of a content that has no version of its own."""
    return sha256(content).hexdigest()[:32]


def matches(header: str | None, tag: str) -> bool:
    """Whether If-Match or If-None-Match names the tag."""
    if header is None:
        return False
    wanted = {part.strip().removeprefix("W/") for part in header.split(",")}
    return "*" in wanted or quoted(tag) in wanted


def require_match(header: str | None, tag: str, version: str = "") -> None:
    """Refuse a change of another version than the one there is.

    ``version`` is what all tags of one version begin with, where a tag also tells what changes by itself.

    Raises
    ------
    PreconditionRequiredError
        There is no If-Match.
    PreconditionError
        It names another version.
    """
    if header is None:
        raise PreconditionRequiredError(f"send If-Match: {quoted(tag)}, the ETag of the version that you have read")
    same = bool(version) and any(quoted(version)[:-1] in part for part in header.split(","))
    if not (same or matches(header, tag)):
        raise PreconditionError(f"this was changed since you read it; its ETag is {quoted(tag)}: read it again")


def documented_resource(content: dict[str, Any] | None = None, description: str = "") -> Documented:
    """Responses of a route that gives one thing with its ETag, for OpenAPI; a content that is no model is described."""
    whole: Documented = {} if content is None else {200: {"description": description, "content": content}}
    return documented(404) | {304: {"description": "Not changed"}} | whole


def documented_list(*statuses: int) -> Documented:
    """Responses of a route that gives a page of a list, and others that it can give."""
    return documented(*statuses) | {304: {"description": "Not changed"}}


def documented_json(description: str, example: dict[str, Any]) -> Documented:
    """Responses of a route that gives a document that is no model."""
    return documented_resource({JSON: {"example": example}}, description)


def documented_page() -> Documented:
    """Responses of a route that gives a stored report."""
    return documented_resource({"text/html": {"schema": {"type": "string"}}}, "The report")


def document(
    shape: BaseModel | dict[str, Any], if_none_match: str | None = None, tag: str | None = None, status: int = 200
) -> Response:
    """A document with its ETag: the tag given, or one of its content; 304 when the caller has it."""
    content = shape.model_dump_json().encode() if isinstance(shape, BaseModel) else bytes(JSONResponse(shape).body)
    return content_response(content, JSON, tag or of_content(content), if_none_match, status)


def content_response(
    content: bytes,
    media_type: str,
    tag: str,
    if_none_match: str | None = None,
    status: int = 200,
    cache: str = REVALIDATE,
    filename: str | None = None,
) -> Response:
    """Bytes with an ETag; 304 when the caller has them."""
    headers = {"ETag": quoted(tag), "Cache-Control": cache}
    if matches(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    if filename is not None:
        headers["Content-Disposition"] = f'attachment; filename="{filename}"'
    return Response(content, status, headers, media_type)


def stored(blobs: Blobs, digest: str, media_type: str, if_none_match: str | None) -> Response:
    """A file of the store, whose ETag is its digest; 304 when the caller has it, and then nothing is read."""
    content = b"" if matches(if_none_match, digest) else blobs.read(digest)
    return content_response(content, media_type, digest, if_none_match)
