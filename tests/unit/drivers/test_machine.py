"""The device's own rules, without a bus."""

import math
import threading
import time
from itertools import pairwise

import pytest

from drivers.controller import State, Tone, TripCause
from drivers.device.machine import RigDevice
from drivers.device.serve import status_line
from drivers.errors import BusyError, CancelledError, ControllerError, LimitError, TripError
from sim.errors import LevitationError
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
LONG = Tone(axis=0, amplitude_a=0.02, periods=3000, samples=1_900_000, blocks=1)


@pytest.fixture
def device() -> RigDevice:
    return RigDevice(reference_rig(), seed=1)


def _wait(condition) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_rig_that_its_controller_cannot_hold_is_refused() -> None:
    from sim.effects import effect

    with pytest.raises(LevitationError):
        RigDevice(effect("loop_delay").on(reference_rig(), delay_s=150e-6))


def test_silence_of_a_remote_host_trips_and_a_beating_one_does_not() -> None:
    """The clock of the watchdog is the test's: a busy machine that lets a thread wait trips nothing."""
    ms = 0
    device = RigDevice(reference_rig(), real_time=True, watchdog_s=0.15, clock=lambda: ms / 1000)
    token = device.acquire("host", 5.0)
    tone = Tone(axis=0, amplitude_a=0.05, periods=20, samples=10_000, blocks=10)
    done = threading.Event()

    def host() -> None:
        nonlocal ms
        while not done.wait(0.02):
            ms += 50
            if ms <= 600:
                device.heartbeat(token, ms)

    thread = threading.Thread(target=host)
    thread.start()
    try:
        with pytest.raises(TripError, match="no heartbeat of the host for 150 ms") as trip:
            device.measure(tone, token)
    finally:
        done.set()
        thread.join()
    assert trip.value.cause == "host"
    assert ms >= 750
    assert device.status().excitation_a == 0
    assert device.status().trip is TripCause.HOST
    device.close()


def test_lease_that_runs_out_ends_the_tone() -> None:
    seconds = 0.0
    device = RigDevice(reference_rig(), real_time=True, watchdog_s=60.0, clock=lambda: seconds)
    token = device.acquire("host", 0.3)

    def later() -> None:
        nonlocal seconds
        _wait(lambda: device.status().excitation_a > 0)
        seconds = 0.31

    thread = threading.Thread(target=later)
    thread.start()
    with pytest.raises(TripError, match="lease ran out"):
        device.measure(Tone(axis=0, amplitude_a=0.05, periods=20, samples=10_000, blocks=10), token)
    thread.join()
    device.close()


def test_one_tone_at_a_time(device: RigDevice) -> None:
    token = device.acquire("host", attached=True)
    play = device.arm(TONE, token)
    with pytest.raises(BusyError):
        device.arm(TONE, token)
    play()
    device.measure(TONE, token)


def test_interrupt_from_the_keyboard_ends_with_the_excitation_off(
    device: RigDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = device.acquire("host", attached=True)
    calls = iter(range(1000))

    def guard() -> None:
        if next(calls) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(device._player, "_guard", guard)
    with pytest.raises(KeyboardInterrupt):
        device.measure(LONG, token)
    status = device.status()
    assert (status.state, status.excitation_a) == (State.LEVITATED, 0)


def test_excitation_ends_in_a_ramp_and_not_in_a_step(device: RigDevice) -> None:
    """r as the rig saw it: no jump larger than the sine's own, neither at a trip nor at a stop."""
    seen: list[float] = []
    advance = device._simulation.advance

    def spy(r, **more):
        record = advance(r, **more)
        seen.extend(record.r[:, 0].tolist())
        return record

    device._simulation.advance = spy
    token = device.acquire("host", attached=True)
    device.measure(Tone(axis=0, amplitude_a=0.05, periods=10, samples=1000, blocks=1), token)
    threading.Timer(0.02, device.stop, [token]).start()
    with pytest.raises(CancelledError):
        device.measure(LONG, token)
    with pytest.raises(TripError):
        device.measure(Tone(axis=0, amplitude_a=5.9, periods=1, samples=200), token)
    steepest = max(abs(b - a) for a, b in pairwise(seen))
    # the steepest slopes of a sine of 50 Hz and of a raised cosine over 200 samples, together
    assert steepest < 5.9 * (2 * math.pi * 50 / 10_000 + math.pi / 2 / 200)
    assert seen[-1] == 0


def test_closed_device_is_off_and_excites_nothing(device: RigDevice) -> None:
    token = device.acquire("host", attached=True)
    device.close()
    device.close()
    assert device.status().state is State.OFF
    with pytest.raises(ControllerError, match="switched off"):
        device.measure(TONE, token)


def test_fault_from_outside_trips(device: RigDevice) -> None:
    device.fault("sensor supply lost")
    assert device.status().trip is TripCause.FAULT
    token = device.acquire("host", attached=True)
    with pytest.raises(TripError, match="sensor supply lost"):
        device.measure(TONE, token)


def test_trip_that_is_acknowledged_while_its_tone_ramps_down_is_cleared() -> None:
    """It was told as done, and still latched: of the next tone that was a trip at an amplitude never played."""
    device = RigDevice(reference_rig(), seed=1, real_time=True)
    token = device.acquire("host", attached=True)
    strong = Tone(axis=0, amplitude_a=5.9, periods=1, samples=200)
    tone = threading.Thread(target=pytest.raises, args=(TripError, device.measure, strong, token))
    tone.start()
    try:
        _wait(lambda: device.status().trip is TripCause.DISPLACEMENT)
        device.acknowledge(token)
        tone.join()
        assert device.status().trip is TripCause.NONE
        assert device.measure(TONE, token).tone == TONE
    finally:
        device.close()


def test_events_tell_the_story_in_order(device: RigDevice) -> None:
    token = device.acquire("host", attached=True)
    device.measure(TONE, token)
    device.release(token)
    texts = [e.text for e in device.events()]
    assert texts[0] == "levitated"
    assert texts[1] == "leased to host"
    assert texts[2].startswith("excitation on: 0.1 A at 100 Hz on xB")
    assert texts[-1] == "lease released"
    assert [e.number for e in device.events(after=2)] == list(range(3, len(texts) + 1))


def test_status_line_shows_lease_and_trip(device: RigDevice) -> None:
    assert status_line(device).startswith("LEVITATED")
    token = device.acquire("host", attached=True)
    with pytest.raises(TripError):
        device.measure(Tone(axis=0, amplitude_a=5.9, periods=1, samples=200), token)
    assert "leased to host" in status_line(device)
    assert "TRIP displacement of axis" in status_line(device)


def test_wrong_lease_is_refused(device: RigDevice) -> None:
    for holder, seconds in (("", 5.0), ("host", 0.0), ("host", 1e6), ("host", float("nan"))):
        with pytest.raises(LimitError):
            device.acquire(holder, seconds)


def test_tone_that_begins_the_moment_another_has_ended_has_a_number_of_its_own(device, monkeypatch) -> None:
    token = device.acquire("host", attached=True)
    lock, later = device._state_lock, []

    class Handed:
        """The lock; whoever gets it after the first tone's end plays another."""

        def __enter__(self) -> None:
            lock.acquire()

        def __exit__(self, *_: object) -> None:
            lock.release()
            if not device._playing:
                monkeypatch.setattr(device, "_state_lock", lock)
                later.append(device.measure(TONE, token).sequence)

    monkeypatch.setattr(device, "_state_lock", Handed())
    first = device.measure(TONE, token).sequence
    assert [first, *later] == [1, 2]
    assert device.measure(TONE, token).sequence == 3
