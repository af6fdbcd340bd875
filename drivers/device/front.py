"""The device's objects as a bus sees them: groups to read, groups to write, and the data of results.

What a write may do, and what it is refused for, is decided here and in `RigDevice`, the same for every bus.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from drivers.controller import PointResult, State, Tone
from drivers.device.machine import RigDevice
from drivers.errors import (
    BusError,
    BusyError,
    CancelledError,
    LeaseError,
    LimitError,
    StoppedElsewhereError,
    TripError,
)
from drivers.link import RefusedError
from drivers.objects import BY_NAME, PROTOCOL_VERSION, Outcome, Refusal
from drivers.packing import Order, Value, Values, check_crc, with_crc
from drivers.pages import paged
from drivers.payload import encode_lockin, encode_raw, payload_crc


@dataclass(frozen=True)
class _Finished:
    point: PointResult
    command: int
    boot_id: int
    lockin: bytes
    raw: bytes

    @cached_property
    def pages(self) -> bytes:
        """The raw record in pages."""
        return paged(self.point.sequence, self.raw)


class DeviceFront:
    """The objects of one device, for the servers of its buses. All methods are safe from any thread.

    Parameters
    ----------
    order
        Byte order of the payloads.
    """

    def __init__(self, device: RigDevice, order: Order) -> None:
        self.device = device
        self.order = order
        self._lock = threading.Lock()
        self._command = 0
        self._accepted = (0, 0)
        self._outcome = Outcome.DONE
        self._finished: _Finished | None = None
        self._window = 0
        self._tones: queue.SimpleQueue[tuple[Callable[[], PointResult], int] | None] = queue.SimpleQueue()
        self._player: threading.Thread | None = None
        self._listeners: list[Callable[[], None]] = []
        self._writers: dict[str, Callable[[Values], None]] = {
            "lease": self._lease,
            "release": lambda v: self.device.release(_token(v)),
            "beat": self._beat,
            "stop": lambda v: self.device.stop(_token(v)),
            "acknowledge": lambda v: self.device.acknowledge(_token(v)),
            "tone": self._tone,
            "window": self._select,
        }

    def on_change(self, listener: Callable[[], None]) -> None:
        """Call this, from the tone's thread, when a tone begins and ends."""
        self._listeners.append(listener)

    # ---- reading

    def read(self, group: str) -> dict[str, Value]:
        """Snapshot of a group, CRC included."""
        values = getattr(self, f"_read_{group}")()
        return with_crc(BY_NAME[group], values)

    def _read_identity(self) -> dict[str, Value]:
        c = self.device.capabilities()
        return {
            "protocol": PROTOCOL_VERSION,
            "boot_id": self.device.boot_id,
            "identity": c.identity,
            "axis_count": len(c.axes),
            "axes": " ".join(c.axes),
            "sample_rate_hz": c.sample_rate_hz,
            "max_amplitude_a": c.max_amplitude_a,
            "max_frequency_hz": c.max_frequency_hz,
            "max_samples": c.max_samples,
            "displacement_limit_m": c.displacement_limit_m,
            "current_limit_a": c.current_limit_a,
            "raw_records": int(c.raw_records),
            "watchdog_s": self.device.watchdog_s,
        }

    def _read_status(self) -> dict[str, Value]:
        with self._lock:
            command, outcome, finished = self._command, self._outcome, self._finished
        s = self.device.status()
        return {
            "snapshot": self.device.next_snapshot(),
            "boot_id": s.boot_id,
            "state": int(s.state),
            "trip": int(s.trip),
            "excitation_a": max(s.excitation_a, 0.0),
            "lease_seconds_left": s.lease_seconds_left,
            "command": command,
            "outcome": int(outcome),
            "result": 0 if finished is None else finished.point.sequence,
            "speed_rad_s": s.speed_rad_s,
            "uptime_s": s.uptime_s,
            "displacement_m": _clipped(s.displacement_m, 2.0),
            "current_a": _clipped(s.current_a, 2000.0),
            "lease_holder": s.lease_holder,
        }

    def _read_trip(self) -> dict[str, Value]:
        s = self.device.status()
        return {"boot_id": s.boot_id, "cause": int(s.trip), "message": s.trip_message}

    def _read_result(self) -> dict[str, Value]:
        f = self._finished
        if f is None:
            raise RefusedError(Refusal.ADDRESS, "there is no result yet")
        p, t = f.point, f.point.tone
        return {
            "boot_id": f.boot_id,
            "result": p.sequence,
            "command": f.command,
            **{name: getattr(t, name) for name in _TONE_FIELDS},
            "raw": int(t.raw),
            "peak_displacement_m": p.peak_displacement_m,
            "peak_current_a": p.peak_current_a,
            "rig_samples": round(p.rig_seconds / self.device.rig.controller.sample_time_s),
            "payload_bytes": len(f.lockin),
            "payload_crc": payload_crc(p.sequence, f.lockin),
            "raw_bytes": len(f.raw),
            "raw_crc": payload_crc(p.sequence, f.raw),
        }

    def lockin_payload(self) -> bytes:
        """Lock-in payload of the last result, empty when there is none."""
        return b"" if self._finished is None else self._finished.lockin

    def raw_record(self) -> bytes:
        """Raw record of the last result, empty when there is none."""
        return b"" if self._finished is None else self._finished.raw

    def raw_pages(self) -> bytes:
        """The same in pages."""
        return b"" if self._finished is None else self._finished.pages

    @property
    def window(self) -> int:
        """Which segment of it a host wants to see; how long one is, is the bus's affair."""
        return self._window

    # ---- writing

    def write(self, group: str, values: Values) -> None:
        """Carry out a command.

        Raises
        ------
        RefusedError
            Wrong CRC, out of limits, not the holder of the lease, busy, or a latched trip.
        """
        writer = self._writers.get(group)
        if writer is None:
            raise RefusedError(Refusal.ADDRESS, f"{group} is read-only")
        try:
            check_crc(BY_NAME[group], values)
            writer(values)
        except (LimitError, BusError) as error:
            raise RefusedError(Refusal.LIMIT, str(error)) from error
        except (LeaseError, BusyError) as error:
            raise RefusedError(Refusal.LEASE, str(error)) from error
        except TripError as error:
            raise RefusedError(Refusal.TRIPPED, str(error)) from error

    def _lease(self, values: Values) -> None:
        token = _token(values)
        if token == 0:
            raise LimitError("the token 0 means no lease")
        self.device.acquire(str(values.get("holder", "unnamed host")), _number(values["seconds"]), token=token)

    def _beat(self, values: Values) -> None:
        token = _token(values)
        if not self.device.heartbeat(token, int(_number(values["count"]))) and not self.device.holds(token):
            raise LeaseError(*self._holder())

    def _holder(self) -> tuple[str, float]:
        s = self.device.status()
        return s.lease_holder, s.lease_seconds_left

    def _tone(self, values: Values) -> None:
        command, token = int(_number(values["command"])), _token(values)
        tone = Tone(
            axis=int(_number(values["axis"])),
            amplitude_a=_number(values["amplitude_a"]),
            periods=int(_number(values["periods"])),
            samples=int(_number(values["samples"])),
            blocks=int(_number(values["blocks"])),
            settle_samples=int(_number(values["settle_samples"])),
            raw=bool(values.get("raw", 0)),
        )
        with self._lock:
            if (token, command) == self._accepted and self.device.holds(token):
                return  # the answer to this very command was lost: it has been accepted
            self._accepted = (0, 0)
            try:
                play = self.device.arm(tone, token)
            except StoppedElsewhereError:
                self._command, self._outcome = command, Outcome.STOPPED_ELSEWHERE
                self._accepted = (token, command)
                return
            self._command, self._outcome = command, Outcome.UNDER_WAY
            self._accepted = (token, command)
            if self._player is None:
                self._player = threading.Thread(target=self._play_what_comes, name="tones", daemon=True)
                self._player.start()
        # to a thread that waits: starting one would keep the bus waiting for its answer
        self._tones.put((play, command))

    def close(self) -> None:
        """No tone is played any more, after one that plays now; for whoever serves these objects, at its end."""
        self._tones.put(None)

    def _play_what_comes(self) -> None:
        while (tone := self._tones.get()) is not None:
            self._run(*tone)

    def _run(self, play: Callable[[], PointResult], command: int) -> None:
        self._tell()
        finished, outcome = None, Outcome.FAILED
        try:
            point = play()
            finished = _Finished(
                point, command, self.device.boot_id, encode_lockin(point, self.order), encode_raw(point, self.order)
            )
            outcome = Outcome.DONE
        except StoppedElsewhereError:
            outcome = Outcome.STOPPED_ELSEWHERE
        except CancelledError:
            outcome = Outcome.STOPPED
        except TripError:
            outcome = Outcome.TRIPPED
        except Exception as error:
            self.device.fault(f"the tone failed: {error}")
        with self._lock:
            self._finished = finished or self._finished
            if command == self._command:  # while this result was packed, another tone may have been accepted
                self._outcome = outcome
            self._window = 0
        self._tell()

    def _tell(self) -> None:
        for listener in self._listeners:
            listener()

    def _select(self, values: Values) -> None:
        f = self._finished
        if f is None or values["result"] != f.point.sequence:
            raise LimitError("this is not the last result")
        self._window = int(_number(values["segment"]))

    def exciting(self) -> bool:
        """Whether a tone is armed, playing or ramping down."""
        return self.device.status().state in (State.ARMED, State.SETTLING, State.RECORDING)


_TONE_FIELDS = ("axis", "amplitude_a", "periods", "samples", "blocks", "settle_samples")


def _number(value: Value) -> float:
    if isinstance(value, str | tuple):
        raise LimitError(f"{value!r} is not a number")
    return value


def _token(values: Values) -> int:
    return int(_number(values["token"]))


def _clipped(values: tuple[float, ...], limit: float) -> tuple[float, ...]:
    return tuple(min(max(v, -limit), limit) if v == v else limit for v in values)
