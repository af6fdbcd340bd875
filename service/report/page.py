"""A page: one HTML file with everything in it, that opens without a network and prints."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from typing import Literal

from service.report.figure import Figure

Tone = Literal["good", "warn", "bad"]


@dataclass(frozen=True)
class Captioned:
    """A figure with the sentence under it."""

    figure: Figure
    caption: str


@dataclass(frozen=True)
class Section:
    """A part of a page: HTML text and figures in order."""

    title: str
    parts: Sequence[str | Captioned]

    @property
    def anchor(self) -> str:
        """Its place, for links."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


@dataclass(frozen=True)
class Page:
    """A whole page. ``lead`` is the sentence that says the result, ``about`` what and when."""

    title: str
    about: str
    lead: str
    tone: Tone
    notes: Sequence[str]
    sections: Sequence[Section]
    footer: str = ""

    def html(self) -> str:
        """The page as one self-contained file."""
        links = " ".join(f'<a href="#{s.anchor}">{escape(s.title)}</a>' for s in self.sections)
        notes = "".join(f'<p class="note">{escape(n)}</p>' for n in self.notes)
        body = "".join(_section(s) for s in self.sections)
        drawn = any(isinstance(p, Captioned) for s in self.sections for p in s.parts)
        scripts = f"<script>{_plotly()}</script><script>{_own('draw.js')}</script>" if drawn else ""
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            '<link rel="icon" href="data:,">'
            f"<title>{escape(self.title)}</title><style>{_own('style.css')}</style></head><body>"
            f'<header><h1>{escape(self.title)}</h1><p class="about">{escape(self.about)}</p></header>'
            f'<p class="lead {self.tone}">{escape(self.lead)}</p>{notes}<nav>{links}</nav>'
            f"<main>{body}</main><footer>{escape(self.footer)}</footer>{scripts}</body></html>\n"
        )


def _section(section: Section) -> str:
    parts = "".join(_figure(p) if isinstance(p, Captioned) else p for p in section.parts)
    return f'<section><h2 id="{section.anchor}">{escape(section.title)}</h2>{parts}</section>'


def _figure(captioned: Captioned) -> str:
    figure = captioned.figure
    data = json.dumps(figure.document(), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    style = f"height:{figure.height_px}px; --columns:{figure.columns}"
    return (
        f'<figure><div class="scroll"><div class="plot" id="{figure.name}" style="{style}"></div></div>'
        f"<figcaption>{escape(captioned.caption)}</figcaption>"
        f'<script type="application/json" id="{figure.name}-data">{data}</script></figure>'
    )


@cache
def _plotly() -> str:
    """The library as it is shipped; ``</script`` does not occur in it but within strings that are escaped."""
    return (
        (files("plotly") / "package_data" / "plotly.min.js")
        .read_text(encoding="utf-8")
        .replace("</script", "<\\/script")
    )


@cache
def _own(name: str) -> str:
    return (files("service.report") / name).read_text(encoding="utf-8")
