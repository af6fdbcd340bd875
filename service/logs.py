"""Logs: one line an event, JSON or for a console, with the ids of job, rig and request, and without secrets.

Modules log as everywhere: ``logging.getLogger(__name__)``, with ``extra={...}`` for fields. Whoever begins the work
on something says so with `bound`, and every line below it carries the ids.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from typing import Any, Literal, TextIO

import structlog

from service.access.keys import KEY

HIDDEN = "***"
SECRET_NAMES = re.compile(
    r"(?i)(secret|password|passwd|authorization|cookie|private_?key|api_?key|(?<!public_)token|signature)"
)
"""Fields of these names are never shown, whatever they hold."""
_PATTERNS: tuple[tuple[re.Pattern[str], str], ...] = (
    (KEY, rf"ambit_\1_{HIDDEN}"),
    (re.compile(r"(?i)\b(bearer|basic)\s+[\w.~+/=-]{4,}"), rf"\1 {HIDDEN}"),
    (re.compile(r"(://[^\s:/@\"']*:)[^\s@\"']+(?=@)"), rf"\1{HIDDEN}"),  # the password in a URL
    (
        re.compile(r"(?i)\b((?:[\w-]*(?:password|passwd|secret|token))[\"']?\s*[=:]\s*[\"']?)(?!\*)[^\s\"'&,;)}\]]+"),
        rf"\1{HIDDEN}",
    ),
    (re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(-----END [A-Z ]*PRIVATE KEY-----|$)", re.DOTALL), HIDDEN),
)
NOISY = dict.fromkeys(("httpx", "httpcore", "alembic", "pymodbus", "dbos"), logging.WARNING)
"""Libraries that tell more than an operator wants to know."""


def redacted(text: str) -> str:
    """Text with everything struck out that looks like a secret.

    >>> redacted("postgresql://ambit:hush@db/ambit refused")
    'postgresql://ambit:***@db/ambit refused'
    >>> redacted("Authorization: Bearer abcdefgh")
    'Authorization: Bearer ***'
    """
    for pattern, instead in _PATTERNS:
        text = pattern.sub(instead, text)
    return text


def configure(level: str = "info", form: Literal["console", "json"] = "console", stream: TextIO | None = None) -> None:
    """Send every log of this process, libraries' too, to ``stream`` (stderr) in one form.

    Parameters
    ----------
    level
        debug, info, warning or error.
    form
        json for a collector, console for a person.
    """
    stream = stream or sys.stderr
    shared: list[Callable[..., Any]] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.ExtraAdder(),
        structlog.processors.TimeStamper(fmt="iso", utc=True, key="time"),
        structlog.processors.StackInfoRenderer(),
    ]
    if form == "json":
        last: list[Callable[..., Any]] = [
            structlog.processors.format_exc_info,
            structlog.processors.EventRenamer("message"),
            structlog.processors.JSONRenderer(ensure_ascii=False, default=str),
        ]
    else:
        last = [
            structlog.dev.ConsoleRenderer(  # a traceback without values: pages of numbers, and secrets among them
                colors=stream.isatty(), timestamp_key="time", exception_formatter=structlog.dev.plain_traceback
            )
        ]
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        _OneLine(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, _plain, _hide_by_name, *last],
        )
    )
    root = logging.getLogger()
    for old in root.handlers[:]:
        if isinstance(old.formatter, _OneLine):
            root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name, least in NOISY.items():
        logging.getLogger(name).setLevel(max(least, root.level))
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        own = logging.getLogger(name)  # these bring handlers of their own
        own.handlers.clear()
        own.propagate = True
    logging.captureWarnings(True)


@contextmanager
def bound(**ids: str | None) -> Iterator[None]:
    """Let every line of this context carry ids: ``with bound(job=job_id, rig=rig_id):``.

    Follows the context into tasks and ``asyncio.to_thread``, not into bare threads.
    """
    with structlog.contextvars.bound_contextvars(**{k: v for k, v in ids.items() if v is not None}):
        yield


def bound_ids() -> Mapping[str, Any]:
    """The ids that hold here, to carry them into another thread or process."""
    return dict(structlog.contextvars.get_contextvars())


class _OneLine(structlog.stdlib.ProcessorFormatter):
    """The last hand on every line: whatever came before, no secret leaves here."""

    def format(self, record: logging.LogRecord) -> str:
        return redacted(super().format(record))


def _plain(_: Any, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Without the second copy of a message that uvicorn adds for terminals."""
    event.pop("color_message", None)
    return event


def _hide_by_name(_: Any, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    return {k: _hidden(k, v) for k, v in event.items()}


def _hidden(name: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _hidden(str(k), v) for k, v in value.items()}
    if isinstance(value, list | tuple) and not SECRET_NAMES.search(name):
        return [_hidden("", v) for v in value]
    if SECRET_NAMES.search(name) and value not in (None, ""):
        return HIDDEN
    return redacted(value) if isinstance(value, str) else value  # before it is quoted, as a pattern expects it
