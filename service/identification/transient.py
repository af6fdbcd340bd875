"""What had not died away when a point was recorded, taken out of its blocks.

A tone that starts, or follows another, makes the slow poles of the closed loop ring. A mode of 500 Hz that the loop
damps with 5 1/s still holds a fifth of its transient after 0.3 s, and a damping ratio read from such points is off by a
tenth. Model and controller know the pole p and the shape c of its ringing in u: seen through the plant it leaves

    alpha lambda^b (G(p) - G(jw)) c,    lambda = exp((p - jw) T),

in what y differs from G u in block b of length T (and the same for i with the amplifier), so that one complex number
alpha per point is all that is unknown. It shows in how the blocks change from one to the next. The alphas of a pole
have a common size (r/(jw - p), times what one start leaves), estimated by maximum likelihood, and each is drawn
towards zero by as much as its own uncertainty asks for (empirical Bayes). What stays unknown of it is added to the
covariance of the point's mean. Where the blocks show no transient beyond doubt, and none that looks different with time
reversed, nothing is changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from service.identification.closed_loop import Sampled, closed_loop_poles, companion, sampled
from service.identification.noise import NoiseModel
from service.identification.plane_model import PlaneModel
from service.identification.points import PlanePoints
from service.identification.refine import refine
from service.identification.residuals import Data, noise_of, predicted_blocks, residual_blocks
from service.identification.split import Split, log_ratios
from service.identification.zoh import Complex, Real

GONE = 0.3
"""What is left of a transient after one block below which a pole is not looked at."""
EVIDENCE = 6.5
"""Gain of log likelihood beyond which blocks show a transient: chance has more in three of a thousand cases. Where the
length of the blocks is looked for, more by the logarithm of how many were tried."""
SUSPECTED = 2.0
"""The same where the other plane's points, recorded alike, show one: what stays below still biases a damping."""
BLOCK_S = np.geomspace(0.01, 1.0, 231)
"""Lengths of blocks, s, to be tried where a file does not tell them; each is made whole periods."""
NOISE = 1.3
"""So many times as much has to be gained as with time reversed. A mode that noise keeps ringing looks the same either
way; one that dies away does not."""
SIZES = 121
"""Of the grid on which the size of a transient is looked for."""
ROUNDS = 3
"""What is taken out makes the model better, and a better model knows better what to take out."""


@dataclass(frozen=True)
class Transient:
    """A pole that was still ringing."""

    pole: complex
    """rad/s, of the closed loop."""
    share: float
    """Largest size in a point's mean over the standard deviation of its noise."""
    evidence: float
    """Gain of log likelihood."""
    block_s: float | None = None
    """Length of the blocks that it told, before they are made whole periods; None where it was known."""


def told(transient: Transient) -> str:
    """A transient in words."""
    hz, rate = abs(transient.pole.imag) / (2 * np.pi), -transient.pole.real
    where = f"{hz:.4g} Hz mode of the closed loop" if hz > 1 else "slow part of the closed loop"
    return (
        f"points were recorded while the {where} still rang (it decays with {rate:.2g} 1/s): what it left, up to "
        f"{transient.share:.2g} times the noise, was taken out; settle longer and the standard deviations fall"
    )


def settled(
    data: Data,
    model: PlaneModel,
    free: NDArray[np.bool_],
    controller: tuple[Real, Real],
    block_s: Real | float | None,
    suspected: bool = False,
) -> tuple[Data, tuple[Transient, ...]]:
    """The data without what was still ringing, or as they are where nothing was.

    Parameters
    ----------
    data, model, free
        A joint fit, and which parameters it moved.
    controller
        Numerator and denominator of u = C(z)(-y), as it ran.
    block_s
        (P,) length of each point's blocks, s; or one length, of which they are the nearest whole periods; None where
        nothing tells it.
    suspected
        Whether points that were recorded alike show a transient.
    """
    measured, now = data.plant, data
    transients: tuple[Transient, ...] = ()
    for _ in range(ROUNDS):
        noise = noise_of(model, replace(now.plant, unsettled=None), None)
        points, found = without_transients(measured, model, controller, noise, block_s, suspected)
        if not found:
            return data, ()
        now, transients = replace(now, plant=points), found
        model = refine(model, now, free, split=Split(log_ratios(model))).model
    return now, transients


