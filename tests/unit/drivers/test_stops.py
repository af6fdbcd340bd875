"""Somebody says stop: whenever that is, the rotor is not excited again before the host that excites it was told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import pytest

from drivers.amplitude import Amplitudes
from drivers.controller import Tone, TripCause
from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.device.play import Interruption
from drivers.device.stops import KEPT, Stops
from drivers.errors import (
    BusError,
    CancelledError,
    LeaseError,
    OverdueError,
    StoppedElsewhereError,
    StopRefusedError,
    TripError,
)
from drivers.link import RefusedError
from drivers.objects import BY_NAME, Outcome, Refusal
from drivers.packing import Value, Values, with_crc
from drivers.remote import RemoteController
from drivers.simulated.driver import SimulatedController
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
LONG = Tone(axis=0, amplitude_a=0.02, periods=3000, samples=1_900_000, blocks=1)


class _Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> _Clock:
    return _Clock()


@pytest.fixture
def device(clock: _Clock) -> Iterator[RigDevice]:
    device = RigDevice(reference_rig(), seed=1, clock=clock, watchdog_s=60.0)
    yield device
    device.close()


def _after_playing(device: RigDevice, monkeypatch: pytest.MonkeyPatch, do: Callable[[], None]) -> None:
    """Have something happen when the next tone has been played, before anybody knows that it has."""
    play = device._player.play

    def late(tone: Tone, sequence: int) -> object:
        result = play(tone, sequence)
        monkeypatch.setattr(device._player, "play", play)
        do()
        return result

    monkeypatch.setattr(device._player, "play", late)


def _while_exciting(device: RigDevice, do: Callable[[], None]) -> threading.Thread:
    def wait() -> None:
        while device.status().excitation_a == 0:
            time.sleep(0.001)
        do()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


def test_stop_in_a_tone_s_last_instant_ends_the_next_one(device: RigDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    token = device.acquire("host", attached=True)
    _after_playing(device, monkeypatch, device.stop)
    assert device.measure(TONE, token).tone == TONE
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, token)
    device.measure(TONE, token)


def test_own_stop_in_a_tone_s_last_instant_does_not(device: RigDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    token = device.acquire("host", attached=True)
    _after_playing(device, monkeypatch, lambda: device.stop(token))
    assert [device.measure(TONE, token).tone for _ in range(2)] == [TONE, TONE]


def test_stop_after_a_lapsed_lease_is_told_to_the_host_that_comes_back(device: RigDevice, clock: _Clock) -> None:
    device.measure(TONE, device.acquire("job", 5.0))
    clock.now += 6.0
    device.stop()
    again = device.acquire("job", 5.0)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, again)
    device.measure(TONE, again)


def test_stop_between_two_leases_is_told_to_the_host_that_comes_back(device: RigDevice) -> None:
    device.release(device.acquire("job"))
    device.stop()
    other = device.acquire("another job")
    device.measure(TONE, other)  # was not meant
    device.release(other)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, device.acquire("job"))


def test_stop_is_not_forgotten_when_the_lease_is_given_back_before_the_next_tone(device: RigDevice) -> None:
    token = device.acquire("job")
    device.stop()
    device.release(token)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, device.acquire("job"))


def test_stop_is_not_forgotten_when_the_lease_is_asked_for_once_more(device: RigDevice) -> None:
    """The answer to the first time was lost on the bus."""
    device.acquire("job", token=7)
    device.stop()
    device.acquire("job", token=7)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, 7)


def test_stop_at_the_moment_of_a_trip_outlives_the_trip(device: RigDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    token = device.acquire("host", attached=True)
    latch = device._player._latch

    def stopped_too(interruption: Interruption) -> None:
        latch(interruption)
        device.stop()

    monkeypatch.setattr(device._player, "_latch", stopped_too)
    with pytest.raises(TripError):
        device.measure(Tone(axis=0, amplitude_a=5.9, periods=1, samples=200), token)
    device.acknowledge(token)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, token)


def test_host_that_vanishes_before_it_knows_of_a_stop_is_told_again(device: RigDevice, clock: _Clock) -> None:
    token = device.acquire("job", 5.0)
    stranger = _while_exciting(device, device.stop)
    with pytest.raises(StoppedElsewhereError):  # an answer that the host never got
        device.measure(LONG, token)
    stranger.join()
    clock.now += 6.0
    again = device.acquire("job", 5.0)
    with pytest.raises(StoppedElsewhereError):
        device.measure(TONE, again)
    device.release(again)  # now it knows
    device.measure(TONE, device.acquire("job", 5.0))


def test_fault_of_the_device_is_a_trip_and_no_stop_of_a_stranger(device: RigDevice) -> None:
    token = device.acquire("host", attached=True)
    device.fault("sensor supply lost")
    device.acknowledge(token)
    assert device.measure(TONE, token).tone == TONE


def test_own_stop_without_a_lease_is_not_a_stranger_s(device: RigDevice) -> None:
    """A host that is not sure says stop before it begins and after it has ended."""
    device.release(device.acquire("job"))
    controller = SimulatedController(device)
    for _ in range(2):
        controller.stop()
        with controller.lease("job"):
            assert controller.measure(TONE).tone == TONE
        controller.stop()


def test_hosts_of_long_ago_are_forgotten() -> None:
    stops = Stops()
    for k in range(KEPT + 1):
        stops.leased(f"job {k}", k)
    stops.say(0)
    stops.leased("job 1", 1000)
    assert stops.untold
    stops.leased("job 0", 1001)
    assert not stops.untold


# ---- over a bus


class _Bus:
    """The objects of a device, and connections to them that fail while ``down``."""

    description = "test bus"
    order = "big"
    raw_bytes_per_s = None
    silence_s = 0.0
    amplitudes = Amplitudes()

    def __init__(self, device: RigDevice) -> None:
        self.front = DeviceFront(device, "big")
        self.down = threading.Event()
        self.before: Callable[[str], None] = lambda group: None

    def link(self, urgent: bool = False) -> _Bus:
        return self

    def read(self, group: str) -> dict[str, Value]:
        self._carry(group)
        return self.front.read(group)

    def write(self, group: str, values: Values) -> None:
        self._carry(group)
        self.front.write(group, with_crc(BY_NAME[group], values))

    def lockin_payload(self, size: int) -> bytes:
        return self.front.lockin_payload()

    def raw_record(self, result: int, size: int, between: Callable[[], None]) -> bytes:
        return self.front.raw_record()

    def wait_for_change(self, seconds: float) -> int | None:
        time.sleep(seconds)
        return None

    def close(self) -> None:
        pass

    def _carry(self, group: str) -> None:
        self.before(group)
        if self.down.is_set():
            raise BusError("no answer")


@pytest.fixture
def bus() -> Iterator[_Bus]:
    device = RigDevice(reference_rig(), seed=1, watchdog_s=60.0)
    bus = _Bus(device)
    yield bus
    bus.front.close()
    device.close()


def _cut_off_and_stopped(bus: _Bus, controller: RemoteController) -> None:
    """A tone of the controller that somebody else stops while the bus is down."""

    def happens() -> None:
        bus.down.set()
        bus.front.device.stop()

    stranger = _while_exciting(bus.front.device, happens)
    with pytest.raises(BusError):
        controller.measure(LONG)
    stranger.join()
    while bus.front.exciting():
        time.sleep(0.001)
    bus.down.clear()


def test_stop_that_a_failing_bus_kept_back_is_heard_at_the_next_try(bus: _Bus) -> None:
    controller = RemoteController(bus, patience_s=0.05)
    with controller.lease("job"):
        _cut_off_and_stopped(bus, controller)
        with pytest.raises(StoppedElsewhereError, match="while the bus was failing"):
            controller.measure(LONG)
        controller.measure(TONE)


def test_stop_that_a_failing_bus_kept_back_is_heard_at_the_end_of_the_lease(bus: _Bus) -> None:
    controller = RemoteController(bus, patience_s=0.05)
    with pytest.raises(StoppedElsewhereError, match="while the bus was failing"), controller.lease("job"):
        _cut_off_and_stopped(bus, controller)
        raise BusError("gives up")


def test_own_stop_before_the_tone_is_accepted_keeps_it_from_being_played(bus: _Bus) -> None:
    controller = RemoteController(bus, patience_s=0.05)
    with controller.lease("job"):
        lost = threading.Event()

        def stop_then(group: str) -> None:
            if group == "status" and not lost.is_set():  # looked at between a lost tone and the next one
                lost.set()
                controller.stop()

        with suppress(BusError):
            bus.before = lambda group: bus.down.set() if group == "result" else None
            controller.measure(TONE)
        bus.down.clear()
        bus.before = stop_then
        with pytest.raises(CancelledError, match="before the tone began"):
            controller.measure(LONG)
        assert lost.is_set()


def test_lease_whose_heartbeat_cannot_begin_is_given_back(bus: _Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(urgent: bool = False) -> _Bus:
        raise KeyboardInterrupt

    controller = RemoteController(bus, patience_s=0.05)
    with monkeypatch.context() as patch:
        patch.setattr(bus, "link", interrupted)
        with pytest.raises(KeyboardInterrupt), controller.lease("job"):
            pass
    assert bus.front.device.status().lease_holder == ""
    with controller.lease("job"):
        assert controller.measure(TONE).tone == TONE


# ---- a stop that is refused


@pytest.fixture
def refusing(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., tuple[_Bus, RemoteController]]]:
    """Makes a controller that refuses so many stops, and whose tone is interrupted from the keyboard."""
    monkeypatch.setattr("drivers.dialogue.STOP_PATIENCE_S", 0.1)
    made: list[_Bus] = []

    def make(refusals: float, watchdog_s: float = 0.2) -> tuple[_Bus, RemoteController]:
        bus = _Bus(RigDevice(reference_rig(), seed=1, watchdog_s=watchdog_s))
        made.append(bus)
        counted = {"stop": 0}

        def before(group: str) -> None:
            if group == "status" and bus.front.device.status().excitation_a and not counted["stop"]:
                raise KeyboardInterrupt
            if group == "stop":
                counted["stop"] += 1
                if counted["stop"] <= refusals:
                    raise RefusedError(Refusal.LIMIT, "Modbus exception 3")

        bus.before = before
        return bus, RemoteController(bus, patience_s=0.05)

    yield make
    for bus in made:
        bus.before = lambda group: None
        bus.front.device.stop()
        bus.front.close()
        bus.front.device.close()


def test_a_stop_that_is_refused_for_a_while_is_said_until_it_is_heard(refusing) -> None:
    bus, controller = refusing(refusals=15, watchdog_s=60.0)  # longer than one stop is tried
    with controller.lease("job"):
        with pytest.raises(KeyboardInterrupt):
            controller.measure(LONG)
        while bus.front.exciting():
            assert bus.front.device._stop_asked, "it was not told to stop"
            time.sleep(0.001)


def test_what_refuses_every_stop_is_ended_by_its_watchdog_before_the_tone_is_given_up(refusing) -> None:
    bus, controller = refusing(refusals=1e9)
    with pytest.raises(KeyboardInterrupt), controller.lease("job"):
        try:
            controller.measure(LONG)
        finally:
            assert not bus.front.exciting()
            assert bus.front.device.status().trip is TripCause.HOST
            controller.acknowledge()
            bus.before = lambda group: None
            assert controller.measure(TONE).tone == TONE, "the heartbeat is back"


def test_a_device_whose_tone_is_over_is_not_quiet_while_it_still_excites(
    refusing, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus, controller = refusing(refusals=1e9)
    read = bus.read

    def over(group: str) -> dict[str, Value]:
        values = read(group)
        return values | {"outcome": int(Outcome.TRIPPED)} if values.get("excitation_a") else values

    monkeypatch.setattr(bus, "read", over)
    with controller.lease("job"):
        with pytest.raises(KeyboardInterrupt):
            controller.measure(LONG)
        assert bus.front.device.status().excitation_a == 0
        controller.acknowledge()


def test_a_stop_that_was_asked_for_and_refused_ends_as_a_stop_once_the_watchdog_has_acted(refusing) -> None:
    bus, controller = refusing(refusals=1e9)
    refuse = bus.before
    bus.before = lambda group: refuse(group) if group == "stop" else None
    asked = _while_exciting(bus.front.device, lambda: controller._stop_asked.set())
    told = "the controller refused to; its watchdog has ended the excitation"
    with pytest.raises(CancelledError, match=told), controller.lease("job"):
        controller.measure(LONG)
    asked.join()
    assert not bus.front.exciting()


def test_a_rotor_that_stays_excited_for_all_that_is_told_as_that(refusing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.remote.WATCHDOG_PATIENCE_S", 0.3)
    _, controller = refusing(refusals=1e9, watchdog_s=60.0)
    with (
        pytest.raises(StopRefusedError, match="end the excitation there: it goes on"),
        controller.lease("job"),
    ):
        controller.measure(LONG)


# ---- a tone that does not end

SHORT = Tone(axis=0, amplitude_a=0.02, periods=10, samples=2000, blocks=1)
"""Of 0.2 s, and ramps of 40 ms each."""


@pytest.fixture
def stuck(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., tuple[_Bus, RemoteController]]]:
    """Makes a controller that goes on with a short tone for minutes, and hears stops as its argument says."""
    monkeypatch.setattr("drivers.playing.OVERDUE_S", 0.3)
    monkeypatch.setattr("drivers.playing.UNHEEDED_S", 0.3)
    monkeypatch.setattr("drivers.remote.WATCHDOG_PATIENCE_S", 1.0)
    made: list[_Bus] = []

    def make(heeds: bool, watchdog_s: float = 0.2) -> tuple[_Bus, RemoteController]:
        device = RigDevice(reference_rig(), seed=1, watchdog_s=watchdog_s, real_time=True)
        bus = _Bus(device)
        made.append(bus)
        arm = device.arm
        monkeypatch.setattr(device, "arm", lambda tone, token: arm(LONG, token))
        if not heeds:
            monkeypatch.setattr(device, "stop", lambda token=0: None)
        return bus, RemoteController(bus, patience_s=0.05)

    yield make
    for bus in made:
        bus.front.device._stop_asked = True
        bus.front.close()
        bus.front.device.close()


def test_a_tone_that_does_not_end_is_stopped_and_told_with_the_controller(stuck) -> None:
    bus, controller = stuck(heeds=True)
    told = (
        r"test bus: the controller did not end a tone of 0\.28 s within .* s; a stop has ended the excitation: see why"
    )
    with controller.lease("job"):
        with pytest.raises(OverdueError, match=told):
            controller.measure(SHORT)
        assert (bus.front.exciting(), bus.front.device.status().trip) == (False, TripCause.NONE)


def test_a_tone_whose_bus_was_away_does_not_let_the_next_one_go_on_for_longer(stuck) -> None:
    bus, controller = stuck(heeds=True)
    endless, bus.front.device.arm = bus.front.device.arm, partial(RigDevice.arm, bus.front.device)
    bus.before = lambda group: time.sleep(3.0) if group == "tone" else None
    with controller.lease("job"):
        controller.measure(SHORT)
        bus.before, bus.front.device.arm = (lambda group: None), endless
        began = time.monotonic()
        with pytest.raises(OverdueError):
            controller.measure(SHORT)
    assert time.monotonic() - began < 5.0, "twice as long as the tone before had taken"


def test_a_tone_that_ends_neither_by_itself_nor_by_a_stop_is_ended_by_the_watchdog(stuck) -> None:
    bus, controller = stuck(heeds=False)
    with controller.lease("job"):
        with pytest.raises(OverdueError, match=r"did not end a tone .*; its watchdog has ended the excitation"):
            controller.measure(SHORT)
        assert (bus.front.exciting(), bus.front.device.status().trip) == (False, TripCause.HOST)


def test_a_stop_that_is_accepted_and_not_heeded_ends_by_the_watchdog(stuck) -> None:
    bus, controller = stuck(heeds=False)
    asked = _while_exciting(bus.front.device, controller.stop)
    told = "stopped: test bus: the controller went on for 0.3 s after it was told to stop; its watchdog has ended"
    with controller.lease("job"):
        with pytest.raises(CancelledError, match=told):
            controller.measure(LONG)
        assert (bus.front.exciting(), bus.front.device.status().trip) == (False, TripCause.HOST)
    asked.join()


def test_a_tone_that_nothing_ends_is_told_as_that(stuck) -> None:
    bus, controller = stuck(heeds=False, watchdog_s=60.0)
    told = "did not end a tone .* end the excitation there: it goes on exciting, also without a heartbeat"
    with controller.lease("job"):
        with pytest.raises(StopRefusedError, match=told):
            controller.measure(SHORT)
        bus.front.device._stop_asked = True


# ---- a lease that was taken, and an interruption before that is noted


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BusError("the answer was lost")])
def test_a_lease_that_was_taken_before_the_interruption_is_given_back(
    bus: _Bus, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    controller = RemoteController(bus, patience_s=0.05)
    write = bus.write
    taken = []

    def interrupted(group: str, values: Values) -> None:
        write(group, values)
        if group == "lease":
            taken.append(bus.front.device.status().lease_holder)
            raise error

    monkeypatch.setattr(bus, "write", interrupted)
    with pytest.raises(type(error)), controller.lease("job", seconds=3600.0):
        pass
    assert set(taken) == {"job"}
    assert bus.front.device.status().lease_holder == ""


def test_a_lease_in_process_that_was_taken_before_the_interruption_is_given_back(
    device: RigDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = SimulatedController(device)
    acquire = device.acquire

    def interrupted(*about: object, **more: object) -> int:
        acquire(*about, **more)  # type: ignore[arg-type]
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(device, "acquire", interrupted)
        with pytest.raises(KeyboardInterrupt), controller.lease("job"):
            pass
    assert device.status().lease_holder == ""
    with controller.lease("job"):
        with pytest.raises(LeaseError), controller.lease("twice"):
            pass
        assert controller.measure(TONE).tone == TONE, "the lease is still held"
