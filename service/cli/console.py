"""Where a command says what it found and how far it is: results on stdout, progress on stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
"""Option of every command that prints a result."""
_WHOLE = 10_000


def stderr() -> Console:
    """Console for progress and remarks."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def stdout() -> Console:
    """Console for results that a person reads; into a pipe or a file nothing is cut to the width of a terminal."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else _WHOLE)


def print_json(document: dict[str, Any]) -> None:
    """A result on stdout as JSON and nothing else."""
    from service.output import json_text

    sys.stdout.write(json_text(document))
