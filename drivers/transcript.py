"""Recorded traffic: a session saved as JSON lines, and replayed as a controller, for support and regression tests.

What the measuring connection asks and gets is recorded, one object a line; heartbeats and stops are not. A replay
answers the same questions in the same order; a question that was not asked then is an error that names the line.
"""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.amplitude import Amplitudes
from drivers.errors import BusError, ControllerError, TranscriptError
from drivers.link import Link, LinkFactory, RefusedError, go_on
from drivers.objects import BY_NAME, Refusal
from drivers.packing import Order, Value, Values, encode
from drivers.transcript_lines import FORMAT, VERBS, checked_lines
from sim.errors import reason

_STEPS = "amplitude_steps_per_a"
_DRAWN_ANEW = ("token", "command", "crc", "holder")


class RecordingLinks:
    """Links whose measuring connection writes down what passes."""

    def __init__(self, links: LinkFactory, path: Path) -> None:
        self._links, self._path = links, path
        self.description, self.raw_bytes_per_s = links.description, links.raw_bytes_per_s
        self.silence_s, self.amplitudes = links.silence_s, links.amplitudes
        try:
            self._file = path.open("w", encoding="utf-8")
        except OSError as error:
            raise ControllerError(f"cannot write the transcript {path}: {reason(error)}") from error
        self._lock = threading.Lock()
        try:
            head = {"format": FORMAT, "version": 1, "controller": links.description}
            self._note(head | {_STEPS: links.amplitudes.steps_per_a})
        except TranscriptError:
            self.close()
            raise

    def link(self, urgent: bool = False) -> Link:
        """The connection; recorded unless urgent."""
        link = self._links.link(urgent)
        return link if urgent else _RecordingLink(link, self)

    def close(self) -> None:
        """Close the file and the links."""
        self._links.close()
        with self._lock, suppress(OSError):  # what could not be written then has been told
            self._file.close()

    def _note(self, line: dict[str, Any]) -> None:
        with self._lock:
            if self._file.closed:
                return
            try:
                self._file.write(json.dumps(line) + "\n")
                self._file.flush()
            except OSError as error:
                raise TranscriptError(
                    f"cannot write the transcript {self._path}: {reason(error)}; free space, or leave transcript= out"
                ) from error


class _RecordingLink:
    def __init__(self, link: Link, transcript: RecordingLinks) -> None:
        self._link = link
        self._transcript = transcript
        self.order: Order = link.order

    def read(self, group: str) -> dict[str, Value]:
        values: dict[str, Value] = self._kept({"read": group}, lambda: self._link.read(group))
        return values

    def write(self, group: str, values: Values) -> None:
        self._kept({"write": group, "values": dict(values)}, lambda: self._link.write(group, values))

    def lockin_payload(self, size: int) -> bytes:
        payload: bytes = self._kept({"lockin": size}, lambda: self._link.lockin_payload(size))
        return payload

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        raw: bytes = self._kept({"raw": size, "result": result}, lambda: self._link.raw_record(result, size, between))
        return raw

    def wait_for_change(self, seconds: float) -> int | None:
        hint = self._link.wait_for_change(seconds)
        if hint is not None:
            self._transcript._note({"done": hint})
        return hint

    def close(self) -> None:
        self._link.close()

    def _kept(self, line: dict[str, Any], call: Any) -> Any:
        line["order"] = self.order
        try:
            answer = call()
        except RefusedError as refused:
            self._transcript._note(line | {"refused": refused.refusal.name, "message": str(refused)})
            raise
        except BusError as error:
            self._transcript._note(line | {"bus_error": str(error)})
            raise
        kept = {"base64": base64.b64encode(answer).decode("ascii")} if isinstance(answer, bytes) else answer
        self._transcript._note(line | {"answer": kept})
        return answer


def replay_links(path: Path) -> _ReplayLinks:
    """Links that answer from a transcript.

    Raises
    ------
    ControllerError
        The file cannot be read, is not a transcript, or is damaged; names the line.
    """
    lines = checked_lines(path)
    steps_per_a = json.loads(path.read_text(encoding="utf-8").splitlines()[0]).get(_STEPS)
    known = isinstance(steps_per_a, int) and steps_per_a > 0  # older transcripts do not tell
    return _ReplayLinks(path, lines, Amplitudes(steps_per_a) if known else Amplitudes())


