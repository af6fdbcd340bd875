"""Plays one tone on the simulated rig: ramp up, settle, record without gaps, ramp down; or the early end of it."""

from __future__ import annotations

import copy
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from drivers.controller import HARMONICS, PointResult, State, Tone, TripCause, Waveform, WaveformResult
from drivers.device.lockin import (
    LockIn,
    cosine,
    quantised_amplitude,
    quantised_waveform,
    ramp_samples,
    smooth_step,
)
from sim.rig import Array
from sim.stepping import Simulation

T = TypeVar("T", PointResult, WaveformResult)

FAST_CHUNK_SAMPLES = 1000
REAL_TIME_CHUNK_S = 0.005
EMERGENCY_RAMP_S = 0.02
WAVEFORM_RAMP_S = 0.1
"""Ramp of a waveform: a period of the lowest frequency that a rotor is usually excited with."""
CALM_S = 0.5
"""Simulated time that passes after a limit was exceeded, so that the rotor is at rest when the next tone begins."""


@dataclass(frozen=True)
class Interruption:
    """Why a tone ends early. `TripCause.NONE` is a request to stop."""

    cause: TripCause
    message: str


class Interrupted(Exception):
    """The way out of a tone, not an error; the excitation has not been ramped down yet."""

    def __init__(self, interruption: Interruption) -> None:
        self.interruption = interruption


@dataclass
class Gauges:
    """What the device shows of itself while it runs. Each attribute is replaced whole, so reading needs no lock."""

    state: State
    displacement_m: tuple[float, ...]
    current_a: tuple[float, ...]
    excitation_a: float = 0.0
    rig_time_s: float = 0.0


@dataclass
class Pace:
    """Holds the simulation back to real time, or lets it run as fast as it can."""

    real_time: bool
    sample_rate_hz: float
    _due: float = field(default_factory=time.monotonic)

    @property
    def chunk_samples(self) -> int:
        """Samples between two looks at the guard."""
        return max(1, round(REAL_TIME_CHUNK_S * self.sample_rate_hz)) if self.real_time else FAST_CHUNK_SAMPLES

    def wait(self, samples: int) -> None:
        """Sleep until ``samples`` more have had their time; a lag of over 50 ms is forgotten, not caught up."""
        if not self.real_time:
            return
        now = time.monotonic()
        self._due = max(self._due, now - 0.05) + samples / self.sample_rate_hz
        if self._due > now:
            time.sleep(self._due - now)


