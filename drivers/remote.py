"""A controller on the far side of a bus, over any `Link`: retries, lease and heartbeat, restarts, checked results."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

from drivers.controller import HARMONICS, Capabilities, PointResult, State, Status, Tone, TripCause
from drivers.device.limits import check_tone
from drivers.errors import (
    BusError,
    CancelledError,
    ControllerError,
    LeaseError,
    LimitError,
    RestartError,
    TripError,
)
from drivers.heartbeat import Heartbeat
from drivers.link import Link, LinkFactory, RefusedError
from drivers.objects import BY_NAME, Outcome, Refusal
from drivers.packing import Value, Values, encode
from drivers.payload import decode_lockin, decode_raw, lockin_bytes, payload_crc

T = TypeVar("T")

PATIENCE_S = 10.0
"""How long a call keeps trying on a bus that fails, before it raises `BusError`."""
FIRST_PATIENCE_S = 2.0
REFUSALS_BELIEVED = 4
"""A refusal that nothing explains is asked for again this often: it may have been a corrupted frame."""
POLL_S = 0.02


class RemoteController:
    """Controller behind a bus.

    Parameters
    ----------
    links
        Connections to the device.
    patience_s
        How long a call keeps trying on a failing bus.

    Raises
    ------
    BusError
        Nothing answers.
    """

    def __init__(self, links: LinkFactory, patience_s: float = PATIENCE_S) -> None:
        self._links = links
        self._patience_s = patience_s
        self._link: Link = links.link()
        self._lock = threading.RLock()
        self._urgent: Link = links.link(urgent=True)
        self._urgent_lock = threading.Lock()
        self._token = 0
        self._holder = ""
        self._heartbeat: Heartbeat | None = None
        self._command = secrets.randbelow(2**31)
        self._snapshot: tuple[int, int] = (0, 0)
        self._stop_asked = threading.Event()
        self._boot_id = 0
        self._measuring = False
        try:
            self._capabilities = self._identify(FIRST_PATIENCE_S)
        except ControllerError:
            self._shut()
            raise

    # ---- the protocol's verbs

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""
        return self._capabilities

    def status(self) -> Status:
        """Snapshot of state, trip, excitation, lease."""
        values = self._status()
        trip = TripCause(int(_number(values["trip"])))
        message = ""
        if trip != TripCause.NONE:
            message = self._trip_message(trip)
        n = len(self._capabilities.axes)
        return Status(
            state=State(int(_number(values["state"]))),
            trip=trip,
            trip_message=message,
            excitation_a=_number(values["excitation_a"]),
            displacement_m=_numbers(values["displacement_m"])[:n],
            current_a=_numbers(values["current_a"])[:n],
            lease_holder=str(values.get("lease_holder", "")),
            lease_seconds_left=_number(values.get("lease_seconds_left", 0.0)),
            boot_id=int(_number(values.get("boot_id", 0))),
            speed_rad_s=_number(values.get("speed_rad_s", 0.0)),
            uptime_s=_number(values.get("uptime_s", 0.0)),
        )

    @contextmanager
    def lease(self, holder: str, seconds: float = 10.0) -> Iterator[None]:
        """Hold the rig; a heartbeat on its own connection renews the lease and feeds the watchdog."""
        self._acquire(holder, seconds)
        try:
            yield
        finally:
            self._release()

    def measure(self, tone: Tone) -> PointResult:
        """Excite with one tone, wait, measure, and ramp back to zero; see the protocol."""
        self._require_lease()
        check_tone(tone, self._capabilities)
        self._stop_asked.clear()
        self._command = self._command % (2**32 - 1) + 1
        try:
            self._measuring = True
            self._start(tone, self._command)
            self._wait(tone, self._command)
            return self._fetch(tone, self._command)
        except LeaseError:
            raise  # someone else's excitation is not ours to stop
        except BaseException:
            # Whatever the reason (Ctrl-C, a lost bus): the device is told, and its watchdog does the rest.
            if self._token:
                with suppress(Exception):
                    self._send_stop(self._token)
            raise
        finally:
            self._measuring = False

    def stop(self) -> None:
        """Ramp the excitation to zero; needs no lease, and goes past a transfer that is under way."""
        self._stop_asked.set()
        self._send_stop(self._token)

    def acknowledge(self) -> None:
        """Clear a latched trip; needs the lease."""
        token = self._require_lease()
        self._command_group("acknowledge", {"token": token})

    def close(self) -> None:
        """Stop if the lease is held, and give up the link; safe twice."""
        if self._token:
            self._release()
        self._shut()

    # ---- lease

    def _acquire(self, holder: str, seconds: float) -> None:
        if self._token:
            raise LeaseError(self._holder, seconds)
        self._boot_id = int(_number(self._status(expect_boot=False).get("boot_id", 0)))
        token = secrets.randbelow(2**32 - 1) + 1
        self._command_group("lease", {"token": token, "seconds": seconds, "holder": holder})
        self._token, self._holder = token, holder
        self._heartbeat = Heartbeat(self._links.link(urgent=True), token)

    def _release(self) -> None:
        token, self._token = self._token, 0
        heartbeat, self._heartbeat = self._heartbeat, None
        try:
            # A bus that is down cannot be told; then the watchdog ends the excitation and the lease runs out.
            with suppress(ControllerError):
                self._patiently(lambda link: link.write("release", {"token": token}), 1.0)
        finally:
            if heartbeat is not None:
                heartbeat.close()

    def _require_lease(self) -> int:
        if not self._token:
            values = self._status(expect_boot=False)
            raise LeaseError(str(values.get("lease_holder", "")), _number(values.get("lease_seconds_left", 0.0)))
        return self._token

    # ---- a tone

    def _start(self, tone: Tone, command: int) -> None:
        self._command_group(
            "tone",
            {
                "token": self._token,
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

    def _wait(self, tone: Tone, command: int) -> None:
        """Return when the tone is done; raise when it ended otherwise."""
        stop_again = 0.0
        pause = 0.001
        while True:
            if self._stop_asked.is_set() and time.monotonic() >= stop_again:
                # again and again until it is seen to work: the first may have been lost
                self._send_stop(self._token)
                stop_again = time.monotonic() + 0.1
            if self._link.wait_for_change(pause) == command:
                return
            pause = min(2 * pause, POLL_S)
            values = self._status()
            if values["command"] == command and values["outcome"] != Outcome.UNDER_WAY:
                self._judge(Outcome(int(_number(values["outcome"]))), values)
                return
            if values["command"] != command:
                if not self._holds(values):
                    raise LeaseError(
                        str(values.get("lease_holder", "")), _number(values.get("lease_seconds_left", 0.0))
                    )
                if self._stop_asked.is_set():
                    raise CancelledError("stopped before the tone began")
                # the answer to the command belonged to another one: say it again, under its number
                self._start(tone, command)

    def _judge(self, outcome: Outcome, values: Values) -> None:
        if outcome == Outcome.STOPPED:
            raise CancelledError("stopped; the excitation is off")
        if outcome == Outcome.TRIPPED:
            trip = TripCause(int(_number(values["trip"])))
            raise TripError(trip.name.lower(), self._trip_message(trip))
        if outcome == Outcome.FAILED:
            raise ControllerError("the controller failed to play the tone; its excitation is off")

    def _holds(self, values: Values) -> bool:
        return "lease_holder" not in values or values["lease_holder"] == self._wire_holder()

    def _wire_holder(self) -> str:
        return encode(BY_NAME["lease"]["holder"], self._holder).rstrip(b"\0").decode("utf-8")

    def _fetch(self, tone: Tone, command: int) -> PointResult:
        axes = len(self._capabilities.axes)

        def fetch(link: Link) -> PointResult:
            header = _read(link, "result")
            self._same_boot(header)
            if header["command"] != command:
                raise BusError("the controller answered with an older result")
            if not _is_echo(tone, header):
                raise BusError("the result's header does not repeat the tone that was asked for")
            number = int(_number(header["result"]))
            size = int(_number(header["payload_bytes"]))
            if size not in lockin_bytes(tone, axes):
                raise BusError(f"the result has {size} bytes instead of {lockin_bytes(tone, axes)[0]}")
            payload = _data(lambda: link.lockin_payload(size))
            if payload_crc(number, payload) != header["payload_crc"]:
                raise BusError("the CRC of the result is wrong: it was corrupted on the bus")
            records = None
            if tone.raw:
                raw_size = int(_number(header["raw_bytes"]))
                raw = _data(lambda: link.raw_record(number, raw_size))
                if payload_crc(number, raw) != header["raw_crc"]:
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
                peak_displacement_m=_number(header["peak_displacement_m"]),
                peak_current_a=_number(header["peak_current_a"]),
                rig_seconds=_number(header["rig_samples"]) / self._capabilities.sample_rate_hz,
                sequence=number,
                records=records,
            )

        return self._patiently(fetch)

    # ---- talking

    def _patiently(self, action: Callable[[Link], T], patience_s: float | None = None) -> T:
        """Result of an action, tried again with growing pauses while the bus fails."""
        deadline = time.monotonic() + (self._patience_s if patience_s is None else patience_s)
        pause = 0.005
        while True:
            try:
                with self._lock:
                    return action(self._link)
            except BusError as error:
                if time.monotonic() + pause > deadline:
                    raise BusError(f"{self._links.description}: {error}") from error
                self._raise_if_stopped()
                time.sleep(pause)
                pause = min(2 * pause, 0.5)

    def _raise_if_stopped(self) -> None:
        if self._measuring and self._stop_asked.is_set():
            raise CancelledError("stopped while the bus was failing; the controller's watchdog ends the excitation")

    def _command_group(self, group: str, values: dict[str, Value]) -> None:
        """Write a command; a refusal is explained from the status, or believed when it is repeated."""
        for attempt in range(REFUSALS_BELIEVED):
            try:
                self._patiently(lambda link: link.write(group, values))
                return
            except RefusedError as refused:
                self._explain(refused)
                if attempt == REFUSALS_BELIEVED - 1:
                    raise _as_error(refused) from refused
                time.sleep(0.005 * 4**attempt)

    def _explain(self, refused: RefusedError) -> None:
        """Raise what the device's status says about a refusal, if it says anything."""
        values = self._status()
        trip = TripCause(int(_number(values["trip"])))
        if refused.refusal is Refusal.TRIPPED and trip != TripCause.NONE:
            raise TripError(
                trip.name.lower(), f"a trip is latched ({self._trip_message(trip)}); acknowledge it first"
            ) from refused
        holder = str(values.get("lease_holder", ""))
        mine = self._token != 0 and self._holds(values)
        if refused.refusal is Refusal.LEASE and not mine and (self._token or holder):
            raise LeaseError(holder, _number(values.get("lease_seconds_left", 0.0))) from refused

    def _status(self, expect_boot: bool = True) -> dict[str, Value]:
        def fresh(link: Link) -> dict[str, Value]:
            values = _read(link, "status")
            boot, snapshot = int(_number(values.get("boot_id", 0))), int(_number(values.get("snapshot", 0)))
            if "snapshot" in values and boot == self._snapshot[0] and snapshot <= self._snapshot[1]:
                raise BusError("the controller answered with an older status")
            self._snapshot = (boot, snapshot)
            return values

        values = self._patiently(fresh)
        if expect_boot and self._token:
            self._same_boot(values)
        return values

    def _same_boot(self, values: Values) -> None:
        if self._boot_id and "boot_id" in values and values["boot_id"] != self._boot_id:
            raise RestartError(
                f"{self._links.description}: the controller restarted while it was leased; the excitation is off and "
                "nothing of before is valid: take the lease again"
            )

    def _trip_message(self, trip: TripCause) -> str:
        message = str(self._patiently(lambda link: _read(link, "trip")).get("message", ""))
        return message or f"the controller tripped: {trip.name.lower()}"

    def _send_stop(self, token: int) -> None:
        deadline = time.monotonic() + 1.0
        while True:
            try:
                with self._urgent_lock:
                    self._urgent.write("stop", {"token": token})
                return
            except RefusedError:
                pass
            except BusError as error:
                if time.monotonic() > deadline:
                    raise BusError(
                        f"{self._links.description}: {error}; without heartbeat the controller stops by itself"
                    ) from error
            if time.monotonic() > deadline:
                return
            time.sleep(0.01)

    def _identify(self, patience_s: float) -> Capabilities:
        v = self._patiently(lambda link: _read(link, "identity"), patience_s)
        return Capabilities(
            identity=str(v.get("identity", self._links.description)),
            axes=tuple(str(v["axes"]).split()),
            sample_rate_hz=_number(v["sample_rate_hz"]),
            max_amplitude_a=_number(v["max_amplitude_a"]),
            max_frequency_hz=_number(v["max_frequency_hz"]),
            max_samples=int(_number(v["max_samples"])),
            displacement_limit_m=_number(v["displacement_limit_m"]),
            current_limit_a=_number(v["current_limit_a"]),
            raw_records=bool(v["raw_records"]),
        )

    def _shut(self) -> None:
        for link in (self._link, self._urgent):
            with suppress(Exception):
                link.close()
        with suppress(Exception):
            self._links.close()


