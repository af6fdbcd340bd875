"""The Controller protocol: four verbs under a lease, whatever the bus.

``capabilities``, ``status``, ``measure(tone)`` and ``stop``. A lease is a context manager; leaving it, by
whatever way, ends with the excitation off.

>>> from drivers.simulated.driver import SimulatedController
>>> from sim.reference import reference_rig
>>> rig = SimulatedController(reference_rig(), seed=1)
>>> with rig.lease("doctest"):
...     point = rig.measure(Tone(axis=0, amplitude_a=0.1, periods=10, samples=1000, blocks=3))
>>> point.Y.shape, point.tone.frequency_hz(rig.capabilities().sample_rate_hz)
((3, 4, 4), 100.0)
"""

from __future__ import annotations

import enum
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

HARMONICS = (0, 1, 2, 3)


class State(enum.IntEnum):
    """State of the controller's excitation machine."""

    OFF = 0
    LEVITATED = 1
    ARMED = 2
    SETTLING = 3
    RECORDING = 4
    DONE = 5
    TRIPPED = 6


class TripCause(enum.IntEnum):
    """Why a trip latched."""

    NONE = 0
    HOST = 1
    DISPLACEMENT = 2
    CURRENT = 3
    FAULT = 4


@dataclass(frozen=True)
class Tone:
    """One stepped-sine point: a cosine on r of one axis, measured in blocks of whole periods.

    A block is ``samples`` controller samples long and holds exactly ``periods`` periods, so the lock-in has
    no leakage and the frequency is periods * sample rate / samples. ``amplitude_a`` 0 measures without
    excitation. The blocks follow one another without a gap after ``settle_samples``.
    """

    axis: int
    amplitude_a: float
    periods: int
    samples: int
    blocks: int = 6
    settle_samples: int = 0
    raw: bool = False
    """Also return the records of all blocks."""

    def frequency_hz(self, sample_rate_hz: float) -> float:
        """Excited frequency, Hz."""
        return self.periods * sample_rate_hz / self.samples


@dataclass(frozen=True)
class PointResult:
    """What one tone gave. Complex amplitudes per block, x(t) = Re(X exp(j h w t)), R at harmonic 1 real and positive.

    R, U, I, Y have shape (blocks, harmonics, n_axes); records r, u, i, y, when asked for, (blocks * samples, n_axes).
    """

    tone: Tone
    harmonics: tuple[int, ...]
    R: NDArray[np.complex128]
    U: NDArray[np.complex128]
    I: NDArray[np.complex128]
    Y: NDArray[np.complex128]
    peak_displacement_m: float
    """Largest |y| of any axis while the tone was on, ramps included."""
    peak_current_a: float
    rig_seconds: float
    """Time that the rig spent, ramps and settling included."""
    sequence: int
    """Number of this result on the controller; a result never changes under its number."""
    records: dict[str, NDArray[np.float64]] | None = None


@dataclass(frozen=True)
class Waveform:
    """A periodic excitation of all axes at once: one period of r, ramped up, settled, and recorded for some periods."""

    r_a: NDArray[np.float64]
    """(N, n_axes) one period of r, A, a row a controller sample."""
    periods: int = 2
    """Periods that are recorded, without a gap, after ``settle_samples``."""
    settle_samples: int = 0

    @property
    def samples(self) -> int:
        """N, samples of one period."""
        return len(self.r_a)

    @property
    def peak_a(self) -> float:
        """Largest |r| of any axis."""
        return float(np.max(np.abs(self.r_a), initial=0.0))


@dataclass(frozen=True)
class WaveformResult:
    """What a periodic waveform gave: the records of its periods."""

    records: dict[str, NDArray[np.float64]]
    """r, u, i, y, (periods * N, n_axes) each."""
    peak_displacement_m: float
    """Largest |y| of any axis while the waveform was on, ramps included."""
    peak_current_a: float
    rig_seconds: float
    sequence: int


@dataclass(frozen=True)
class Capabilities:
    """What a controller is and allows."""

    identity: str
    axes: tuple[str, ...]
    sample_rate_hz: float
    max_amplitude_a: float
    max_frequency_hz: float
    max_samples: int
    """Largest total of settle and block samples of one tone."""
    displacement_limit_m: float
    current_limit_a: float
    harmonics: tuple[int, ...] = HARMONICS
    raw_records: bool = True
    amplitude_steps_per_a: int = field(default=1_000_000, compare=False)
    """Amplitudes are whole multiples of one over that, A: coarser where the map of a vendor's is. The driver's, too."""
    periodic: bool = field(default=False, compare=False)
    """Whether it also plays periodic waveforms on all axes at once: it is a `PeriodicController` then. That is the
    driver's, not the rig's, and two drivers of one rig are equal without it."""
    raw_bytes_per_s: float | None = field(default=None, compare=False)
    """About how fast raw records come over the link, on a line that is so slow that one waits; None on others. The
    driver's, too."""

    def record_wait_s(self, samples: int) -> float:
        """About how long one waits for a raw record of so many samples, u, i, y of each axis; 0 where that is short."""
        size = 4 * 3 * len(self.axes) * samples
        return size / self.raw_bytes_per_s if self.raw_bytes_per_s else 0.0


@dataclass(frozen=True)
class Status:
    """Snapshot of a controller. Reading it moves nothing and feeds no watchdog."""

    state: State
    trip: TripCause
    trip_message: str
    excitation_a: float
    """Amplitude of r now; 0 when nothing is excited."""
    displacement_m: tuple[float, ...]
    current_a: tuple[float, ...]
    lease_holder: str
    """Empty when free."""
    lease_seconds_left: float
    boot_id: int
    speed_rad_s: float
    uptime_s: float


@runtime_checkable
class Controller(Protocol):
    """An AMB controller that levitates a rotor and can excite it."""

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""

    def status(self) -> Status:
        """Snapshot of state, trip, excitation, lease."""

    def lease(self, holder: str, seconds: float = 10.0) -> AbstractContextManager[None]:
        """Hold the rig exclusively. Renewed while it is held; leaving it stops the excitation.

        Raises
        ------
        LeaseError
            Another host holds the rig.
        """

    def measure(self, tone: Tone) -> PointResult:
        """Excite with one tone, wait, measure, and ramp back to zero.

        Raises
        ------
        LeaseError
            The caller does not hold the lease.
        LimitError
            The tone is outside the controller's limits; nothing was excited.
        TripError
            A limit tripped; excitation is off, the trip is latched until `acknowledge`. A `LatchedTripError`: it was so
            before, and nothing was excited.
        """

    def stop(self) -> None:
        """Ramp the excitation to zero. Needs no lease; safe at any time, from any thread, and twice."""

    def acknowledge(self) -> None:
        """Clear a latched trip. Needs the lease."""

    def close(self) -> None:
        """End a lease that is held here, and its excitation, and give up the link; safe twice, and under the lease."""


@runtime_checkable
class PeriodicController(Controller, Protocol):
    """A controller whose capabilities say ``periodic``: beside tones it plays waveforms from a table."""

    def measure_periodic(self, waveform: Waveform) -> WaveformResult:
        """Excite all axes with a periodic waveform, wait, record, and ramp back to zero.

        Raises as `Controller.measure` does.
        """
