"""The magnets' nonlinearity under a multisine, whose lines excite the rotor together.

The phases of the lines are known, so currents and displacements are written as functions of time, the force is computed
from them, and its components at the lines are separated again as those of the signals were. The displacement used is
the measured one, as in `sim.harmonic_balance`, so no iteration is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.identification.plane.many_lines import ManyLines
from sim import actuator, magnetic_force
from sim.errors import AmbError
from sim.harmonic_balance import bearings_per_sensors, time_points
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class PhasesError(AmbError):
    """A multisine whose file lacks what is needed to write it as a function of time."""


@dataclass(frozen=True)
class Together:
    """All P points of a multisine with n axes, also those that an observation leaves out: they moved the rotor."""

    lines: ManyLines
    """with each of the B distinct realisations of the phases once"""
    times: Real
    """(B,) share of the blocks that had each realisation"""
    frequency_hz: Real
    """(F,) distinct"""
    line: NDArray[np.int64]
    """(P,) index into ``frequency_hz``"""
    U: Complex
    """(P, n) A"""
    I: Complex | None
    """(P, n) A"""
    Y: Complex
    """(P, n) m"""

    @staticmethod
    def of(sweep: Sweep) -> Together | None:
        """All points of a multisine; None for a stepped sine.

        Raises
        ------
        PhasesError
            The file has no phases, or no length of the period.
        """
        if sweep.kind != "multisine":
            return None
        lines = ManyLines.of(sweep, np.arange(sweep.n_points))
        if lines is None:
            raise PhasesError(
                f"sweep {sweep.comment!r} is a multisine without phase_rad and block_samples, so that nobody knows how "
                "its lines move the rotor together; record both, or run a stepped sine"
            )
        # Blocks of one realisation are the same periods again.
        _, first, count = np.unique(np.round(lines.phasor, 9), axis=1, return_index=True, return_counts=True)
        lines = replace(lines, phasor=lines.phasor[:, first])
        frequency, line = time_points(sweep.frequency_hz)
        f = sweep.harmonics.index(1)
        current = None if sweep.I is None else sweep.I.mean(axis=1)[:, f]
        return Together(
            lines, count / count.sum(), frequency, line, sweep.U.mean(axis=1)[:, f], current, sweep.Y.mean(axis=1)[:, f]
        )

    def force(self, rig: Rig) -> Complex:
        """Bearing force at the excited lines beyond the linear one, N, (P, n).

        It is computed from the measured current where there is one, so that errors of amplifiers do not enter.
        """
        model = linear_model(replace(rig, logging_offset_samples=0.0), self.frequency_hz)
        if self.I is None:
            late = 2 * np.pi * self.frequency_hz * rig.controller.sample_time_s * rig.logging_offset_samples
            u = self.U[..., None] * np.exp(-1j * late)[self.line, None, None]
        else:
            u = np.linalg.solve(model.i_per_u[self.line], self.I[..., None])
        flux, x, y = ((G[self.line] @ u)[..., 0] for G in (model.flux_per_u, model.bearing_per_u, model.y_per_u))
        own, to_bearings = bearings_per_sensors(rig, model.omega_rad_s)
        x = x + ((self.Y - y) * own[self.line]) @ to_bearings
        point = actuator.operating_point(rig)
        i_t, x_t = (self._in_time(v) for v in (flux, x))
        i_t = i_t + point.current_a
        beside = magnetic_force.played_per_displacement(rig.magnets, point) * x_t
        effective = magnetic_force.effective(rig.magnets, i_t, many_turns=True, beside_t=beside)
        excess = magnetic_force.beyond_linear(rig, point, i_t, effective, x_t)
        at_lines = self.lines.at_lines(excess.reshape(len(self.times), -1, *excess.shape[1:]).swapaxes(2, 3))
        return np.asarray(np.tensordot(self.times, at_lines, 1))

    def _in_time(self, columns: Complex) -> Real:
        """(blocks times experiments, samples, n) time functions of columns (P, n)."""
        x = self.lines.in_time(columns)
        return x.reshape(-1, *x.shape[2:]).swapaxes(1, 2)

    def displacement(self, rig: Rig, frequency_hz: Real, axis: NDArray[np.int64]) -> Complex:
        """What `force` adds to the sensors' signals, m, (P', n), at points of frequencies and axes (P',) each."""
        line = np.searchsorted(self.frequency_hz, frequency_hz)
        point_of = np.full((len(self.frequency_hz), self.U.shape[1]), -1)
        point_of[self.line, self.lines.axis] = np.arange(len(self.line))
        y_per_force = linear_model(rig, self.frequency_hz).y_per_force[line]
        return np.asarray((y_per_force @ self.force(rig)[point_of[line, axis], :, None])[..., 0])