def _read(link: Link, group: str) -> dict[str, Value]:
    """Snapshot of a group. What may be read is never refused by a device of ours: then the bus is at fault."""
    try:
        return link.read(group)
    except RefusedError as refused:
        raise BusError(f"reading {group} was refused: {refused}") from refused


def _data(read: Callable[[], bytes]) -> bytes:
    """The same for a result's data."""
    try:
        return read()
    except RefusedError as refused:
        raise BusError(f"reading data was refused: {refused}") from refused


def _is_echo(tone: Tone, header: Values) -> bool:
    fields = ("axis", "amplitude_a", "periods", "samples", "blocks", "settle_samples")
    group = BY_NAME["tone"]
    return all(encode(group[f], header[f]) == encode(group[f], getattr(tone, f)) for f in fields)


def _as_error(refused: RefusedError) -> ControllerError:
    if refused.refusal is Refusal.LIMIT:
        return LimitError(f"the controller refused a value: {refused}")
    return ControllerError(f"the controller refused: {refused}")


def _number(value: Value) -> float:
    if isinstance(value, str | tuple):
        raise BusError(f"{value!r} came where a number was expected")
    return value


def _numbers(value: Value) -> tuple[float, ...]:
    if isinstance(value, str):
        raise BusError(f"{value!r} came where numbers were expected")
    return value if isinstance(value, tuple) else (value,)
