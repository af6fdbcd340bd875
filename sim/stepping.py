"""A levitated rig that runs in time: what it measures, its limits, its log; the compiled loop is `sim.loop`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.errors import EffectError
from sim.loop import Loop
from sim.rig import Array, Rig


@dataclass(frozen=True)
class Record:
    """Signals of M samples, each (M, n_axes): r, u, i in A and y in m, as the controller logs them."""

    r: Array
    u: Array
    i: Array
    y: Array
    exceeded: str
    """"displacement" or "current" when a limit was exceeded at the last sample, else empty."""

    def __len__(self) -> int:
        return len(self.r)


class Simulation:
    """A levitated rig that runs in time. Its state persists between calls of `advance`.

    Parameters
    ----------
    rig : Rig
    seed : int
        Seed of the measurement noise; equal seeds and calls give equal records.
    substeps : int
        Integration steps a controller sample.

    Raises
    ------
    LevitationError
        The closed loop is unstable; the message tells the fastest growing pole.
    EffectError
        The log is off by a fraction of a sample.
    """

    def __init__(self, rig: Rig, seed: int = 0, substeps: int = 4) -> None:
        if rig.logging_offset_samples != round(rig.logging_offset_samples):
            raise EffectError(
                f"rig {rig.name}: a logging offset of {rig.logging_offset_samples:g} samples cannot run in time; "
                "give a whole number"
            )
        self.rig, self.n_axes, self.substeps = rig, rig.n_axes, substeps
        self._rng = np.random.default_rng(seed)
        self._loop = Loop(rig, substeps)
        self._samples = 0
        self._log_tail: dict[int, Array] = {}

    @property
    def time_s(self) -> float:
        """Simulated time since the rotor was levitated, s."""
        return self._samples * self.rig.controller.sample_time_s

    def levitate(self) -> None:
        """Put the rotor at rest at its operating point, time zero."""
        self._loop.levitate()
        self._samples = 0
        self._log_tail = {}

    def _disturbed(self, target: str, n_samples: int, noise: float) -> Array:
        """Noise and the rig's sinusoidal disturbances on one signal, (n_samples, n)."""
        total = noise * self._rng.standard_normal((n_samples, self.n_axes))
        for d in self.rig.disturbances:
            if d.target == target:
                omega = 2 * np.pi * d.fixed_hz + d.order * self.rig.speed_rad_s
                t = (self._samples + np.arange(n_samples)) * self.rig.controller.sample_time_s
                total += d.amplitude * np.cos(omega * t[:, None] + d.phase_rad)
        return np.asarray(total)

    def advance(self, r: Array, check_limits: bool = True) -> Record:
        """Run the rig for the excitation ``r``, shape (N, n_axes), A, one row a sample.

        The record is shorter than ``r`` when a limit of the rig was exceeded; the rig goes on levitating and
        `advance` may be called again, with ``check_limits`` False while the excitation ramps down.
        """
        r = np.ascontiguousarray(r, dtype=float)
        noise = self.rig.noise
        added_i = self._disturbed("i", len(r), noise.current_a)
        added_y = self._disturbed("y", len(r), noise.displacement_m)
        done, exceeded, logged = self._loop.run(r, added_i, added_y, self._samples, check_limits)
        self._samples += done
        u, i, y = logged[:, :done]
        r_log, u, i, y = self._logged(r[:done], u, i, y)
        return Record(r_log, u, i, y, ("", "displacement", "current")[exceeded])

    def _logged(self, *signals: Array) -> tuple[Array, ...]:
        """Signals r, u, i, y as they are logged: u ``logging_offset_samples`` early, that is, the others late."""
        shift = round(self.rig.logging_offset_samples)
        if shift == 0:
            return signals
        out = []
        for k, x in enumerate(signals):
            if (k == 1) == (shift > 0):
                out.append(x)
                continue
            joined = np.vstack([self._log_tail.get(k, np.zeros((abs(shift), x.shape[1]))), x])
            self._log_tail[k] = joined[len(x) :]
            out.append(np.ascontiguousarray(joined[: len(x)]))
        return tuple(out)
