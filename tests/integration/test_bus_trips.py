"""A trip over a bus is of the tone that caused it, and of no other."""

import pytest

from drivers.controller import Tone, TripCause
from drivers.device.machine import RigDevice
from drivers.device.play import Interruption
from drivers.device.serve import ModbusOptions, serve_modbus
from drivers.errors import BusError, LatchedTripError, TripError
from drivers.modbus.driver import tcp_links
from drivers.objects import Outcome
from drivers.remote import RemoteController
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
TOO_LARGE = Tone(axis=0, amplitude_a=5.9, periods=1, samples=200)


@pytest.fixture
def rig():
    served = serve_modbus(RigDevice(reference_rig(), 3), ModbusOptions(port=0))
    host, port = served.url.removeprefix("modbus://").partition("?")[0].split(":")
    controller = RemoteController(tcp_links(host, int(port)), patience_s=0.5)
    yield served.device, controller
    controller.close()
    served.close()


def test_a_trip_that_was_latched_before_the_tone_is_told_apart(rig) -> None:
    device, controller = rig
    with controller.lease("host"):
        with pytest.raises(TripError) as of_the_tone:
            controller.measure(TOO_LARGE)
        assert not isinstance(of_the_tone.value, LatchedTripError)
        controller.acknowledge()
        controller.measure(TONE)
        device._latch(Interruption(TripCause.DISPLACEMENT, "a blow"))
        with pytest.raises(LatchedTripError, match="a blow") as before:
            controller.measure(TONE)
        assert before.value.cause == "displacement"


def test_a_trip_that_was_out_of_sight_is_of_its_tone(rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bus fails once the tone is accepted, and comes back when it has tripped."""
    _, controller = rig
    wait = controller._playing._wait

    def lost(tone: Tone, command: int) -> int:
        while controller._playing.outcome(command) is Outcome.UNDER_WAY:
            pass
        monkeypatch.setattr(controller._playing, "_wait", wait)
        raise BusError("gone")

    monkeypatch.setattr(controller._playing, "_wait", lost)
    with controller.lease("host"):
        with pytest.raises(BusError, match="gone"):
            controller.measure(TOO_LARGE)
        with pytest.raises(TripError, match="over the limit") as tripped:
            controller.measure(TOO_LARGE)
        assert not isinstance(tripped.value, LatchedTripError)