class Player:
    """Plays tones on one simulation.

    Parameters
    ----------
    guard
        Asked before every chunk; an interruption ends the tone.
    latch
        Told of an interruption that is a trip, before the excitation is ramped down.
    """

    def __init__(
        self,
        simulation: Simulation,
        gauges: Gauges,
        pace: Pace,
        guard: Callable[[], Interruption | None],
        latch: Callable[[Interruption], None],
    ) -> None:
        self._sim = simulation
        self._rig = simulation.rig
        self._gauges = gauges
        self._pace = pace
        self._guard = guard
        self._latch = latch
        self._fs = 1.0 / simulation.rig.controller.sample_time_s

    def idle(self, samples: int) -> None:
        """Levitate without excitation."""
        self._advance(np.zeros((samples, self._sim.n_axes)), check_limits=False)
        self._pace.wait(samples)

    def play(self, tone: Tone, sequence: int) -> tuple[PointResult | None, Interruption | None]:
        """Result, or None and why the tone ended early; the excitation is zero either way."""
        run = _ToneRun(tone, self._sim.n_axes)
        shape = (ramp_samples(tone, self._fs), tone.settle_samples, tone.blocks * tone.samples)
        return self._play(run, *shape, sequence)

    def play_periodic(self, waveform: Waveform, sequence: int) -> tuple[WaveformResult | None, Interruption | None]:
        """The same for a periodic waveform."""
        run = _WaveformRun(waveform)
        ramp = round(WAVEFORM_RAMP_S * self._fs) if run.amplitude_a else 0
        return self._play(run, ramp, waveform.settle_samples, waveform.periods * waveform.samples, sequence)

    def _play(
        self, run: _Run[T], ramp: int, settle: int, record: int, sequence: int
    ) -> tuple[T | None, Interruption | None]:
        before = self._moment()
        try:
            # A host takes r as it asked for it, so a record begins where the logged r does, however late its log is.
            late = max(0, round(self._rig.logging_offset_samples))
            self._segment(run, State.SETTLING, -settle - ramp, ramp, 0.0, 1.0)
            self._segment(run, State.SETTLING, -settle, settle + late, 1.0, 1.0)
            self._segment(run, State.RECORDING, late, record, 1.0, 1.0, keep=True)
            self._segment(run, State.RECORDING, late + record, ramp, 1.0, 0.0)
        except Interrupted as early:
            if early.interruption.cause != TripCause.NONE:
                self._latch(early.interruption)
            self._emergency_ramp(run)
            if early.interruption.cause in (TripCause.NONE, TripCause.HOST):
                self._return_to(before)
            elif not self._pace.real_time:
                self.idle(round(CALM_S * self._fs))
            return None, early.interruption
        except BaseException:
            # whatever went wrong (Ctrl-C included), the excitation ends before anyone hears of it
            self._emergency_ramp(run)
            self._return_to(before)
            raise
        finally:
            self._gauges.excitation_a = 0.0
        return run.result(sequence, self._fs), None

    def _segment(
        self, run: _Run[T], state: State, first: int, count: int, start: float, end: float, keep: bool = False
    ) -> None:
        if count > 0:
            self._gauges.state = state
        done = 0
        while done < count:
            if (interruption := self._guard()) is not None:
                raise Interrupted(interruption)
            n = min(self._pace.chunk_samples, count - done)
            position = (done + np.arange(n)) / count
            level = np.full(n, start) if start == end else start + (end - start) * smooth_step(position)
            r = run.wave(first + done, n) * level[:, None]
            self._gauges.excitation_a = run.amplitude_a * float(level[-1])
            before = run.samples
            reached = self._advance(r, run=run, keep=keep)
            # a limit may have ended the chunk early: the ramp begins where the excitation really is
            played = run.samples - before
            run.next_sample, run.level = first + done + played, float(level[played - 1])
            self._pace.wait(n)
            if reached is not None:
                raise Interrupted(reached)
            done += n

    def _emergency_ramp(self, run: _Run[T]) -> None:
        total = round(EMERGENCY_RAMP_S * self._fs)
        if run.amplitude_a == 0 or run.level == 0:
            return
        for done in range(0, total, self._pace.chunk_samples):
            n = min(self._pace.chunk_samples, total - done)
            level = run.level * smooth_step(1 - (done + 1 + np.arange(n)) / total)
            r = run.wave(run.next_sample + done, n) * level[:, None]
            self._gauges.excitation_a = run.amplitude_a * float(level[-1])
            self._advance(r, check_limits=False)
            self._pace.wait(n)

    def _moment(self) -> Simulation | None:
        """The rig as it is now; None in real time, which cannot be had back."""
        if self._pace.real_time:
            return None
        return copy.deepcopy(self._sim, {id(self._rig): self._rig})

    def _return_to(self, moment: Simulation | None) -> None:
        """Undo a tone that a host cut short.

        Simulated time passes only for what was measured or tripped: a tone that is asked for again, because a host
        stood still or was stopped, meets the same noise, and an experiment's result does not depend on how often.
        """
        if moment is not None:
            self._sim = moment
            self._gauges.rig_time_s = moment.time_s

    def _advance(
        self, r: Array, check_limits: bool = True, run: _Run[T] | None = None, keep: bool = False
    ) -> Interruption | None:
        record = self._sim.advance(r, check_limits=check_limits)
        self._gauges.displacement_m = tuple(record.y[-1].tolist())
        self._gauges.current_a = tuple(record.i[-1].tolist())
        self._gauges.rig_time_s = self._sim.time_s
        if not np.all(np.isfinite(record.y[-1])):
            return Interruption(TripCause.FAULT, "the rotor is not levitated any more; restart the rig")
        if run is not None:
            run.add(record.r, record.u, record.i, record.y, keep)
        if record.exceeded == "displacement":
            return self._limit(
                TripCause.DISPLACEMENT, "displacement", record.y[-1], self._rig.displacement_limit_m, "um"
            )
        if record.exceeded == "current":
            return self._limit(TripCause.CURRENT, "current", record.i[-1], self._rig.current_limit_a, "A")
        return None

    def _limit(self, cause: TripCause, name: str, last: Array, limit: float, unit: str) -> Interruption:
        axis = int(np.argmax(np.abs(last)))
        scale = 1e6 if unit == "um" else 1.0
        return Interruption(
            cause,
            f"{name} of axis {self._rig.axes[axis]} reached {abs(last[axis]) * scale:.4g} {unit}, over the limit of "
            f"{limit * scale:.4g} {unit}; the excitation is off: acknowledge, and use a lower amplitude",
        )