@dataclass(frozen=True)
class _Ringing:
    """One pole over the points: what a unit of it leaves in the first block, and how it goes on."""

    start: Complex
    """(P, c) before it is averaged over the first block."""
    mean: Complex
    """(P,) what averaging makes of it."""
    powers: Complex
    """(P, B)"""

    @property
    def trace(self) -> Complex:
        """What is left in the first block, (P, c)."""
        return self.mean[:, None] * self.start

    def backwards(self) -> _Ringing:
        """The same with time reversed."""
        return replace(self, powers=self.powers[:, ::-1].conj())


def without_transients(
    points: PlanePoints,
    model: PlaneModel,
    controller: tuple[Real, Real],
    noise: NoiseModel,
    block_s: Real | float | None,
    suspected: bool = False,
) -> tuple[PlanePoints, tuple[Transient, ...]]:
    """The points as they would be had they settled, and what was taken out.

    Parameters
    ----------
    points
        As measured, one axis at a time.
    model, controller
        The plane, well enough known to tell where the loop's poles are.
    noise
        Of the points' means; its own estimate of what scatters may hold the transient the first time.
    block_s
        See `settled`; None: lengths are looked for.
    suspected
        See `settled`.
    """
    i, y = predicted_blocks(model, points, None)
    e = residual_blocks(points, i, y)
    white = noise.whitener() / np.sqrt(points.n_blocks)
    found: list[Transient] = []
    unknown = np.zeros((len(points.omega), e.shape[2], e.shape[2]), dtype=complex)
    lengths = _lengths(points.omega, block_s)
    least = SUSPECTED if suspected else EVIDENCE
    told_by = None
    loops = {pole: _Loop.of(points, model, controller, pole) for pole in _slow_poles(model, controller)}
    while loops:  # the loudest first: it also tells how long the blocks are
        along = {pole: _Along.of(loop.start, e, white) for pole, loop in loops.items()}
        tried = {
            (pole, k): _evidence(loop.ringing(t), along[pole], points)
            for pole, loop in loops.items()
            for k, t in enumerate(lengths)
            if np.exp(pole.real * np.median(t)) > GONE
        }
        if not tried:
            break
        (pole, length), (evidence, size) = max(tried.items(), key=lambda item: item[1][0])
        backwards = loops[pole].ringing(lengths[length]).backwards()
        if evidence < least + np.log(len(lengths)) + NOISE * _evidence(backwards, along[pole], points)[0]:
            loops.pop(pole)
            continue
        told_by = BLOCK_S[length] if len(lengths) > 1 else told_by
        lengths = [lengths[length]]
        best = loops.pop(pole).ringing(lengths[0])
        estimate, variance = _estimates(best, along[pole])
        keep = size / (size + variance)
        alpha = np.nan_to_num(keep * estimate)
        taken = alpha[:, None, None] * best.powers[:, :, None] * best.trace[:, None, :]
        e = e - taken
        mean = best.powers.mean(axis=1)[:, None] * best.trace
        left = np.nan_to_num(size * variance / (size + variance), posinf=0.0)
        left = np.where(np.isinf(variance), size, left)
        unknown += left[:, None, None] * np.einsum("pc,pd->pcd", mean, mean.conj())
        share = np.abs(taken.mean(axis=1)) / noise.sigma
        found.append(Transient(pole, float(share.max()), evidence, None if told_by is None else float(told_by)))
        points = _less(points, taken)
    return (replace(points, unsettled=unknown) if found else points), tuple(found)


def _lengths(omega: Real, block_s: Real | float | None) -> list[Real]:
    """Lengths of blocks to be tried, (P,) each."""
    if isinstance(block_s, np.ndarray):
        return [block_s]
    return [_whole_periods(omega, float(t)) for t in (BLOCK_S if block_s is None else [block_s])]


def _less(points: PlanePoints, taken: Complex) -> PlanePoints:
    if points.I is None:
        return replace(points, Y=points.Y - taken)
    return replace(points, I=points.I - taken[:, :, :2], Y=points.Y - taken[:, :, 2:])


def _slow_poles(model: PlaneModel, controller: tuple[Real, Real]) -> list[complex]:
    """Poles of the loop that the shortest block does not outlast, one of each pair, rad/s."""
    z = closed_loop_poles(model, controller)
    z = z[(np.abs(z) > 1e-6) & (np.abs(z) < 1.0) & (z.imag >= 0)]
    s = np.log(z) / model.known.sample_time_s
    return [complex(p) for p in s if np.exp(p.real * BLOCK_S[0]) > GONE]


def _whole_periods(omega: Real, seconds: float) -> Real:
    """Blocks of about so many seconds, at least one period, (P,) s."""
    period = 2 * np.pi / omega
    return np.asarray(np.maximum(1, np.round(seconds / period)) * period)


