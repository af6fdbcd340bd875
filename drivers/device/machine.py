"""The controller of the simulated rig: state machine, lease, watchdog, limits and latched trips.

Everything that puts the rig on a bus, and the in-process driver, goes through `RigDevice`; its rules hold
for all of them. The rig levitates from the moment it is made.
"""

from __future__ import annotations

import itertools
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.controller import (
    Capabilities,
    PointResult,
    State,
    Status,
    Tone,
    TripCause,
    Waveform,
    WaveformResult,
)
from drivers.device.lease import NO_TOKEN, WATCHDOG_S, LeaseTable
from drivers.device.limits import MAX_SAMPLES, check_tone, check_waveform
from drivers.device.play import Gauges, Interruption, Pace, Player
from drivers.device.stops import Stops
from drivers.errors import (
    BusyError,
    CancelledError,
    ControllerError,
    LatchedTripError,
    LimitError,
    StoppedElsewhereError,
    TripError,
)
from sim.rig import Rig
from sim.stepping import Simulation

R = TypeVar("R", PointResult, WaveformResult)

QUIET_S = 5.0
"""So long the excitation may take to end once it was told to."""
RAMP_LOOK_S = 0.001


@dataclass(frozen=True)
class Event:
    """Something that happened on the device; ``monotonic_s`` is the machine's monotonic clock."""

    number: int
    monotonic_s: float
    text: str


