"""Results on disk: a folder that is proven writable before anything starts, and files that appear whole."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.errors import DocumentError, OutputError

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError


def ready_folder(folder: Path, mode: int = 0o777) -> Path:
    """The folder, made where it does not exist, and proven to be writable.

    Parameters
    ----------
    mode
        Of the folder where it is made.

    Raises
    ------
    OutputError
        It cannot be made or written.
    """
    probe = folder / f".write-test.{os.getpid()}"
    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
        try:
            probe.write_bytes(b"x")
        finally:  # on a full disk the file is made, and the writing fails
            probe.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot write to {folder}: {error.strerror or error}; nothing was started: choose another folder"
        ) from error
    return folder


@contextmanager
def results_in(folder: Path) -> Iterator[Path]:
    """The folder, ready as by `ready_folder`; one that was made for it goes again where an error leaves it empty.

    Raises
    ------
    OutputError
        It cannot be made or written.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    ready_folder(folder)
    try:
        yield folder
    except BaseException:
        for path in made:  # the innermost first
            try:
                path.rmdir()
            except OSError:  # something lies in it
                break
        raise


def write_text(path: Path, text: str) -> Path:
    """Write a file in one piece: a reader sees the old one or the new one. Of a link, what it leads to is written.

    What is no file, as a device or a pipe, is written to as it is.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    whole = Path(os.path.realpath(path))
    temporary = whole.with_name(f".{whole.name}.{os.getpid()}.tmp")
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding="utf-8")
            return path
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, whole)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OutputError(
            f"cannot write {path}: {error.strerror or error}; free space or choose another folder"
        ) from error
    return path


def json_text(document: dict[str, Any], indent: int | None = 1) -> str:
    """A document as JSON, numbers as Python writes them, nothing that is not a number.

    Parameters
    ----------
    indent
        None for what programs alone read: one line, written twice as fast.
    """
    return json.dumps(document, indent=indent, allow_nan=False, ensure_ascii=False) + "\n"


def read_document(path: Path, expected_format: str, shape: type[BaseModel] | None = None) -> dict[str, Any]:
    """A JSON document of this product.

    Parameters
    ----------
    shape
        The fields that are read, with their types: the document is checked, and has no others then.

    Raises
    ------
    DocumentError
        The file cannot be read, is no JSON, is of another format or version, or is not of the shape.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise DocumentError(f"cannot read {path}: {reason}; give the path of a file that ambit wrote") from error
    found = document.get("format") if isinstance(document, dict) else None
    if found != expected_format or document.get("version") != 1:
        raise DocumentError(f"{path} is no {expected_format} of version 1 (its format is {found!r}); give another file")
    return dict(document) if shape is None else whole(document, shape, str(path))


def whole(document: Any, shape: type[BaseModel], what: str) -> dict[str, Any]:
    """The fields of a document that a shape names, once they are known to be of it.

    Parameters
    ----------
    what
        Where it is from, as told to whoever gave it.

    Raises
    ------
    DocumentError
        A field is missing or wrong: the first one is named.
    """
    from pydantic import ValidationError

    try:
        return shape.model_validate(document).model_dump()
    except ValidationError as error:
        raise DocumentError(f"{what} is damaged, it {first_problem(error)}; give it as ambit wrote it") from error


def first_problem(error: ValidationError) -> str:
    """What is wrong with a document, to go on a sentence that begins with it: the first of its fields that is."""
    problem = error.errors(include_url=False, include_input=False)[0]
    said = problem["msg"].removeprefix("Value error, ").partition(" or instance of ")[0]
    where = ".".join(map(str, problem["loc"]))
    if problem["type"] == "missing":
        return f'has no "{where}"'
    return f'has a wrong "{where}": {said}' if where else f"is not whole: {said}"
