"""The page that the service shows at its root: plain HTML, CSS and JavaScript, served as they are."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files

MEDIA = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
}
PAGES = ("index.html", "docs.html")
ASSETS = ("style.css", "main.js", "api.js", "confirm.js", "docs.js", "dom.js", "plots.js", "rig.js", "tables.js")
PLOTLY = "plotly.min.js"
REPORT_STYLE = "report.css"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy of the page: nothing but its own files; the plots set styles of their own."""


@dataclass(frozen=True)
class Asset:
    """A file of the page."""

    content: bytes
    compressed: bytes
    """The same by gzip."""
    media_type: str
    tag: str


@cache
def asset(name: str) -> Asset | None:
    """A file by its name; None when the page has no such file."""
    if name in PAGES or name in ASSETS:
        place = files("service.web") / name
    elif name == REPORT_STYLE:
        place = files("service.report") / "style.css"
    elif name == PLOTLY:
        place = files("plotly") / "package_data" / PLOTLY
    else:
        return None
    content = place.read_bytes()
    ending = name[name.rindex(".") :]
    return Asset(content, gzip.compress(content, 6, mtime=0), MEDIA[ending], sha256(content).hexdigest()[:32])
