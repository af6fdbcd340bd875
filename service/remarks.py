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


def shown(text: str) -> str:
    r"""The text with a mark for each half of a character and for all that a terminal would obey.

    >>> shown("a\x1b[31mb\u202e")
    'a�[31mb�'
    """
    return "".join(c if can_be_shown(c) else "\N{REPLACEMENT CHARACTER}" for c in text)


def can_be_shown(letter: str) -> bool:
    """Whether it is neither half a character nor what a terminal would obey."""
    return letter.isprintable() or letter in "\t\n" or (letter.isspace() and letter > "\x9f")
