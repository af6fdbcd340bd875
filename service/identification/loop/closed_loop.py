"""The sampled closed loop of an identified plane with any controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import companion as companion_matrix
from scipy.linalg import expm

from service.identification.arrays import Complex, Real
from service.identification.plane.amplifier import Amplifier
from service.identification.plane.combine import physical_matrices
from service.identification.plane.model import PlaneModel
from sim.chain import Chain
from sim.errors import AmbError
from sim.rig import SHORTEST_LAG_S


@dataclass(frozen=True)
class Sampled:
    """x+ = A x + B u, y = C x at the controller's samples, from u as computed to y as sampled."""

    A: Real
    B: Real
    C: Real

    def response(self, omega: Real, sample_time_s: float) -> Complex:
        """Response at frequencies, (P, outputs, inputs)."""
        z = np.exp(1j * omega * sample_time_s)[:, None, None]
        inner = z * np.eye(len(self.A)) - self.A
        right = np.broadcast_to(self.B.astype(complex), (len(omega), *self.B.shape))
        return np.asarray(self.C @ np.linalg.solve(inner, right))


def continuous(model: PlaneModel) -> tuple[Real, Real, Real]:
    """A, B, C from the control signals to the sensors' outputs, without hold and delays; amplifiers' states first."""
    a, b, c = physical_matrices(model)
    chain = model.known.chain
    amp_a, amp_b, amp_c = driven(model.amplifiers, chain)
    n = len(amp_a)
    whole_a = np.block([[amp_a, np.zeros((n, len(a)))], [b @ amp_c, a]])
    whole_b = np.vstack([amp_b, np.zeros((len(a), 2))])
    whole_c = np.hstack([np.zeros((2, n)), c])
    return with_known_sensors(whole_a, whole_b, whole_c, model.known.sensor_bandwidth_rad_s, chain.sensor_lag_s)


def driven(amplifiers: Sequence[Amplifier], chain: Chain) -> tuple[Real, Real, Real]:
    """A, B, C from the control signals to the flux-making currents; the amplifiers' own states first."""
    parts = [companion(amp.poles, amp.dc_gain) for amp in amplifiers]
    a, b, c = (block_diagonal([p[k] for p in parts]) for k in range(3))
    b = b @ chain.crosstalk
    if not chain.is_before_flux:
        return a, b, c
    fa, fb, fc, fd = chain.flux_states()
    whole = np.block([[a, np.zeros((len(a), len(fa)))], [fb @ c, fa]])
    return whole, np.vstack([b, np.zeros((len(fa), b.shape[1]))]), np.hstack([fd @ c, fc])


