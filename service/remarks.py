"""What a process says beside its results: remarks on stderr, each one line."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """One remark on stderr."""
    print(text, file=sys.stderr, flush=True)


def one_line(text: str) -> str:
    r"""The text without line breaks: an error is one line, whatever a library wrote.

    >>> one_line("cannot read\n  the file")
    'cannot read the file'
    """
    return " ".join(text.split())
