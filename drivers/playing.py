"""One tone on a device: ask for it, wait for its end, fetch its result and check it."""

from __future__ import annotations

import math
import threading
import time

from drivers.controller import HARMONICS, Capabilities, PointResult, Tone, TripCause
from drivers.device.lockin import ramp_samples
from drivers.dialogue import Dialogue, held_by, readable
from drivers.errors import (
    BusError,
    CancelledError,
    ControllerError,
    LatchedTripError,
    OverdueError,
    StoppedElsewhereError,
    TripError,
)
from drivers.link import Link
from drivers.objects import BY_NAME, Outcome
from drivers.packing import Values, encode
from drivers.payload import decode_lockin, decode_raw, lockin_bytes, payload_crc
from drivers.values import coded, finite, number, whole

FIRST_POLL_S, POLL_S, LONG_POLL_S = 0.001, 0.02, 0.05
STOP_AGAIN_S = 0.1
OVERDUE_S = 30.0
"""Beyond twice its length at the rig's pace, a tone has so long to end: a simulated rig compiles before its first."""
PACE_FROM_S = 1.0
"""A tone that is shorter says nothing of a rig's pace: compiling, or a bus that was away, took longer than the tone."""
SLOWEST_PACE = 10.0
"""Seconds for one of its clock that a simulated rig is granted."""
UNHEEDED_S = 5.0
"""So long a controller may go on after a stop that it accepted; to ramp the excitation down takes parts of a second."""
_ECHO = ("axis", "amplitude_a", "periods", "samples", "blocks", "settle_samples")


