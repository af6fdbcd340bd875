"""What every driver owes its caller, whatever the bus: each on its own simulated device, all with the same tests."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.controller import Controller, PointResult, State, Tone, TripCause
from drivers.device.machine import RigDevice
from drivers.errors import CancelledError, ControllerError, LeaseError, LimitError, TripError
from drivers.simulated.driver import SimulatedController
from sim.reference import reference_rig
from tests.support.buses import BUSES, Bench
from tests.support.processes import wait_for

TONE = Tone(axis=1, amplitude_a=0.1234567, periods=10, samples=1000, blocks=3, settle_samples=100)
RAW = replace(TONE, periods=4, samples=400, raw=True)
"""A third of the record: a serial line takes seconds for it, and it still comes in many parts."""
LONG = Tone(axis=0, amplitude_a=0.02, periods=3000, samples=1_900_000, blocks=1)


@pytest.fixture(scope="module", params=list(BUSES))
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with BUSES[request.param](tmp_path_factory.mktemp("bus")) as bench:
        yield bench


@pytest.fixture
def controller(bench: Bench) -> Iterator[Controller]:
    controller = bench.connect()
    try:
        _wait_until_free(controller)
        yield controller
        _wait_until_free(controller)
        with controller.lease("clean-up"):
            controller.acknowledge()
    finally:
        controller.close()  # a serial line has but one host: one left open would fail every test after it


def _wait_until_free(controller: Controller) -> None:
    """A test that failed may leave a lease behind, which ends by itself and fails no other test."""
    wait_for(lambda: not controller.status().lease_holder, "the lease of the test before", 20)


def test_driver_is_a_controller(controller: Controller) -> None:
    assert isinstance(controller, Controller)


def test_capabilities_are_those_of_the_rig(controller: Controller, bench: Bench) -> None:
    assert controller.capabilities() == bench.device.capabilities()


def test_status_tells_state_and_lease_and_moves_nothing(controller: Controller, bench: Bench) -> None:
    rig_time = bench.device.rig_time_s
    status = controller.status()
    assert status.state in (State.LEVITATED, State.DONE)
    assert status.trip is TripCause.NONE
    assert status.excitation_a == 0
    assert (status.lease_holder, status.lease_seconds_left) == ("", 0)
    assert status.boot_id == bench.device.boot_id
    assert len(status.displacement_m) == len(status.current_a) == 4
    assert bench.device.rig_time_s == rig_time


def test_measures_a_tone(controller: Controller) -> None:
    with controller.lease("contract"):
        point = controller.measure(TONE)
    assert point.tone == TONE
    for x in (point.R, point.U, point.I, point.Y):
        assert x.shape == (3, 4, 4)
    # the excitation is what was asked for, to the controller's microampere, real and positive at the tone
    np.testing.assert_allclose(point.R[:, 1, 1], 0.123457, rtol=1e-12)
    assert np.max(np.abs(point.R[:, [0, 2, 3]])) < 1e-12
    # the rotor moved, on the excited axis most, and at the tone
    y = np.abs(point.Y.mean(axis=0))
    assert 1e-7 < y[1, 1] == y.max() <= point.peak_displacement_m < 80e-6
    assert point.peak_current_a > abs(point.I[0, 1, 1])
    rate = controller.capabilities().sample_rate_hz
    assert point.rig_seconds >= (TONE.settle_samples + TONE.blocks * TONE.samples) / rate
    assert point.records is None


def test_agrees_with_the_same_rig_in_process_to_the_last_bit(bench: Bench) -> None:
    """Same rig, same seed, same tones: an experiment that goes by its results takes the same way on every bus."""
    reference = SimulatedController(reference_rig(), seed=11)
    tones = [RAW, replace(TONE, axis=2, periods=37, samples=2000, blocks=6)]
    with bench.fresh(seed=11) as controller, controller.lease("contract"), reference.lease("contract"):
        for tone in tones:
            one, two = controller.measure(tone), reference.measure(tone)
            for name in ("R", "U", "I", "Y"):
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            assert (one.peak_displacement_m, one.peak_current_a) == (two.peak_displacement_m, two.peak_current_a)
            assert one.rig_seconds == two.rig_seconds
            if tone.raw:
                assert one.records is not None
                assert two.records is not None
                for name in "ruiy":
                    np.testing.assert_array_equal(one.records[name], two.records[name])


def test_raw_record_demodulates_to_the_lock_in_result(controller: Controller) -> None:
    with controller.lease("contract"):
        point = controller.measure(RAW)
    assert point.records is not None
    y = point.records["y"].reshape(3, 400, 4)
    kernel = 2 / 400 * np.exp(-2j * np.pi * 4 * np.arange(400) / 400)
    np.testing.assert_allclose(np.einsum("k,bkn->bn", kernel, y), point.Y[:, 1], atol=5e-12)


def test_results_are_numbered_and_follow_one_another(controller: Controller) -> None:
    with controller.lease("contract"):
        first, second = controller.measure(TONE), controller.measure(TONE)
    assert second.sequence == first.sequence + 1
    assert not np.array_equal(first.Y, second.Y)  # noise goes on


def test_measures_without_excitation(controller: Controller) -> None:
    with controller.lease("contract"):
        point = controller.measure(Tone(axis=0, amplitude_a=0.0, periods=1, samples=1500, blocks=1, raw=True))
    assert point.records is not None
    assert 10e-9 < np.std(point.records["y"]) < 40e-9  # the sensor's 20 nm and what the loop makes of it
    assert np.all(point.records["r"] == 0)


def test_without_a_lease_nothing_is_excited(controller: Controller, bench: Bench) -> None:
    rig_time = bench.device.rig_time_s
    with pytest.raises(LeaseError, match="lease"):
        controller.measure(TONE)
    with pytest.raises(LeaseError):
        controller.acknowledge()
    assert bench.device.rig_time_s == rig_time


def test_second_host_is_refused_with_holder_and_time_left(controller: Controller, bench: Bench) -> None:
    other = bench.other()
    try:
        with controller.lease("first host", seconds=20):
            with pytest.raises(LeaseError, match="'first host' for another") as refused, other.lease("second host"):
                pass
            assert refused.value.holder == "first host"
            assert 0 < refused.value.seconds_left <= 20
            with pytest.raises(LeaseError):
                other.measure(TONE)
            assert controller.status().lease_holder == other.status().lease_holder == "first host"
            controller.measure(TONE)
        with other.lease("second host"):
            other.measure(TONE)
    finally:
        other.close()


@pytest.mark.parametrize("axis_count", [4])
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    wrong=st.sampled_from(
        [
            {"axis": 4},
            {"axis": -1},
            {"amplitude_a": 6.001},
            {"amplitude_a": -0.1},
            {"amplitude_a": float("nan")},
            {"amplitude_a": float("inf")},
            {"periods": 0},
            {"samples": 1},
            {"periods": 451},
            {"blocks": 0},
            {"blocks": 1000},
            {"settle_samples": -1},
            {"settle_samples": 2_000_000},
            {"samples": 700_000},
        ]
    )
)
def test_tone_outside_the_limits_is_refused(
    controller: Controller, bench: Bench, axis_count: int, wrong: dict[str, float]
) -> None:
    rig_time = bench.device.rig_time_s
    with controller.lease("contract"), pytest.raises(LimitError):
        controller.measure(replace(TONE, **wrong))
    assert bench.device.rig_time_s == rig_time


def test_displacement_limit_trips_and_latches(controller: Controller, bench: Bench) -> None:
    strong = Tone(axis=0, amplitude_a=5.9, periods=1, samples=200)
    with controller.lease("contract"):
        with pytest.raises(TripError, match=r"displacement of axis x[AB] reached .* um, over the limit of 80 um") as e:
            controller.measure(strong)
        assert e.value.cause == "displacement"
        status = controller.status()
        assert (status.state, status.trip, status.excitation_a) == (State.TRIPPED, TripCause.DISPLACEMENT, 0)
        assert "over the limit" in status.trip_message
        rig_time = bench.device.rig_time_s
        with pytest.raises(TripError, match="latched"):
            controller.measure(TONE)
        assert bench.device.rig_time_s == rig_time
        controller.acknowledge()
        assert controller.status().trip is TripCause.NONE
        controller.measure(TONE)


def test_trip_outlives_the_lease(controller: Controller) -> None:
    with controller.lease("contract"), pytest.raises(TripError):
        controller.measure(Tone(axis=0, amplitude_a=5.9, periods=1, samples=200))
    assert controller.status().state is State.TRIPPED
    with controller.lease("contract"), pytest.raises(TripError, match="latched"):
        controller.measure(TONE)


def test_stop_from_another_thread_ends_the_tone(controller: Controller, bench: Bench) -> None:
    with controller.lease("contract"):
        stopper = threading.Thread(target=_stop_when_exciting, args=(bench, controller))
        stopper.start()
        with pytest.raises(CancelledError, match="excitation is off"):
            controller.measure(LONG)
        stopper.join()
        assert controller.status().excitation_a == 0
        controller.measure(TONE)


def test_stop_of_a_stranger_is_heard(controller: Controller, bench: Bench) -> None:
    stranger = bench.other()
    with controller.lease("contract"):
        stopper = threading.Thread(target=_stop_when_exciting, args=(bench, stranger))
        stopper.start()
        with pytest.raises(CancelledError):
            controller.measure(LONG)
        stopper.join()
        # and between two points of a sweep, too
        stranger.stop()
        with pytest.raises(CancelledError):
            controller.measure(TONE)
        controller.measure(TONE)
    stranger.close()


def test_stop_is_safe_without_lease_and_twice(controller: Controller) -> None:
    """Who is not sure presses again; nothing of it lasts into the next tone, or shows as a trip."""
    controller.stop()
    controller.stop()
    with controller.lease("contract"):
        controller.stop()
        controller.stop()
        assert controller.measure(TONE).tone == TONE
    controller.stop()
    status = controller.status()
    assert (status.trip, status.excitation_a, status.lease_holder) == (TripCause.NONE, 0, "")


def test_an_exception_under_the_lease_ends_the_lease(controller: Controller) -> None:
    with pytest.raises(RuntimeError, match="disk full"), controller.lease("contract"):
        raise RuntimeError("disk full")
    status = controller.status()
    assert (status.lease_holder, status.excitation_a) == ("", 0)


def test_leaving_the_lease_while_a_tone_plays_ends_it(controller: Controller, bench: Bench) -> None:
    outcome: list[ControllerError] = []

    def measure() -> None:
        try:
            controller.measure(LONG)
        except ControllerError as error:
            outcome.append(error)

    with controller.lease("contract"):
        thread = threading.Thread(target=measure)
        thread.start()
        _wait_until(lambda: bench.device.status().excitation_a > 0)
    assert bench.device.status().excitation_a == 0
    thread.join(timeout=10)
    assert outcome


def test_close_gives_the_rig_free_and_is_safe_twice(controller: Controller, bench: Bench) -> None:
    """A program that ends on an error closes what it has, under the lease too; nobody waits for it to run out."""
    other = bench.other()
    with other.lease("ends early", seconds=60):
        assert controller.status().lease_holder == "ends early"
        other.close()
        other.close()
        assert controller.status().lease_holder == ""
    with controller.lease("contract"):
        assert controller.measure(TONE).tone == TONE


def test_lease_needs_a_holder_and_a_sensible_time(controller: Controller) -> None:
    with pytest.raises(LimitError), controller.lease("  "):
        pass
    with pytest.raises(LimitError), controller.lease("contract", seconds=0):
        pass
    assert controller.status().lease_holder == ""


def test_same_seed_same_result(bench: Bench) -> None:
    results: list[PointResult] = []
    for _ in range(2):
        with bench.fresh(seed=5) as controller, controller.lease("contract"):
            results.append(controller.measure(TONE))
    np.testing.assert_array_equal(results[0].Y, results[1].Y)


def test_a_device_that_left_its_bus_leaves_nothing_running(bench: Bench) -> None:
    before = set(threading.enumerate())
    with bench.fresh(seed=5) as controller, controller.lease("contract"):
        controller.measure(TONE)
    _wait_until(lambda: set(threading.enumerate()) <= before)
    assert set(threading.enumerate()) <= before


def _stop_when_exciting(bench: Bench, controller: Controller) -> None:
    _wait_until(lambda: bench.device.status().excitation_a > 0)
    controller.stop()


def _wait_until(condition, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.001)


def test_word_length_is_far_below_the_noise(bench: Bench) -> None:
    """What a driver gives against what the rig did: a tenth of the noise of one sample would be 2 nm and 0.2 mA."""
    exact = RigDevice(reference_rig(), 11)
    tone = replace(TONE, blocks=6)
    with bench.fresh(seed=11) as controller, controller.lease("contract"):
        point = controller.measure(tone)
    truth = exact.measure(tone, exact.acquire("truth", attached=True))
    assert np.abs(point.Y - truth.Y).max() < 1e-12
    assert np.abs(point.I - truth.I).max() < 1e-7
    assert np.abs(point.U - truth.U).max() < 1e-6
    assert np.abs(point.R - truth.R).max() < 1e-12
