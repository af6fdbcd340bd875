"""The page at the root, and its files. They hold no data: what they show they ask of the API, with the caller's key."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Response
from fastapi import Path as InPath

from service import web
from service.api import etags
from service.api.problems import documented
from service.api.shapes import IfNoneMatch
from service.errors import NotFoundError

router = APIRouter(tags=["page"], include_in_schema=False)
AcceptEncoding = Annotated[str, Header(max_length=1000)]


@router.get("/")
def page(if_none_match: IfNoneMatch = None, accept_encoding: AcceptEncoding = "") -> Response:
    """The page."""
    return _page("index.html", if_none_match, accept_encoding)


@router.get("/docs")
def docs(if_none_match: IfNoneMatch = None, accept_encoding: AcceptEncoding = "") -> Response:
    """The description of the API for a person; it needs no other server, as a commissioning PC has none."""
    return _page("docs.html", if_none_match, accept_encoding)


@router.get("/web/{name}", responses=documented(404))
def file(
    name: Annotated[str, InPath(max_length=60)], if_none_match: IfNoneMatch = None, accept_encoding: AcceptEncoding = ""
) -> Response:
    """A file of the page."""
    if name in web.PAGES:
        raise NotFoundError("the pages are at / and /docs")
    return _answer(name, if_none_match, accept_encoding)


def _page(name: str, if_none_match: str | None, accept_encoding: str) -> Response:
    response = _answer(name, if_none_match, accept_encoding)
    response.headers["Content-Security-Policy"] = web.POLICY
    return response


def _answer(name: str, if_none_match: str | None, accept_encoding: str) -> Response:
    found = web.asset(name)
    if found is None:
        raise NotFoundError(f"the page has no file {name!r}")
    packed = "gzip" in accept_encoding
    tag = f"{found.tag}-gz" if packed else found.tag
    content = found.compressed if packed else found.content
    response = etags.content_response(content, found.media_type, tag, if_none_match)
    response.headers["Vary"] = "Accept-Encoding"
    if packed and response.status_code == 200:
        response.headers["Content-Encoding"] = "gzip"
    return response
