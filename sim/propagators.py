"""The linear work of one controller sample as matrices: exact between the steps, delays included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from sim.errors import LevitationError
from sim.rig import SHORTEST_LAG_S, Array, Rig
from sim.state_space import StateSpace

HISTORY = 8
"""Samples of u that are kept for delays."""


@dataclass(frozen=True)
class Propagators:
    """One sample as a product and its corrections: next = first^T [z, past u, d_before, d_0] + sum later_s^T d_s.

    ``next`` holds, for each integration step of the sample, what its correction and the sensors need of the state
    there (flux, displacement at the bearings, and where they are used current rate and sensor output), then the
    state at the end. So the linear work of a sample is one product, and each correction, once known, is added.
    """

    first: Array
    """(1, rows, columns): rows z, u of `history` past samples, the correction before the sample, that at its
    start; padded to multiples of 4 and 8 for the compiled loop."""
    later: Array
    """(substeps - 1, corrections, columns): corrections of the steps inside the sample, padded alike."""
    history: int
    n_z: int
    n_seen: int
    """Signals that are seen at each step."""
    n_d: int
    """Corrections of each step."""
    fall: Array
    """(n,) time constants in a step of amplifiers whose rate u drives at once, 0 for others."""
    late: Array
    """(3, n) whole samples after which a new value of each control signal acts on those, integration steps beyond, and
    steps of a lag that is among them."""

    @property
    def z_at(self) -> int:
        """Column of the first state."""
        return self.n_seen * (len(self.later) + 1)


@dataclass(frozen=True)
class AskedRate:
    """Rate of the coil current that an amplifier is asked for, as its voltage limit sees it."""

    per_state: Array
    """(n, z)"""
    per_input: Array
    """(n, n) of control signals that drive the rate of amplifiers of first order at once."""
    later_s: float
    """How much later than on the state a control signal acts on it, s."""


def asked_rate(rig: Rig, ss: StateSpace, substeps: int) -> AskedRate:
    """A lag before amplifiers of first order that is shorter than half a step is a delay, to what the limit sees.

    Its rise is too fast for the steps: seen at their beginnings, the slope would be that of the sample before, and the
    current of an amplifier at its limit up to 9 % off. What is left, with four steps of 25 us a sample, is 0.8 % up to
    950 Hz, and 3 % with a lag of 15 us, which is followed step by step; with sixteen steps 0.5 and 0.2 %.
    """
    amp = rig.amplifiers
    step = rig.controller.sample_time_s / substeps
    if amp.damping_ratio is not None or not SHORTEST_LAG_S < amp.lag_s < step / 2:
        return AskedRate(ss.current_rate, ss.current_rate_input, 0.0)
    lagged = np.any(ss.drive != 0, axis=1)
    through = amp.lag_s * ss.current_rate[:, lagged] @ ss.drive[lagged]
    return AskedRate(np.where(lagged, 0.0, ss.current_rate), through, amp.lag_s)


def propagators(rig: Rig, ss: StateSpace, seen: Array, asked: AskedRate, substeps: int, slews: bool) -> Propagators:
    """The linear work of one sample, for a rig whose corrections see ``seen`` (rows per state) of each step.

    ``asked`` is the rate among those rows, of `asked_rate`.

    Raises
    ------
    LevitationError
        A delay longer than any loop stands.
    """
    step = rig.controller.sample_time_s / substeps
    n, n_z = rig.n_axes, len(ss.A)
    corrections = np.hstack([ss.force_input, ss.slew_input] if slews else [ss.force_input])
    free, constant, growing = _input_integrals(ss.A, corrections, step)
    at_once = np.any(asked.per_input != 0, axis=1)
    fall = np.where(at_once, rig.amplifiers.natural_frequency_rad_s * step, 0.0)
    if slews:  # a rate that u drives at once jumps with it: it has no slope to go on with
        growing[:, n:] *= ~at_once
    late = _late(rig, asked, substeps)
    drive = _drive(rig, ss, substeps)
    history = int(max(np.flatnonzero(np.any(drive, axis=(0, 2, 3)))[-1], np.max(late[0] + (late[1] > 0)))) + 1
    n_u, n_d = history * n, constant.shape[1]
    # z, and what is seen of it, as linear maps of [z, past u, d_before, d_0, d_1, ..]
    size = n_z + n_u + (substeps + 1) * n_d
    z, maps = np.eye(n_z, size), []
    for k in range(substeps):
        z = free @ z
        z[:, n_z : n_z + n_u] += drive[k, :history].reshape(n_u, n_z).T
        # ETD2 (Cox and Matthews 2002, eq. 6): the correction goes on with the slope of its last step.
        before = n_z + n_u + k * n_d
        z[:, before : before + n_d] -= growing
        z[:, before + n_d : before + 2 * n_d] += constant + growing
        maps.append(seen @ z)
    first, later = _in_blocks(np.vstack([*maps, z]).T, n_z + n_u + 2 * n_d, n_d, substeps)
    return Propagators(first, later, history, n_z, len(seen), n_d, fall, late)


def _input_integrals(A: Array, inputs: Array, t: float) -> tuple[Array, Array, Array]:
    """exp(A t), integral of exp(A (t - s)) B ds, and the same with B growing linearly from 0 to 1."""
    n_z, m = inputs.shape
    block = np.zeros((n_z + 2 * m, n_z + 2 * m))
    block[:n_z, :n_z], block[:n_z, n_z : n_z + m] = A * t, inputs * t
    block[n_z : n_z + m, n_z + m :] = np.eye(m)
    e = expm(block)
    return e[:n_z, :n_z], e[:n_z, n_z : n_z + m], e[:n_z, n_z + m :]


def _drive(rig: Rig, ss: StateSpace, substeps: int) -> Array:
    """What each control signal, now and in the samples before, adds to the state: (steps, samples back, n, n_z)."""
    step, n = rig.controller.sample_time_s / substeps, rig.n_axes
    drive = np.zeros((substeps, HISTORY, n, len(ss.A)))
    delays = rig.amplifiers.delay_s + rig.controller.computing_delay_s
    for axis in range(n):
        column = ss.drive[:, axis : axis + 1]
        whole, rest = divmod(delays[axis] / rig.controller.sample_time_s + 1e-9, 1.0)
        rest = rest if rest > 2e-9 else 0.0
        if whole + 1 >= HISTORY:
            raise LevitationError(f"rig {rig.name}: a loop delay of {delays[axis]:.2e} s cannot be levitated")
        entire = _input_integrals(ss.A, column, step)[1][:, 0]
        for k in range(substeps):
            # The new value acts from `switch` on, within this step or before or after it.
            switch = min(max(rest * substeps - k, 0.0), 1.0) * step
            after = entire if switch == 0 else _input_integrals(ss.A, column, step - switch)[1][:, 0]
            drive[k, int(whole), axis] += after
            drive[k, int(whole) + 1, axis] += entire - after
    return drive


def _late(rig: Rig, asked: AskedRate, substeps: int) -> Array:
    """When a new value of each control signal acts on the rate that is asked for, as in `Propagators.late`."""
    period = rig.controller.sample_time_s
    delays = rig.amplifiers.delay_s + rig.controller.computing_delay_s
    late = np.zeros((3, rig.n_axes))
    for axis in range(rig.n_axes):
        late[:2, axis] = divmod((delays[axis] + asked.later_s) / period + 1e-9, 1.0)
        late[1, axis] = substeps * late[1, axis] if late[1, axis] > 2e-9 else 0.0
        late[2, axis] = asked.later_s * substeps / period
    return late


def _in_blocks(weights: Array, known: int, n_d: int, substeps: int) -> tuple[Array, Array]:
    """Weights of what is ``known`` as a sample begins, and of each later step's corrections, padded."""
    columns = -(-weights.shape[1] // 8) * 8
    first = np.zeros((1, -(-known // 4) * 4, columns))
    first[0, :known, : weights.shape[1]] = weights[:known]
    later = np.zeros((substeps - 1, -(-n_d // 4) * 4, columns))
    later[:, :n_d, : weights.shape[1]] = weights[known:].reshape(substeps - 1, n_d, weights.shape[1])
    return first, later
