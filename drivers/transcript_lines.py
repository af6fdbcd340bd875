"""Lines of a transcript, checked when the file is read: what is damaged is told with its line, and not met later."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

from drivers.errors import BusError, ControllerError, LimitError
from drivers.objects import BY_NAME, Group, Object, Refusal, Type
from drivers.packing import check_crc, encode
from sim.errors import reason

FORMAT = "amb-transcript"
VERBS = ("read", "write", "lockin", "raw")
_REMEDY = "the file is damaged or was cut short: take a whole copy of it, or record the session anew with transcript="


def checked_lines(path: Path) -> list[dict[str, Any]]:
    """What was recorded, a line each, without the first line, which says what the file is.

    Raises
    ------
    ControllerError
        The file cannot be read, or is not a transcript; or a line lacks something: names the line.
    """
    try:
        texts = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ControllerError(f"cannot read the transcript {path}: {reason(error)}") from error
    head = _parsed(path, 1, texts[0]) if texts else None
    if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("version") != 1:
        raise ControllerError(f"{path} is not a transcript of version 1; give a file that transcript= has recorded")
    lines = []
    for number, text in enumerate(texts[1:], start=2):
        line = _parsed(path, number, text)
        if (wrong := _wrong(line)) is not None:
            raise ControllerError(f"{path}, line {number}: {wrong}; {_REMEDY}")
        lines.append(line)
    return lines


def _parsed(path: Path, number: int, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ControllerError(f"{path}, line {number}: it is no JSON; {_REMEDY}") from None


def _wrong(line: Any) -> str | None:
    """What is wrong with a line; None where it can be replayed."""
    if not isinstance(line, dict):
        return "it is no object"
    if "done" in line:
        return None if _is_count(line["done"]) else f"done is {line['done']!r} and no number"
    verb = next((v for v in VERBS if v in line), None)
    if verb is None:
        return f"it has none of {', '.join(VERBS)} or done"
    if line.get("order") not in ("big", "little"):
        return "its order is neither big nor little"
    what = line[verb]
    if verb in ("lockin", "raw"):
        if not _is_count(what):
            return f"{verb} is {what!r} and no number of bytes"
        return _wrong_outcome(line, lambda answer: None if _is_base64(answer) else "its answer is no base64")
    group = BY_NAME.get(what) if isinstance(what, str) else None
    if group is None or group.access != ("ro" if verb == "read" else "wo"):
        return f"{what!r} is nothing that one can {verb}"
    if verb == "read":
        return _wrong_outcome(line, lambda answer: _wrong_values(group, answer))
    return _wrong_values(group, line.get("values")) or _wrong_outcome(line, lambda answer: None)


def _wrong_outcome(line: dict[str, Any], wrong_answer: Any) -> str | None:
    """The same of what came of a question: an answer, a refusal or an error of the bus."""
    if "refused" in line:
        known = line["refused"] in Refusal.__members__ if isinstance(line["refused"], str) else False
        return None if known and isinstance(line.get("message"), str) else f"{line['refused']!r} is no refusal"
    if "bus_error" in line:
        return None if isinstance(line["bus_error"], str) else "its bus_error is no text"
    if "answer" not in line:
        return "it has no answer"
    wrong: str | None = wrong_answer(line["answer"])
    return wrong


def _wrong_values(group: Group, values: Any) -> str | None:
    """The same of a group's values: each that a map must have is there, and can be."""
    if not isinstance(values, dict):
        return f"it has no values of {group.name}"
    told = {}
    for obj in group.objects:
        if obj.name not in values:
            if obj.required:
                return f"{group.name}.{obj.name} is missing"
            continue
        told[obj.name] = value = _value(values[obj.name])
        if not _can_be(obj, value):
            return f"{group.name}.{obj.name} cannot be {values[obj.name]!r}"
    try:
        check_crc(group, told)
    except (BusError, KeyError):
        return f"the CRC of {group.name} does not fit its values"
    return None


def _can_be(obj: Object, value: Any) -> bool:
    if obj.type is Type.TEXT:
        return isinstance(value, str)
    numbers = value if isinstance(value, tuple) else (value,)
    if isinstance(value, tuple) != (obj.count > 1) or len(numbers) != obj.count:
        return False
    try:
        encode(obj, value)
    except (LimitError, TypeError, OverflowError, struct.error):
        return False
    return True


def _value(told: Any) -> Any:
    """A value as a link gives it: JSON has no tuples."""
    return tuple(told) if isinstance(told, list) else told


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and value >= 0


def _is_base64(answer: Any) -> bool:
    text = answer.get("base64") if isinstance(answer, dict) else None
    if not isinstance(text, str):
        return False
    try:
        base64.b64decode(text, validate=True)
    except ValueError:
        return False
    return True
