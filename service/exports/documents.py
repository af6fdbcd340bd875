"""What every JSON document of an export says of itself, and what is wrong with one that is not whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from service.exports.errors import ExportError

VERSION = 1


@contextmanager
def reading(found: Mapping[str, Any], format: str, what: str) -> Iterator[None]:
    """While a document is read that shall be of this format: whatever it lacks becomes one sentence.

    Raises
    ------
    ExportError
        It is of another format or version, or not whole.
    """
    if found.get("format") != format or found.get("version") != VERSION:
        raise ExportError(f"this is no {format} of version {VERSION} (its format is {found.get('format')!r})")
    try:
        yield
    except ExportError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ExportError(f"the {what} is not whole: {type(error).__name__} {error}") from error
