"""A controller on the far side of a bus, over any `Link`: the protocol's verbs, the lease and its heartbeat."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from drivers.controller import Capabilities, PointResult, State, Status, Tone, TripCause
from drivers.device.lease import WATCHDOG_S, drawn_token
from drivers.device.limits import check_tone
from drivers.dialogue import Dialogue, held_by
from drivers.errors import (
    BusError,
    CancelledError,
    ControllerError,
    LeaseError,
    OverdueError,
    StoppedElsewhereError,
    StopRefusedError,
    TranscriptError,
)
from drivers.heartbeat import Heartbeat
from drivers.link import LinkFactory
from drivers.objects import Outcome
from drivers.playing import Playing
from drivers.values import coded, number, numbers, whole

LINE_SHARE = 0.95
"""Of the watchdog's time, what the line may take between two heartbeats; the rest is for host and device."""
PATIENCE_S = 10.0
"""How long a call keeps trying on a bus that fails, before it raises `BusError`."""
FIRST_PATIENCE_S = 2.0
RELEASE_PATIENCE_S = 1.0
STOP_TRIES = 3
"""How often a stop that is refused is said again, for a second each, before the heartbeat is held back."""
WATCHDOG_PATIENCE_S = 2.0
"""How long a device has to end its excitation then."""


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
        self._dialogue = Dialogue(links, patience_s)
        self._heartbeat: Heartbeat | None = None
        self._command = secrets.randbelow(2**31)
        self._lost: tuple[Tone, int] | None = None
        """The last tone, and its command, when the bus failed before its result was here."""
        self._measuring = False
        self._stop_asked = threading.Event()
        self._next_token = drawn_token()
        self._own_token = self._next_token
        """Of the last lease, or the first: a stop that this host says without a lease is its own, not a stranger's."""
        try:
            self._capabilities = self._identify()
        except ControllerError:
            self._dialogue.close()
            raise
        self._playing = Playing(self._dialogue, self._capabilities, self._stop_asked)

    def _identify(self) -> Capabilities:
        v = self._dialogue.read("identity", FIRST_PATIENCE_S)
        amplitudes = self._dialogue.links.amplitudes
        self._require_fast_enough(number(v.get("watchdog_s", WATCHDOG_S)))
        return Capabilities(
            identity=str(v.get("identity", self._dialogue.links.description)),
            axes=tuple(str(v["axes"]).split()),
            sample_rate_hz=number(v["sample_rate_hz"]),
            max_amplitude_a=min(number(v["max_amplitude_a"]), amplitudes.largest_a),
            max_frequency_hz=number(v["max_frequency_hz"]),
            max_samples=whole(v["max_samples"], "identity.max_samples"),
            displacement_limit_m=number(v["displacement_limit_m"]),
            current_limit_a=number(v["current_limit_a"]),
            raw_records=bool(v["raw_records"]),
            amplitude_steps_per_a=amplitudes.steps_per_a,
            raw_bytes_per_s=self._dialogue.links.raw_bytes_per_s,
        )

    def _require_fast_enough(self, watchdog_s: float) -> None:
        """Refuse a line on which the watchdog would end every tone."""
        links = self._dialogue.links
        slower = links.silence_s / (LINE_SHARE * watchdog_s) if watchdog_s > 0 else 0.0
        if slower > 1:
            raise ControllerError(
                f"{links.description}: this line is too slow: while a tone plays, a heartbeat comes every "
                f"{1e3 * links.silence_s:.0f} ms, and {1e3 * watchdog_s:.0f} ms without one trip the controller; set a "
                f"baud at least {math.ceil(10 * slower) / 10:.1f} times as high there and in the URL"
            )

    # ---- the protocol's verbs

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""
        return self._capabilities

    def status(self) -> Status:
        """Snapshot of state, trip, excitation, lease."""
        values = self._dialogue.status()
        trip = coded(TripCause, values["trip"], "status.trip")
        n = len(self._capabilities.axes)
        return Status(
            state=coded(State, values["state"], "status.state"),
            trip=trip,
            trip_message="" if trip == TripCause.NONE else self._dialogue.trip_message(trip),
            excitation_a=number(values["excitation_a"]),
            displacement_m=numbers(values["displacement_m"])[:n],
            current_a=numbers(values["current_a"])[:n],
            lease_holder=str(values.get("lease_holder", "")),
            lease_seconds_left=number(values.get("lease_seconds_left", 0.0)),
            boot_id=whole(values.get("boot_id", 0), "status.boot_id"),
            speed_rad_s=number(values.get("speed_rad_s", 0.0)),
            uptime_s=number(values.get("uptime_s", 0.0)),
        )

    def measure(self, tone: Tone) -> PointResult:
        """Excite with one tone, wait, measure, and ramp back to zero; see the protocol.

        Asked for a tone whose result the failing bus kept back, it fetches that one: what was measured once is not
        measured again. The amplitude is what the map can carry of the one that is wanted, and the result tells it.
        """
        self._measuring = True
        self._stop_asked.clear()  # first of all: what is said from now on is meant for this tone
        self._dialogue.impatient.clear()
        try:
            self._require_lease()
            check_tone(tone, self._capabilities)
            carried_a = self._dialogue.links.amplitudes.carried(tone.amplitude_a)
            return self._measured(replace(tone, amplitude_a=carried_a))
        finally:
            self._measuring = False
            self._dialogue.impatient.clear()

    def _measured(self, tone: Tone) -> PointResult:
        try:
            point = self._kept_back(tone)
            if point is None:
                self._command = self._command % (2**32 - 1) + 1
                self._lost = (tone, self._command)
                point = self._playing.play(tone, self._command)
            self._lost = None
            return point
        except LeaseError:
            raise  # someone else's excitation is not ours to stop
        except BaseException as error:
            if not isinstance(error, BusError):
                self._lost = None
            # Whatever the reason (Ctrl-C, a lost bus): the device is told, and its watchdog does the rest.
            if self._dialogue.token:
                self._end_excitation(self._dialogue.token, error)
            raise

    def _end_excitation(self, token: int, why: BaseException) -> None:
        """Say stop, and again where it is refused; then hold the heartbeat back until the device has gone quiet.

        A stop that is accepted is believed, but not of a device whose tone is overdue: that one is looked at.

        Raises
        ------
        CancelledError
            A stop that the caller asked for was refused, or not heeded, and the watchdog did it.
        OverdueError
            A tone did not end, and the stop or the watchdog ended it.
        StopRefusedError
            The device goes on exciting for all that.
        """
        refused = self._refused_stop(token)
        overdue = isinstance(why, OverdueError)
        if refused is None and not overdue:
            return
        ended = "a stop has ended the excitation"
        if refused is not None or not self._goes_quiet():
            self._hold_back_the_heartbeat(token, refused, why)
            ended = "its watchdog has ended the excitation"
        if isinstance(why, StopRefusedError):
            raise CancelledError(f"stopped: the controller refused to; {ended}, see why it does not stop") from why
        if overdue and self._stop_asked.is_set():
            raise CancelledError(f"stopped: {why}; {ended}, see why it does not stop") from why
        if overdue:
            raise OverdueError(f"{why}; {ended}: see why it does not end its tones, or restart it") from why

    def _refused_stop(self, token: int) -> StopRefusedError | None:
        """Say stop: how it was refused to the last; None where it was heard, or the bus is down."""
        refused = None
        for _ in range(STOP_TRIES):
            try:
                self._dialogue.stop(token)
                return None
            except StopRefusedError as error:
                refused = error
            except Exception:  # the bus is down: no heartbeat reaches the device either
                return None
        return refused

    def _hold_back_the_heartbeat(self, token: int, refused: StopRefusedError | None, why: BaseException) -> None:
        """Let the watchdog end the excitation, and go on with the heartbeat once it has."""
        if self._heartbeat is not None:
            self._heartbeat.close()
        if not self._goes_quiet():
            told = refused or f"{why}; end the excitation there"
            raise StopRefusedError(f"{told}: it goes on exciting, also without a heartbeat") from why
        if self._heartbeat is not None:
            self._heartbeat = Heartbeat(self._dialogue.links.link(urgent=True), token)

    def _goes_quiet(self) -> bool:
        """Whether the device ends its excitation in time."""
        deadline = time.monotonic() + WATCHDOG_PATIENCE_S
        while time.monotonic() < deadline:
            with suppress(ControllerError):
                values = self._dialogue.status(expect_boot=False, patience_s=0.0)
                if values["outcome"] != Outcome.UNDER_WAY and not values["excitation_a"]:
                    return True
            time.sleep(0.02)
        return False

    def _kept_back(self, tone: Tone) -> PointResult | None:
        """Result of this tone, if it was played and only its result was lost.

        Raises
        ------
        StoppedElsewhereError
            The tone that was lost sight of ended because somebody else had said stop.
        TripError
            It was this tone, and it tripped.
        """
        if self._lost is None:
            return None
        outcome = self._playing.outcome(self._lost[1])
        if outcome is Outcome.STOPPED_ELSEWHERE:
            raise _stopped_out_of_sight()
        if outcome is Outcome.TRIPPED and self._lost[0] == tone:
            self._playing.require_no_trip(self._lost[1])
        return self._playing.fetch(*self._lost) if self._lost[0] == tone and outcome is Outcome.DONE else None

    def stop(self) -> None:
        """Ramp the excitation to zero; needs no lease, and goes past a transfer that is under way."""
        self._stop_asked.set()
        if self._measuring:
            self._dialogue.impatient.set()
        self._dialogue.stop(self._dialogue.token or self._own_token)

    def acknowledge(self) -> None:
        """Clear a latched trip; needs the lease."""
        token = self._require_lease()
        self._dialogue.command("acknowledge", {"token": token})

    def close(self) -> None:
        """Stop if the lease is held, and give up the link; safe twice."""
        self._release()
        self._dialogue.close()

    # ---- lease

    @contextmanager
    def lease(self, holder: str, seconds: float = 10.0) -> Iterator[None]:
        """Hold the rig; a heartbeat on its own connection renews the lease and feeds the watchdog.

        Raises
        ------
        StoppedElsewhereError
            At its end: somebody else had stopped the last tone, and the bus failed before that was heard.
        """
        if self._dialogue.token:
            raise LeaseError(self._dialogue.holder, seconds)
        try:
            self._acquire(holder, seconds)
            yield
        finally:
            if self._release():
                raise _stopped_out_of_sight()

    def _acquire(self, holder: str, seconds: float) -> None:
        to = self._dialogue
        to.boot_id = whole(to.status(expect_boot=False).get("boot_id", 0), "status.boot_id")
        self._lost = None
        token = self._next_token
        try:
            to.command("lease", {"token": token, "seconds": seconds, "holder": holder})
            to.token, to.holder = token, holder
        except BaseException as error:
            # The device may have given it before the interruption, or before its answer was lost, or has and it could
            # not be written down: it is given back.
            if isinstance(error, BusError | TranscriptError) or not isinstance(error, ControllerError):
                to.token, to.holder = token, holder
            raise
        self._own_token, self._next_token = token, drawn_token()
        self._heartbeat = Heartbeat(to.links.link(urgent=True), token)

    def _release(self) -> bool:
        """Give the lease back; whether somebody else had stopped a tone whose end was out of sight."""
        stopped = self._was_stopped_out_of_sight()
        token, self._dialogue.token = self._dialogue.token, 0
        if not token:
            return False  # closed under the lease: a word on it now would open the link again
        heartbeat, self._heartbeat = self._heartbeat, None
        try:
            # A bus that is down cannot be told; then the watchdog ends the excitation and the lease runs out.
            with suppress(ControllerError):
                self._dialogue.command("release", {"token": token}, RELEASE_PATIENCE_S)
        finally:
            if heartbeat is not None:
                heartbeat.close()
        return stopped

    def _was_stopped_out_of_sight(self) -> bool:
        """Looked up before the lease is given back: a host that does so knows of all stops, the device will think."""
        if self._lost is None or not self._dialogue.token:
            return False
        with suppress(ControllerError):
            return self._playing.outcome(self._lost[1], RELEASE_PATIENCE_S) is Outcome.STOPPED_ELSEWHERE
        return False

    def _require_lease(self) -> int:
        if not self._dialogue.token:
            raise held_by(self._dialogue.status(expect_boot=False))
        return self._dialogue.token


def _stopped_out_of_sight() -> StoppedElsewhereError:
    return StoppedElsewhereError("stopped from elsewhere while the bus was failing; the excitation is off")