class Playing:
    """Plays tones on a leased device.

    Parameters
    ----------
    stop_asked
        Set while the caller wants the tone to end.
    """

    def __init__(self, dialogue: Dialogue, capabilities: Capabilities, stop_asked: threading.Event) -> None:
        self._dialogue = dialogue
        self._capabilities = capabilities
        self._stop_asked = stop_asked
        self._seconds_per_sample = 0.0
        """How fast the device was at its last tone: the clock's pace on a real one, anything on a simulated one."""
        self._pace = 1.0
        """Seconds for one of the rig's clock, at the last tone that tells; at least 1."""

    def play(self, tone: Tone, command: int) -> PointResult:
        """Result of a tone that is played under this command's number."""
        began = time.monotonic()
        if self._stop_asked.is_set():
            raise CancelledError("stopped before the tone began")
        self._start(tone, command)
        looks = self._wait(tone, command)
        played = time.monotonic() - began
        if looks == 1:
            played *= 0.7  # it was done at the first look, who knows since when
        point = self.fetch(tone, command)
        self._seconds_per_sample = played / max(point.rig_seconds * self._capabilities.sample_rate_hz, 1.0)
        if point.rig_seconds >= PACE_FROM_S:
            self._pace = min(max(played / point.rig_seconds, 1.0), SLOWEST_PACE)
        return point

    def outcome(self, command: int, patience_s: float | None = None) -> Outcome | None:
        """What became of this command; None when the device's last tone is another one."""
        values = self._dialogue.status(patience_s=patience_s)
        return coded(Outcome, values["outcome"], "status.outcome") if values["command"] == command else None

    def _start(self, tone: Tone, command: int) -> None:
        try:
            self._say(tone, command)
        except LatchedTripError:
            if self.outcome(command) is None:  # otherwise it was heard, tripped, and only the answer was lost
                raise

    def _say(self, tone: Tone, command: int) -> None:
        self._dialogue.command(
            "tone",
            {
                "token": self._dialogue.token,
                "command": command,
                "axis": tone.axis,
                "amplitude_a": tone.amplitude_a,
                "periods": tone.periods,
                "samples": tone.samples,
                "blocks": tone.blocks,
                "settle_samples": tone.settle_samples,
                "raw": int(tone.raw),
            },
        )

    def _wait(self, tone: Tone, command: int) -> int:
        """How often one had to look until the tone was done; raises when it ended otherwise.

        Raises
        ------
        OverdueError
            It did not end in its time, or not after a stop: while one waits, the heartbeat keeps the excitation on.
        """
        began = time.monotonic()
        samples = tone.settle_samples + tone.blocks * tone.samples
        expected = began + 0.9 * samples * self._seconds_per_sample
        overdue = began + 2 * self._length_s(tone) * self._pace + OVERDUE_S
        unheeded = math.inf
        stop_again = 0.0
        looks = 0
        while True:
            looks += 1
            now = time.monotonic()
            if self._stop_asked.is_set() and now >= stop_again:
                # again and again until it is seen to work: the first may have been lost
                self._dialogue.stop(self._dialogue.token)
                stop_again = now + STOP_AGAIN_S
                unheeded = min(unheeded, now + UNHEEDED_S)
            pause = max(min(expected - now, LONG_POLL_S), min(0.05 * (now - began), POLL_S), FIRST_POLL_S)
            if self._dialogue.link.wait_for_change(pause) == command:
                return looks
            values = self._dialogue.status()
            if values["command"] == command:
                if values["outcome"] != Outcome.UNDER_WAY:
                    self._judge(coded(Outcome, values["outcome"], "status.outcome"), values)
                    return looks
            else:
                if not self._dialogue.holds(values):
                    raise held_by(values)
                if self._stop_asked.is_set():
                    raise CancelledError("stopped before the tone began")
                # the answer to the command belonged to another one: say it again, under its number
                self._start(tone, command)
            now = time.monotonic()
            if now > unheeded:
                raise self._overdue(f"went on for {UNHEEDED_S:.3g} s after it was told to stop")
            if now > overdue:
                raise self._overdue(f"did not end a tone of {self._length_s(tone):.3g} s within {now - began:.3g} s")

    def _overdue(self, what: str) -> OverdueError:
        return OverdueError(f"{self._dialogue.links.description}: the controller {what}")

    def _length_s(self, tone: Tone) -> float:
        """How long a tone takes by the controller's clock, ramps and settling included, s."""
        rate = self._capabilities.sample_rate_hz
        return (2 * ramp_samples(tone, rate) + tone.settle_samples + tone.blocks * tone.samples) / rate

    def _require_no_stop(self) -> None:
        if self._stop_asked.is_set():
            raise CancelledError("stopped while the raw record was on its way; the excitation is off")

    def require_no_trip(self, command: int) -> None:
        """Raise `TripError` where this command ended in a trip that is still latched."""
        status = self._dialogue.status()
        tripped = status["command"] == command and status["outcome"] == Outcome.TRIPPED
        if tripped and status["trip"] != TripCause.NONE:
            self._judge(Outcome.TRIPPED, status)

    def _judge(self, outcome: Outcome, status: Values) -> None:
        if outcome == Outcome.STOPPED:
            raise CancelledError("stopped; the excitation is off")
        if outcome == Outcome.STOPPED_ELSEWHERE:
            raise StoppedElsewhereError("stopped from elsewhere; the excitation is off")
        if outcome == Outcome.TRIPPED:
            if status["trip"] == TripCause.NONE:  # a status that came in pieces may be from before and after
                status = self._dialogue.status()
            trip = coded(TripCause, status["trip"], "status.trip")
            raise TripError(trip.name.lower(), self._dialogue.trip_message(trip))
        if outcome == Outcome.FAILED:
            raise ControllerError("the controller failed to play the tone; its excitation is off")

    # ---- the result

    def fetch(self, tone: Tone, command: int) -> PointResult:
        """Result of a tone that is done."""
        return self._dialogue.patiently(lambda link: self._fetched(link, tone, command))

    def _fetched(self, link: Link, tone: Tone, command: int) -> PointResult:
        header = readable(lambda: link.read("result"))
        self._dialogue.require_same_boot(header)
        if header["command"] != command:
            raise BusError("the controller answered with an older result")
        if not _is_echo(tone, header):
            raise BusError("the result's header does not repeat the tone that was asked for")
        axes = len(self._capabilities.axes)
        result = whole(header["result"], "result.result")
        size = whole(header["payload_bytes"], "result.payload_bytes")
        if size not in lockin_bytes(tone, axes):
            raise BusError(f"the result has {size} bytes instead of {lockin_bytes(tone, axes)[0]}")
        payload = readable(lambda: link.lockin_payload(size))
        if payload_crc(result, payload) != header["payload_crc"]:
            raise BusError("the CRC of the result is wrong: it was corrupted on the bus")
        records = None
        if tone.raw:
            raw_bytes = whole(header["raw_bytes"], "result.raw_bytes")
            raw = readable(lambda: link.raw_record(result, raw_bytes, self._require_no_stop))
            if payload_crc(result, raw) != header["raw_crc"]:
                raise BusError("the CRC of the raw record is wrong: it was corrupted on the bus")
            records = decode_raw(raw, tone, axes, link.order)
        r, u, i, y = decode_lockin(payload, tone, axes, link.order)
        return PointResult(
            tone=tone,
            harmonics=HARMONICS,
            R=r,
            U=u,
            I=i,
            Y=y,
            peak_displacement_m=number(header["peak_displacement_m"]),
            peak_current_a=number(header["peak_current_a"]),
            rig_seconds=finite(header["rig_samples"], "result.rig_samples") / self._capabilities.sample_rate_hz,
            sequence=result,
            records=records,
        )


def _is_echo(tone: Tone, header: Values) -> bool:
    group = BY_NAME["tone"]
    return all(encode(group[f], header[f]) == encode(group[f], getattr(tone, f)) for f in _ECHO)
