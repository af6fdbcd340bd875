"""A controller in the caller's own process: the simulated rig's device without a bus between."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from drivers.controller import Capabilities, PointResult, Status, Tone, Waveform, WaveformResult
from drivers.device.lease import NO_TOKEN, drawn_token
from drivers.device.machine import RigDevice
from drivers.payload import as_received, records_as_received
from sim.rig import Rig


class SimulatedController:
    """Controller of a simulated rig, in process.

    Parameters
    ----------
    rig
        The rig, or a device that already runs (a second host of the same rig).
    seed
        Of all noise of a rig that is started here.

    Raises
    ------
    LevitationError
        The rig's controller does not hold the rotor.
    """

    def __init__(self, rig: Rig | RigDevice, seed: int = 0) -> None:
        self._own = not isinstance(rig, RigDevice)
        self._device = rig if isinstance(rig, RigDevice) else RigDevice(rig, seed)
        self._token = NO_TOKEN
        self._own_token = self._next_token = drawn_token()

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""
        return replace(self._device.capabilities(), periodic=True)

    def status(self) -> Status:
        """Snapshot of state, trip, excitation, lease."""
        return self._device.status()

    @contextmanager
    def lease(self, holder: str, seconds: float = 10.0) -> Iterator[None]:
        """Hold the rig; it cannot lapse, for the holder lives in the device's process."""
        token = self._next_token
        try:  # from here on: an interruption may come once the device has given it
            self._device.acquire(holder, seconds, attached=True, token=token)
            self._token, self._own_token, self._next_token = token, token, drawn_token()
            yield
        finally:
            if self._token == token:
                self._token = NO_TOKEN
            self._device.release(token)

    def _release(self) -> None:
        token, self._token = self._token, NO_TOKEN
        self._device.release(token)

    def measure(self, tone: Tone) -> PointResult:
        """Excite with one tone, measure, ramp back to zero; the result has a bus's word length."""
        return as_received(self._device.measure(tone, self._token))

    def measure_periodic(self, waveform: Waveform) -> WaveformResult:
        """Excite all axes with a periodic waveform, record, ramp back; records have the word length of a bus."""
        return records_as_received(self._device.measure_periodic(waveform, self._token))

    def stop(self) -> None:
        """Ramp the excitation to zero, from any thread, at any time."""
        self._device.stop(self._own_token)  # without a lease, too, it is not a stranger's

    def acknowledge(self) -> None:
        """Clear a latched trip; needs the lease."""
        self._device.acknowledge(self._token)

    def close(self) -> None:
        """End the lease that is held here, and switch the rig off if it was started here; safe twice."""
        self._release()
        if self._own:
            self._device.close()