class RigDevice:
    """A simulated rig with the behaviour of a real controller.

    Parameters
    ----------
    rig
        The rig as physics sees it.
    seed
        Of all noise; the same seed and the same tones give the same results.
    real_time
        Hold the rig to the wall clock, and let it run on between tones. Otherwise simulated time passes
        only while a tone is played, as fast as the machine can.
    watchdog_s
        Silence of a remote lease holder after which the excitation ramps to zero.

    on_event
        Called with every event, from the thread where it happened.
    simulation
        Of the rig, in place of one that is made here.
    identity
        What it calls itself on the bus, where that is not the rig's name.

    Raises
    ------
    LevitationError
        The rig's controller does not hold the rotor.
    """

    def __init__(
        self,
        rig: Rig,
        seed: int = 0,
        *,
        real_time: bool = False,
        watchdog_s: float = WATCHDOG_S,
        clock: Callable[[], float] = time.monotonic,
        on_event: Callable[[Event], None] | None = None,
        simulation: Simulation | None = None,
        identity: str | None = None,
    ) -> None:
        self._simulation = Simulation(rig, seed) if simulation is None else simulation
        self._rig = rig
        self._identity = identity or f"simulated rig {rig.name}"
        self._clock = clock
        self._born = clock()
        self._gauges = Gauges(State.LEVITATED, (0.0,) * rig.n_axes, (0.0,) * rig.n_axes)
        self._pace = Pace(real_time, 1 / rig.controller.sample_time_s)
        self._player = Player(self._simulation, self._gauges, self._pace, self._guard, self._latch)
        self._leases = LeaseTable(clock, watchdog_s)
        self._rig_lock = threading.Lock()
        self._state_lock = threading.Lock()
        self._playing = False
        self._play_token = 0
        # a plain flag: the lock of an Event is taken in Python code, where Ctrl-C can leave it taken for ever
        self._stop_asked = False
        self._stops = Stops()
        self._last_token = NO_TOKEN
        self._trip: Interruption | None = None
        self._sequence = 0
        self._snapshot = 0
        self._events: deque[Event] = deque(maxlen=1000)
        self._event_numbers = itertools.count(1)
        self._on_event = on_event
        self._closed = False
        self.boot_id = secrets.randbelow(2**31 - 1) + 1
        self._log("levitated")
        if real_time:
            threading.Thread(target=self._levitate, name="rig", daemon=True).start()

    # ---- what anyone may read

    @property
    def rig(self) -> Rig:
        """The rig that is simulated."""
        return self._rig

    @property
    def watchdog_s(self) -> float:
        """Silence of a remote lease holder that trips, s."""
        return self._leases.watchdog_s

    @property
    def rig_time_s(self) -> float:
        """Time that has passed on the rig, s."""
        return self._gauges.rig_time_s

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""
        rate = 1 / self._rig.controller.sample_time_s
        return Capabilities(
            identity=self._identity,
            axes=self._rig.axes,
            sample_rate_hz=rate,
            max_amplitude_a=self._rig.current_limit_a,
            max_frequency_hz=0.45 * rate,
            max_samples=MAX_SAMPLES,
            displacement_limit_m=self._rig.displacement_limit_m,
            current_limit_a=self._rig.current_limit_a,
        )

    def status(self) -> Status:
        """Snapshot; feeds no watchdog."""
        holder, left = self._leases.holder()
        trip = self._trip
        return Status(
            state=self._gauges.state,
            trip=TripCause.NONE if trip is None else trip.cause,
            trip_message="" if trip is None else trip.message,
            excitation_a=self._gauges.excitation_a,
            displacement_m=self._gauges.displacement_m,
            current_a=self._gauges.current_a,
            lease_holder=holder,
            lease_seconds_left=left,
            boot_id=self.boot_id,
            speed_rad_s=self._rig.speed_rad_s,
            uptime_s=self._clock() - self._born,
        )

    def next_snapshot(self) -> int:
        """Number of a snapshot that is sent to a host, rising: a stale one shows by it."""
        with self._state_lock:
            self._snapshot += 1
            return self._snapshot

    def events(self, after: int = 0) -> list[Event]:
        """Events with a number above ``after``, oldest first; the last thousand are kept."""
        return [event for event in list(self._events) if event.number > after]

    # ---- lease

    def acquire(self, holder: str, seconds: float = 10.0, attached: bool = False, token: int | None = None) -> int:
        """Token of a new lease; `attached` marks a holder in this process, which needs no heartbeat.

        A remote host draws the ``token`` itself, so that asking again after a lost answer is harmless.

        Raises
        ------
        LeaseError
            Another host holds the rig.
        LimitError
            No holder's name, or a time that is not between 0.1 and 3600 s.
        """
        if not holder.strip():
            raise LimitError("a lease needs the name of its holder")
        if not 0.1 <= seconds <= 3600:
            raise LimitError(f"a lease lasts 0.1 to 3600 s, not {seconds} s")
        with self._state_lock:
            renewed = token is not None and self._leases.holds(token)
            token = self._last_token = self._leases.acquire(holder, seconds, attached, token)
            if not renewed:
                self._stops.leased(holder, token)
        self._log(f"leased to {holder}")
        return token

    def release(self, token: int) -> None:
        """End a lease, and with it its excitation; nothing happens when the token does not hold the rig."""
        if self._leases.holds(token):
            self.stop(token)
            self._wait_until_quiet()
            with self._state_lock:
                released = self._leases.release(token)
                if released:
                    self._stops.known()
            if released:
                self._log("lease released")

    def heartbeat(self, token: int, count: int) -> bool:
        """Feed the watchdog; False when the token does not hold the rig or the counter stands still."""
        return self._leases.beat(token, count)

    def holds(self, token: int) -> bool:
        """Whether this token holds the rig."""
        return self._leases.holds(token)

    # ---- excitation

    def check(self, tone: Tone) -> None:
        """Refuse a tone outside the limits with `LimitError`."""
        check_tone(tone, self.capabilities())

    def arm(self, tone: Tone, token: int) -> Callable[[], PointResult]:
        """Accept a tone; what is returned must be called once, and plays it.

        Raises
        ------
        LimitError, LeaseError, TripError
            As the protocol says; nothing is excited.
        BusyError
            Another tone is armed or being played.
        StoppedElsewhereError
            Someone else has said stop, and the holder was not told yet.
        """
        self.check(tone)
        self._accept(token)
        return lambda: self._play(tone)

    def _accept(self, token: int) -> None:
        """Reserve the rig for the excitation that the holder of a lease is about to play."""
        lease = self._leases.require(token)
        with self._state_lock:
            if self._closed:
                raise ControllerError("the controller is switched off")
            if self._trip is not None:
                raise LatchedTripError(
                    self._trip.cause.name.lower(), f"a trip is latched ({self._trip.message}); acknowledge it first"
                )
            if self._playing:
                raise BusyError("the controller is playing another tone; wait until it is done, or stop it")
            if self._stops.untold:
                self._stops.tell()
                raise StoppedElsewhereError("the excitation was stopped from elsewhere")
            self._stops.known()
            self._playing = True
            self._play_token = lease.token
            self._stop_asked = False
            self._gauges.state = State.ARMED
            # After a gap on the bus, the command may come before the next heartbeat does.
            self._leases.feed(token)

    def measure(self, tone: Tone, token: int) -> PointResult:
        """Play a tone and measure it, see `drivers.controller.Controller.measure`."""
        return self.arm(tone, token)()

    def measure_periodic(self, waveform: Waveform, token: int) -> WaveformResult:
        """Play a periodic waveform on all axes and record it, see `drivers.controller.PeriodicController`.

        Raises
        ------
        LimitError, LeaseError, TripError, BusyError, StoppedElsewhereError
            As `arm` does.
        """
        check_waveform(waveform, self.capabilities())
        self._accept(token)
        self._log(f"excitation on: a waveform of {waveform.samples} samples, {waveform.peak_a:.6g} A at most")
        return self._played(lambda: self._player.play_periodic(waveform, self._sequence + 1))

    def _play(self, tone: Tone) -> PointResult:
        frequency = tone.frequency_hz(1 / self._rig.controller.sample_time_s)
        self._log(f"excitation on: {tone.amplitude_a:.6g} A at {frequency:.6g} Hz on {self._rig.axes[tone.axis]}")
        return self._played(lambda: self._player.play(tone, self._sequence + 1))

    def _played(self, play: Callable[[], tuple[R | None, Interruption | None]]) -> R:
        """Result of an excitation that was accepted, or the error that its early end is."""
        result: R | None = None
        interruption: Interruption | None = None
        elsewhere = False
        try:
            with self._rig_lock:
                result, interruption = play()
        finally:
            with self._state_lock:
                # a stop that came too late to end this excitation, or while it ended for another reason, ends the next
                if interruption is not None and interruption.cause == TripCause.NONE and self._stops.untold:
                    elsewhere = True
                    self._stops.tell()
                if interruption is None and result is not None:
                    self._sequence = result.sequence
                    self._gauges.state = State.DONE
                elif self._gauges.state in (State.ARMED, State.SETTLING, State.RECORDING):
                    self._gauges.state = State.LEVITATED
                self._play_token = 0
                self._playing = False  # last: from now on the next one may be accepted
        if interruption is None:
            assert result is not None
            return result
        self._log("excitation off")
        if elsewhere:
            raise StoppedElsewhereError("stopped from elsewhere; the excitation is off")
        if interruption.cause == TripCause.NONE:
            raise CancelledError(interruption.message)
        raise TripError(interruption.cause.name.lower(), interruption.message)

    def stop(self, token: int = NO_TOKEN) -> None:
        """Ramp the excitation to zero, whoever asks.

        Asked by anyone but the host that holds the lease, or held it last, it is kept until that host was told: it ends
        the tone that plays, or else the next one, also when the lease has lapsed before that and is taken again.

        Parameters
        ----------
        token
            Of the caller's lease, or of its last one, or of the one that it will ask for; 0 for none.
        """
        with self._state_lock:
            if self._playing:
                self._stop_asked = True
            if token == NO_TOKEN or token != self._last_token:
                self._stops.say(token)
        self._log("stop")

    def acknowledge(self, token: int) -> None:
        """Clear a latched trip; one of a tone that still ramps down, once it has.

        Raises
        ------
        LeaseError
            The token does not hold the rig.
        """
        self._leases.require(token)
        until = time.monotonic() + QUIET_S
        while self._playing and self._trip is not None and time.monotonic() < until:
            time.sleep(RAMP_LOOK_S)
        with self._state_lock:
            if self._playing:
                return
            if self._trip is not None:
                self._trip = None
                self._gauges.state = State.LEVITATED
                self._log("trip acknowledged")

    def fault(self, message: str) -> None:
        """Latch a trip from outside the loop: a part of the device failed."""
        with self._state_lock:
            self._stop_asked = True
        self._wait_until_quiet()
        self._latch(Interruption(TripCause.FAULT, message))

    def close(self) -> None:
        """Stop and switch off; safe twice."""
        self._closed = True
        self._stop_asked = True
        self._wait_until_quiet()
        self._gauges.state = State.OFF

    # ---- inside

    def _guard(self) -> Interruption | None:
        if self._stop_asked:
            return Interruption(TripCause.NONE, "stopped; the excitation is off")
        if not self._leases.holds(self._play_token):
            return Interruption(TripCause.HOST, "the lease ran out while a tone was playing; the excitation is off")
        if self._leases.silent():
            return Interruption(
                TripCause.HOST,
                f"no heartbeat of the host for {self._leases.watchdog_s * 1e3:.0f} ms; the excitation is off: "
                "reconnect, lease the rig and acknowledge",
            )
        return None

    def _latch(self, interruption: Interruption) -> None:
        self._trip = interruption
        self._gauges.state = State.TRIPPED
        self._log(f"trip {interruption.cause.name}: {interruption.message}")

    def _wait_until_quiet(self) -> None:
        if self._rig_lock.acquire(timeout=QUIET_S):
            self._rig_lock.release()

    def _levitate(self) -> None:
        while not self._closed:
            with self._rig_lock:
                self._player.idle(self._pace.chunk_samples)
            time.sleep(0)

    def _log(self, text: str) -> None:
        event = Event(next(self._event_numbers), time.monotonic(), text)
        self._events.append(event)
        if self._on_event is not None:
            self._on_event(event)