def block_diagonal(parts: Sequence[Real]) -> Real:
    """The blocks along the diagonal, zero beside them: a deviation asks for it hundreds of times."""
    out = np.zeros((sum(len(p) for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for p in parts:
        out[row : row + len(p), column : column + p.shape[1]] = p
        row, column = row + len(p), column + p.shape[1]
    return out


def with_known_sensors(a: Real, b: Real, c: Real, bandwidth_rad_s: Real, lag_s: Real) -> tuple[Real, Real, Real]:
    """The same system with the lags of its sensors, those of the datasheet and the further one that is known."""
    a, b, c = with_sensor_lags(a, b, c, bandwidth_rad_s)
    return with_sensor_lags(a, b, c, np.where(lag_s > SHORTEST_LAG_S, 1.0 / np.maximum(lag_s, SHORTEST_LAG_S), np.inf))


def with_sensor_lags(a: Real, b: Real, c: Real, bandwidth_rad_s: Real) -> tuple[Real, Real, Real]:
    """The same system with one more state for each sensor that lags; inf for one that does not."""
    outputs, inputs = len(c), b.shape[1]
    for j, w in enumerate(bandwidth_rad_s):
        if math.isfinite(w):
            size = len(a)
            a = np.block([[a, np.zeros((size, 1))], [w * c[j], np.array([[-w]])]])
            b = np.vstack([b, np.zeros((1, inputs))])
            c = np.hstack([c, np.zeros((outputs, 1))])
            c[j] = 0.0
            c[j, -1] = 1.0
    return a, b, c


def companion(poles: Complex, gain: float) -> tuple[Real, Real, Real]:
    """Controllable form of gain prod(-p) / prod(s - p), its states scaled to be of one size."""
    n = len(poles)
    w = float(np.exp(np.mean(np.log(np.abs(poles)))))
    coefficients = np.real(np.poly(poles / w))
    a = np.eye(n, k=1)
    a[-1] = -coefficients[:0:-1]
    b, c = np.zeros((n, 1)), np.zeros((1, n))
    b[-1, 0] = w
    c[0, 0] = gain * coefficients[-1]
    return w * a, b, c


def sampled(model: PlaneModel) -> Sampled:
    """Exact discretisation with zero-order hold and delay, each sensor with its own dead time: see `held`."""
    known = model.known
    return held(
        *continuous(model), known.sample_time_s, [model.delay_s + known.computing_delay_s], known.chain.sensor_delay_s
    )


def held(
    a: Real, b: Real, c: Real, period: float, delays_s: Sequence[float], dead_s: Real, keeps_all: bool = False
) -> Sampled:
    """x' = A x + B u, y = C x with hold and delays (Astrom and Wittenmark, Computer-Controlled Systems, 3.2).

    The dead time that all outputs have acts as one before the inputs do; what one has more delays that output.

    Parameters
    ----------
    delays_s
        Of the inputs, which are shared out in turn among as many planes of two, s.
    dead_s
        Of each output, s.
    keeps_all
        Whether u(k - 1) is among the states where nothing is delayed, too: so that no step of a delay adds states.

    Returns
    -------
    The plant's states first, then the past inputs of each plane, the latest first, then those of outputs that are late.
    """
    n, common = len(a), float(np.min(dead_s))
    drives = []
    for delay_s in delays_s:
        delay = max(delay_s + common, 0.0)
        whole = math.floor(delay / period + 1e-9)
        drives.append((whole, max(delay - whole * period, 0.0), 0 if delay < 1e-12 and not keeps_all else whole + 1))
    size = n + 2 * sum(kept for _, _, kept in drives)
    big, drive = np.zeros((size, size)), np.zeros((size, b.shape[1]))
    big[:n], drive[:n] = _within(a, b, period, drives)
    at = n
    for k, (_, _, kept) in enumerate(drives):
        for j in range(kept):
            rows = slice(at + 2 * j, at + 2 * j + 2)
            if j == 0:
                drive[rows, 2 * k : 2 * k + 2] = np.eye(2)
            else:
                big[rows, at + 2 * j - 2 : at + 2 * j] = np.eye(2)
        at += 2 * kept
    plant = Sampled(big, drive, np.hstack([c, np.zeros((len(c), size - n))]))
    for j, late in enumerate(dead_s - common):
        if late > 1e-12:
            samples = math.ceil(late / period - 1e-9)
            state, now = _within(a, b, max(samples * period - late, 0.0), drives)
            plant = _late_output(plant, j, samples, c[j] @ state, c[j] @ now)
    return plant


def _within(a: Real, b: Real, seconds: float, drives: Sequence[tuple[int, float, int]]) -> tuple[Real, Real]:
    """State so long after a sample, up to the next one, of that at the sample with past inputs, and of its u.

    Of each plane's two inputs: whole samples of delay, what there is beyond them, s, and how many past ones are kept.
    """
    n = len(a)
    state, now = np.zeros((n, n + 2 * sum(kept for _, _, kept in drives))), np.zeros((n, b.shape[1]))
    at = n
    for k, (whole, rest, kept) in enumerate(drives):
        columns = slice(2 * k, 2 * k + 2)
        phi_late, gamma_late = integrated(a, b[:, columns], min(rest, seconds))
        phi_first, gamma_first = integrated(a, b[:, columns], max(seconds - rest, 0.0))
        state[:, :n] = phi_first @ phi_late  # of each plane the same
        if kept:
            # the input of one sample earlier acts first
            state[:, at + 2 * whole : at + 2 * whole + 2] = phi_first @ gamma_late
        if whole == 0:
            now[:, columns] = gamma_first
        else:
            state[:, at + 2 * (whole - 1) : at + 2 * whole] = gamma_first
        at += 2 * kept
    return state, now


def _late_output(plant: Sampled, j: int, samples: int, state: Real, now: Real) -> Sampled:
    """The plant whose output ``j`` is what ``state`` and ``now`` make of state and u, so many samples later."""
    n = len(plant.A)
    size = n + samples
    A, B, C = np.zeros((size, size)), np.zeros((size, plant.B.shape[1])), np.zeros((len(plant.C), size))
    A[:n, :n], B[:n], C[:, :n] = plant.A, plant.B, plant.C
    A[n, : len(state)], B[n] = state, now
    A[n + 1 :, n : size - 1] = np.eye(samples - 1)
    C[j] = 0.0
    C[j, -1] = 1.0
    return Sampled(A, B, C)


def integrated(a: Real, b: Real, seconds: float) -> tuple[Real, Real]:
    """exp(A t) and the integral of exp(A s) B from 0 to t."""
    n = len(a)
    both = expm(np.block([[a, b], [np.zeros((b.shape[1], n + b.shape[1]))]]) * seconds)
    return both[:n, :n], both[:n, n:]


def with_currents(model: PlaneModel, plant: Sampled) -> Sampled:
    """The same system with the sampled coil currents before the displacements among its outputs."""
    seen = block_diagonal([companion(a.poles, a.dc_gain)[2] for a in model.amplifiers])
    return replace(plant, C=np.vstack([np.pad(seen, ((0, 0), (0, len(plant.A) - seen.shape[1]))), plant.C]))


@dataclass(frozen=True)
class LoopStates:
    """x+ = A x + N n with u = C(z)(-y - n), n the sensors' noise; the plant's states first."""

    A: Real
    """(states, states)"""
    N: Real
    """(states, 2), of n in m."""


def loop_states(model: PlaneModel, controller: tuple[Real, Real]) -> LoopStates:
    """The sampled loop u = C(z)(-y), the same law in both axes.

    Raises
    ------
    AmbError
        The model is none of a rotor: a fit that ended anywhere.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        plant = sampled(model)
    if not np.isfinite(plant.A).all():
        fastest = float(np.abs(model.modes[:, 0]).max(initial=0.0)) / (2 * np.pi)
        raise AmbError(
            f"the joint fit ended far from any rotor (a mode at {fastest:.2g} Hz): the points do not tell the modes; "
            "measure more of them, above all around the peaks"
        )
    ca, cb, cc, cd = (block_diagonal([x, x]) for x in controller_states(controller))
    top = np.hstack([plant.A - plant.B @ cd @ plant.C, plant.B @ cc])
    bottom = np.hstack([-cb @ plant.C, ca])
    return LoopStates(np.vstack([top, bottom]), -np.vstack([plant.B @ cd, cb]))


def controller_states(controller: tuple[Real, Real]) -> tuple[Real, Real, Real, Real]:
    """A (s, s), B (s, 1), C (1, s), D (1, 1) of one axis's discrete controller; a plain gain has no state.

    The controller canonical form, as of `scipy.signal.tf2ss`, which takes half a second to import.
    """
    numerator, denominator = (np.trim_zeros(np.asarray(x, dtype=float), "f") for x in controller)
    order = len(denominator) - 1
    b = np.concatenate([np.zeros(order + 1 - len(numerator)), numerator]) / denominator[0]
    a = denominator / denominator[0]
    A = companion_matrix(a) if order else np.zeros((0, 0))
    return A, np.eye(order, 1), (b[1:] - b[0] * a[1:])[None], b[:1, None]


def closed_loop_poles(model: PlaneModel, controller: tuple[Real, Real]) -> Complex:
    """Eigenvalues of `loop_states`; stable within the unit circle."""
    return np.asarray(np.linalg.eigvals(loop_states(model, controller).A), dtype=np.complex128)


def slowest_decay(poles: Complex, sample_time_s: float) -> float:
    """Rate at which the closed loop's slowest transient decays, 1/s; negative where one grows.

    >>> round(slowest_decay(np.array([0.5 + 0j, 0.99]), 1e-3), 2)
    10.05
    """
    return float(-np.log(np.max(np.abs(poles))) / sample_time_s)
