"""Exports on disk: the format follows from the ending, and a file appears whole or not at all."""

from __future__ import annotations

import contextlib
import io
import json
import os
import warnings
from pathlib import Path
from typing import Any

from service.exports import linear, matlab, responses, tables, universal
from service.exports.errors import ExportError
from service.exports.linear import Linear
from service.exports.responses import Responses
from service.output import json_text, write_text

LINEAR_ENDINGS = (".json", ".csv", ".mat")
RESPONSE_ENDINGS = (".json", ".csv", ".mat", ".uff", ".unv")
MAT_TEXT, MAT_TEXT_BYTES = b"MATLAB 5.0 MAT-file, written by ambit", 116
"""What a MATLAB file begins with, in words."""


def write_linear(path: Path, model: Linear) -> Path:
    """Write a model: .json, .csv or .mat.

    Raises
    ------
    ExportError
        Another ending.
    OutputError
        It cannot be written.
    """
    match path.suffix.lower():
        case ".json":
            return write_text(path, json_text(linear.document(model)))
        case ".csv":
            return write_text(path, tables.linear_csv(model))
        case ".mat":
            return _write_bytes(path, _mat(matlab.linear_variables(model)))
    raise ExportError(f"a model cannot be written as {path.name}; its ending must be one of {_words(LINEAR_ENDINGS)}")


def read_linear(path: Path) -> Linear:
    """Read a model back.

    Raises
    ------
    ExportError
        It cannot be read, or is no model.
    """
    match path.suffix.lower():
        case ".json":
            return linear.from_document(_json(path))
        case ".csv":
            return tables.linear_from_csv(_text(path))
        case ".mat":
            return matlab.linear_from_variables(_loaded(path))
    raise ExportError(f"a model cannot be read from {path.name}; its ending must be one of {_words(LINEAR_ENDINGS)}")


def write_responses(path: Path, found: list[Responses]) -> list[Path]:
    """Write responses: one file a response, its number in the name when there are several; all in one .uff.

    Raises
    ------
    ExportError
        Another ending.
    OutputError
        It cannot be written.
    """
    ending = path.suffix.lower()
    if ending in (".uff", ".unv"):
        return [_write_bytes(path, universal.content(found))]
    if ending not in RESPONSE_ENDINGS:
        raise ExportError(
            f"a response cannot be written as {path.name}; its ending must be one of {_words(RESPONSE_ENDINGS)}"
        )
    written = []
    for k, r in enumerate(found):
        target = path if len(found) == 1 else path.with_name(f"{path.stem}-{k + 1}{path.suffix}")
        if ending == ".json":
            written.append(write_text(target, json_text(responses.document(r))))
        elif ending == ".csv":
            written.append(write_text(target, tables.responses_csv(r)))
        else:
            written.append(_write_bytes(target, _mat(matlab.response_variables(r))))
    return written


def read_responses(path: Path) -> list[Responses]:
    """Read responses back.

    Raises
    ------
    ExportError
        It cannot be read, or holds no response.
    """
    match path.suffix.lower():
        case ".json":
            return [responses.from_document(_json(path))]
        case ".csv":
            return [tables.responses_from_csv(_text(path))]
        case ".mat":
            return [matlab.responses_from_variables(_loaded(path))]
        case ".uff" | ".unv":
            return universal.from_datasets(_universal_sets(path))
    raise ExportError(
        f"a response cannot be read from {path.name}; its ending must be one of {_words(RESPONSE_ENDINGS)}"
    )


def _mat(variables: dict[str, Any]) -> bytes:
    from scipy.io import savemat

    out = io.BytesIO()
    save: Any = savemat  # its stubs know no open file
    save(out, variables, do_compression=True)
    # in place of the time at which it was written: the same content is the same file, and has the same ETag
    return MAT_TEXT.ljust(MAT_TEXT_BYTES) + out.getvalue()[MAT_TEXT_BYTES:]


def _loaded(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    if not path.exists():  # scipy tries it with another ending, and tells of neither
        raise ExportError(f"cannot read {path}: No such file or directory")
    try:
        found: dict[str, Any] = loadmat(path)
    except OSError as error:
        raise ExportError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # scipy raises whatever a broken file leads it to
        raise ExportError(f"cannot read {path}: it is no MATLAB file that scipy can read ({error})") from error
    return found


def _universal_sets(path: Path) -> list[dict[str, Any]]:
    import pyuff

    if not path.is_file():
        raise ExportError(f"cannot read {path}: no such file")
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = pyuff.UFF(str(path))
            wanted = [k for k, kind in enumerate(file.get_set_types()) if int(kind) == 58]
            return [file.read_sets(k) for k in wanted]
    except Exception as error:  # pyuff raises whatever a broken file leads it to
        raise ExportError(f"cannot read {path}: it is no universal file that pyuff can read ({error})") from error


def _write_bytes(path: Path, content: bytes) -> Path:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise _cannot_write(path, error) from error
    return path


def _cannot_write(path: Path, error: OSError) -> Exception:
    from service.errors import OutputError

    return OutputError(f"cannot write {path}: {error.strerror or error}; free space or choose another folder")


def _text(path: Path) -> str:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise ExportError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(_text(path))
    except ValueError as error:
        if isinstance(error, ExportError):
            raise
        raise ExportError(f"cannot read {path}: it is no JSON ({error})") from error
    if not isinstance(found, dict):
        raise ExportError(f"{path} holds no document")
    return found


def _words(endings: tuple[str, ...]) -> str:
    return ", ".join(endings)