class _Run(ABC, Generic[T]):
    """What an excitation is, and what it has gathered so far."""

    def __init__(self, amplitude_a: float) -> None:
        self.amplitude_a = amplitude_a
        """Largest |r|."""
        self.next_sample = 0
        self.level = 0.0
        self.samples = 0
        self._peak_y = self._peak_i = 0.0
        self._chunks: list[Array] = []

    @abstractmethod
    def wave(self, first: int, count: int) -> Array:
        """r at full level from sample ``first`` on, (count, n_axes); sample 0 starts the record."""

    @abstractmethod
    def result(self, sequence: int, sample_rate_hz: float) -> T:
        """What an excitation that was played to its end gave."""

    def add(self, r: Array, u: Array, i: Array, y: Array, keep: bool) -> None:
        """Take over a chunk; (M, n_axes) each."""
        self.samples += len(y)
        self._peak_y = max(self._peak_y, float(np.max(np.abs(y))))
        self._peak_i = max(self._peak_i, float(np.max(np.abs(i))))
        if keep:
            self._keep(np.hstack((r, u, i, y)))

    def _keep(self, chunk: Array) -> None:
        self._chunks.append(chunk)

    def _records(self) -> dict[str, Array]:
        return dict(zip("ruiy", np.split(np.concatenate(self._chunks), 4, axis=1), strict=True))


class _ToneRun(_Run[PointResult]):
    """One tone, demodulated while it is played."""

    def __init__(self, tone: Tone, n_axes: int) -> None:
        super().__init__(quantised_amplitude(tone.amplitude_a))
        self.tone, self._n_axes = tone, n_axes
        self._lockin = LockIn(tone, 4 * n_axes)

    def wave(self, first: int, count: int) -> Array:
        """The tone's cosine in its axis."""
        r = np.zeros((count, self._n_axes))
        r[:, self.tone.axis] = self.amplitude_a * cosine(self.tone, first, count)
        return r

    def _keep(self, chunk: Array) -> None:
        self._lockin.add(chunk)
        if self.tone.raw:
            super()._keep(chunk)

    def result(self, sequence: int, sample_rate_hz: float) -> PointResult:
        """Amplitudes of the blocks, and the records when they were asked for."""
        r, u, i, y = np.split(self._lockin.amplitudes, 4, axis=2)
        return PointResult(
            tone=self.tone,
            harmonics=HARMONICS,
            R=r,
            U=u,
            I=i,
            Y=y,
            peak_displacement_m=self._peak_y,
            peak_current_a=self._peak_i,
            rig_seconds=self.samples / sample_rate_hz,
            sequence=sequence,
            records=self._records() if self.tone.raw else None,
        )


class _WaveformRun(_Run[WaveformResult]):
    """A periodic waveform, recorded."""

    def __init__(self, waveform: Waveform) -> None:
        self._period = quantised_waveform(waveform.r_a)
        super().__init__(float(np.max(np.abs(self._period), initial=0.0)))

    def wave(self, first: int, count: int) -> Array:
        """The period, repeated."""
        return self._period[np.arange(first, first + count) % len(self._period)]

    def result(self, sequence: int, sample_rate_hz: float) -> WaveformResult:
        """The records."""
        return WaveformResult(self._records(), self._peak_y, self._peak_i, self.samples / sample_rate_hz, sequence)