@dataclass(frozen=True)
class _Loop:
    """What does not hang on the length of the blocks."""

    points: PlanePoints
    away: Complex
    """(P,) (p - jw) times the sample time."""
    start: Complex
    """(P, c) of a transient as large as a start from rest leaves it, before it is averaged over a block."""
    sample_time_s: float

    @classmethod
    def of(cls, points: PlanePoints, model: PlaneModel, controller: tuple[Real, Real], pole: complex) -> _Loop:
        """For one pole."""
        period, omega = model.known.sample_time_s, points.omega
        system = _with_currents(model, sampled(model))
        z = np.exp(pole * period)
        at_pole = _transfer(system, np.array([z]))[0]
        c = complex(np.polyval(controller[0], z) / np.polyval(controller[1], z))
        _, _, vh = np.linalg.svd(np.eye(2) + c * at_pole[2:])
        seen = (at_pole - _transfer(system, np.exp(1j * omega * period))) @ vh[-1].conj()
        start = np.abs(points.r[np.arange(len(omega)), points.axis]) / np.abs(1j * omega - pole)
        left = start[:, None] * (seen if points.I is not None else seen[:, 2:])
        return cls(points, np.asarray((pole - 1j * omega) * period, dtype=np.complex128), left, period)

    def ringing(self, block_s: Real) -> _Ringing:
        """For blocks of a length, (P,) s."""
        turn = np.exp(self.away * (block_s / self.sample_time_s))
        mean = (turn - 1.0) / (np.expm1(self.away) * block_s / self.sample_time_s)
        powers = turn[:, None] ** np.arange(self.points.n_blocks)
        return _Ringing(self.start, np.asarray(mean, dtype=np.complex128), np.asarray(powers, dtype=np.complex128))


def _with_currents(model: PlaneModel, loop: Sampled) -> Sampled:
    """The same system with the sampled coil currents before the displacements among its outputs."""
    seen = block_diag(*[companion(a.poles, a.dc_gain)[2] for a in model.amplifiers])
    return replace(loop, C=np.vstack([np.pad(seen, ((0, 0), (0, len(loop.A) - seen.shape[1]))), loop.C]))


def _transfer(system: Sampled, z: Complex) -> Complex:
    inner = z[:, None, None] * np.eye(len(system.A)) - system.A
    right = np.broadcast_to(system.B.astype(complex), (len(z), *system.B.shape))
    return np.asarray(system.C @ np.linalg.solve(inner, right))


@dataclass(frozen=True)
class _Along:
    """The blocks' residuals along the trace of a pole, which does not hang on the length of the blocks."""

    product: Complex
    """(P, B) in units of the noise."""
    size: Real
    """(P,) of the trace, squared."""

    @classmethod
    def of(cls, trace: Complex, e: Complex, white: Complex) -> _Along:
        """For residuals (P, B, c) and their whitening (P, c, c)."""
        unit = np.einsum("pcd,pd->pc", white, trace)
        product = np.einsum("pd,pbd->pb", np.einsum("pc,pcd->pd", unit.conj(), white), e)
        return cls(np.asarray(product), np.sum(np.abs(unit) ** 2, axis=1))


def _estimates(ringing: _Ringing, along: _Along) -> tuple[Complex, Real]:
    """alpha of each point by least squares over the blocks, the settled value free, and its variance, (P,) each."""
    change = ringing.powers - ringing.powers.mean(axis=1, keepdims=True)
    weight = np.sum(np.abs(change) ** 2, axis=1) * np.abs(ringing.mean) ** 2 * along.size
    product = ringing.mean.conj() * np.sum(change.conj() * along.product, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(product / weight), np.asarray(1.0 / weight)


def _evidence(ringing: _Ringing, along: _Along, points: PlanePoints) -> tuple[float, Real]:
    """Gain of log likelihood when a transient of the best common size is allowed, and that variance, (P,).

    Tones at either bearing leave transients of different size.
    """
    alpha, variance = _estimates(ringing, along)
    total, size = 0.0, np.zeros(len(alpha))
    for axis in (0, 1):
        mine = (points.axis == axis) & np.isfinite(variance)
        if not mine.any():
            continue
        square, v = np.abs(alpha[mine]) ** 2, variance[mine]
        grid = np.geomspace(1e-3 * v.min(), 10 * square.max() + 1e-3 * v.min(), SIZES)
        sum_ = grid[:, None] + v
        gain = np.sum(np.log(v / sum_) + square * (1 / v - 1 / sum_), axis=1)
        best = int(np.argmax(gain))
        if gain[best] > 0:
            total += float(gain[best])
            size[points.axis == axis] = grid[best]
    return total, size