class _ReplayLinks:
    def __init__(self, path: Path, lines: list[dict[str, Any]], amplitudes: Amplitudes) -> None:
        self.description = f"replay://{path}"
        self.raw_bytes_per_s: float | None = None
        self.silence_s = 0.0
        self.amplitudes = amplitudes
        self._replay = _ReplayLink(path, lines)

    def link(self, urgent: bool = False) -> Link:
        return _SilentLink() if urgent else self._replay

    def close(self) -> None:
        pass


class _ReplayLink:
    """The measuring connection of a transcript."""

    def __init__(self, path: Path, lines: list[dict[str, Any]]) -> None:
        self._path = path
        self._lines = lines
        self._next = 0
        self._commands: dict[int, int] = {}
        self._holders: dict[str, str] = {}
        """Who held the lease then, and who does now; as a status tells them."""
        self.order: Order = next((line["order"] for line in lines if "order" in line), "big")

    def read(self, group: str) -> dict[str, Value]:
        answer = self._answer("read", group)
        values: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in answer.items()}
        if "command" in values:
            values["command"] = self._commands.get(values["command"], values["command"])
        if "lease_holder" in values:
            values["lease_holder"] = self._holders.get(values["lease_holder"], values["lease_holder"])
        return values

    def write(self, group: str, values: Values) -> None:
        line = self._line("write", group)
        then = line["values"]
        for name, value in values.items():
            if name not in _DRAWN_ANEW and then.get(name) != value:
                raise ControllerError(
                    f"{self._path}, line {self._next + 1}: {group}.{name} was {then.get(name)}, and is now {value}"
                )
        if "command" in values:
            self._commands[int(then["command"])] = int(values["command"])  # type: ignore[arg-type]
        if "holder" in values and "holder" in then:
            self._holders[_shown(then["holder"])] = _shown(values["holder"])
        self._result(line)

    def lockin_payload(self, size: int) -> bytes:
        return base64.b64decode(self._answer("lockin", size)["base64"])

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        return base64.b64decode(self._answer("raw", size)["base64"])

    def wait_for_change(self, seconds: float) -> int | None:
        if self._next < len(self._lines) and "done" in self._lines[self._next]:
            done = int(self._lines[self._next]["done"])
            self._next += 1
            return self._commands.get(done, done)
        return None

    def close(self) -> None:
        pass

    def _line(self, verb: str, what: str | int) -> dict[str, Any]:
        if self._next >= len(self._lines):
            raise ControllerError(f"{self._path} ends before this {verb} of {what}")
        line = self._lines[self._next]
        self._next += 1
        if line.get(verb) != what:
            asked = next((f"{v} {line[v]}" for v in VERBS if v in line), "nothing")
            raise ControllerError(f"{self._path}, line {self._next + 1}: recorded {asked}, and not {verb} {what}")
        return line

    def _result(self, line: dict[str, Any]) -> Any:
        if "refused" in line:
            raise RefusedError(Refusal[line["refused"]], line["message"])
        if "bus_error" in line:
            raise BusError(line["bus_error"])
        return line.get("answer")

    def _answer(self, verb: str, what: str | int) -> Any:
        return self._result(self._line(verb, what))


def _shown(holder: Value) -> str:
    """A holder's name as a status tells it: as much as an object holds."""
    return encode(BY_NAME["lease"]["holder"], holder).rstrip(b"\0").decode("utf-8")


class _SilentLink:
    """Heartbeats and stops of a replay: nobody listens."""

    order: Order = "big"

    def read(self, group: str) -> dict[str, Value]:
        raise ControllerError("a replay answers on its measuring connection only")

    def write(self, group: str, values: Values) -> None:
        pass

    def lockin_payload(self, size: int) -> bytes:
        raise ControllerError("a replay answers on its measuring connection only")

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        raise ControllerError("a replay answers on its measuring connection only")

    def wait_for_change(self, seconds: float) -> int | None:
        return None

    def close(self) -> None:
        pass
