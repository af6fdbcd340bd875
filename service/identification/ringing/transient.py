"""What rang while a point was recorded, taken out of its blocks.

A tone that starts, or follows another, makes the slow poles of the closed loop ring. A mode of 500 Hz that the loop
damps with 5 1/s still holds a fifth of its transient after 0.3 s, and a damping ratio read from such points is off by a
tenth. Model and controller know the pole p and the shape c of its ringing in u: seen through the plant it leaves

    alpha lambda^b (G(p) - G(jw)) c,    lambda = exp((p - jw) T),

in what y differs from G u in block b of length T (and the same for i with the amplifier), so that one complex number
alpha per point is all that is unknown. It shows in how the blocks change from one to the next; a mode of 900 Hz that
the loop damps with 60 1/s dies within the first one, and is still several times the noise in a point's mean.

Noise keeps the loop moving as well (`leakage`): beside a mode that the loop damps with 1 1/s
that is a hundred times the noise itself, all blocks of a point alike, and a damping ratio that takes it for scatter is
off by half.

What both put into the blocks, and how well that is known, is the business of `transient_size`;
what is not known is added to the covariance of the point's mean. Where the blocks show nothing of either beyond doubt
nothing is changed. Where noise keeps the loop ringing, what is left of a mode's start may not show beyond doubt and
still be several deviations of a damping: 2 % of it bias one by 0.7 %. It is then allowed for with the size that the
blocks let expect of it (`Taken.allowed`), and nobody is told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert

from service.identification.arrays import Complex, Real
from service.identification.joint.refine import refine
from service.identification.joint.residuals import noise_of, predicted_blocks, residual_blocks
from service.identification.measured.data import Data
from service.identification.measured.noise import NoiseModel
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Split
from service.identification.ringing.leakage import leakage
from service.identification.ringing.pole import RingingPole, as_it_ran, slow_poles
from service.identification.ringing.transient_size import Along, Source, Taken, evidence_of

GONE = 1e-3
"""What is left of a transient after one block below which a pole is not looked at. One that dies within the first block
is in that block alone, in a form that model and controller know."""
LASTING = 0.3
"""The same above which it rings over several blocks: only such a one tells how long they are, can be told from noise
where noise keeps it up, and is worth a word."""
EVIDENCE = 6.5
"""Gain of log likelihood beyond which blocks show a transient: chance has more in three of a thousand cases. More by
the logarithm of how many poles, and lengths of blocks where these are looked for, were tried."""
SUSPECTED = 2.0
"""The same where the other plane's points, recorded alike, show one: what stays below still biases a damping."""
BLOCK_S = np.geomspace(0.01, 1.0, 231)
"""Lengths of blocks, s, to be tried where a file does not tell them; each is made whole periods."""
ROUNDS, MOVED = 8, 0.02
"""What is taken out makes model and noise better, and these know better what to take out: so many times at most, until
the loop's slow poles move by less than this of the rate at which they decay."""


@dataclass(frozen=True)
class Transient:
    """A pole that rang."""

    pole: complex
    """rad/s, of the closed loop."""
    share: float
    """Largest size in a point's mean over the standard deviation of its noise."""
    evidence: float
    """Gain of log likelihood."""
    left: float
    """Of it after one block."""
    block_s: float | None = None
    """Length of the blocks that it told, before they are made whole periods; None where it was known."""


def _few(size: float) -> str:
    """Two figures without an exponent.

    >>> _few(2.71), _few(412.0)
    ('2.7', '410')
    """
    return f"{float(f'{size:.2g}'):.6g}"


def told(transient: Transient) -> str:
    """A transient in words."""
    hz, rate = abs(transient.pole.imag) / (2 * np.pi), -transient.pole.real
    where = f"{hz:.4g} Hz mode of the closed loop" if hz > 1 else "slow part of the closed loop"
    return (
        f"points were recorded while the {where} still rang (it decays with {rate:.2g} 1/s): what it left, up to "
        f"{_few(transient.share)} times the noise, was taken out, and what is not known of it is in the "
        "standard deviations"
    )


def settled(
    data: Data,
    model: PlaneModel,
    free: NDArray[np.bool_],
    controller: tuple[Real, Real],
    block_s: Real | float | None,
    suspected: bool = False,
) -> tuple[Data, tuple[Transient, ...]]:
    """The data without what rang, or as they are where nothing did.

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
    measured, now, told_by = data.plant, data, None
    if block_s is None:
        block_s = told_by = length_of_blocks(measured, model, controller, suspected)
        if block_s is None:
            return data, ()
    seconds = block_s if isinstance(block_s, np.ndarray) else _whole_periods(measured.omega, block_s)
    transients: tuple[Transient, ...] = ()
    poles: list[complex] = []
    for _ in range(ROUNDS):
        model = as_it_ran(model, controller, 1 / (measured.n_blocks * float(np.median(seconds))))
        before, poles = poles, slow_poles(model, controller, float(np.median(seconds)), LASTING)
        if len(before) == len(poles) and all(abs(p - q) < MOVED * -p.real for p, q in zip(poles, before, strict=True)):
            break
        noise = _noise(now.plant, model, controller, seconds)
        points, transients = without_ringing(measured, model, controller, noise, seconds, suspected)
        if points is measured:
            return data, ()
        now = replace(now, plant=points)
        model = refine(model, now, free, split=Split.of(model, float(measured.omega.max()))).model
    return now, tuple(replace(t, block_s=told_by) for t in transients)


def _noise(points: PlanePoints, model: PlaneModel, controller: tuple[Real, Real], seconds: Real) -> NoiseModel:
    """That of the points' means beside what rings: by what their blocks hold, or hold once that is taken out."""
    if points.unsettled is not None:
        known = replace(points.unsettled, mean=np.zeros_like(points.unsettled.mean))
        return noise_of(model, replace(points, unsettled=known), None, correlated=False)
    changes = helmert(points.n_blocks)
    poles = slow_poles(model, controller, float(np.median(seconds)), LASTING)
    starts = [RingingPole.of(points, model, controller, p).ringing(seconds).left for p in poles]
    rings = [np.linalg.norm(np.einsum("nb,pbc->pnc", changes, s), axis=1) for s in starts]
    kept_up = leakage(points, model, controller, seconds, np.ones(2))
    if kept_up is not None:
        rings.append(np.sqrt(np.einsum("nb,pbcxc,nx->pc", changes, kept_up, changes).real))
    return noise_of(model, points, None, np.array(rings) if rings else None, correlated=False, block_s=seconds)


def length_of_blocks(
    points: PlanePoints, model: PlaneModel, controller: tuple[Real, Real], suspected: bool = False
) -> float | None:
    """Length of the blocks, s, before they are made whole periods, told by the starts that ring on in them."""
    e, white = _whitened(points, model, noise_of(model, points, None))
    loops = [
        RingingPole.of(points, model, controller, p) for p in slow_poles(model, controller, float(BLOCK_S[0]), LASTING)
    ]
    best, told_by, loudest = 0.0, None, None
    for loop in loops:
        along = Along.of(loop.start, e, white)
        for t in BLOCK_S:
            ringing = loop.ringing(_whole_periods(points.omega, float(t)))
            if np.median(np.abs(ringing.powers[:, 1])) <= LASTING:
                break
            gain = evidence_of(ringing, along, points)
            if gain > best:
                best, told_by, loudest = gain, float(t), ringing
    if loudest is None:
        return None
    least = (SUSPECTED if suspected else EVIDENCE) + np.log(len(BLOCK_S) * len(loops))
    return told_by if best > least else None


def without_ringing(
    points: PlanePoints,
    model: PlaneModel,
    controller: tuple[Real, Real],
    noise: NoiseModel,
    block_s: Real,
    suspected: bool = False,
) -> tuple[PlanePoints, tuple[Transient, ...]]:
    """The points as they would be had nothing rung in them, and what was taken out.

    Parameters
    ----------
    points
        As measured, one axis at a time.
    model, controller
        The plane, well enough known to tell where the loop's poles are.
    noise
        Of the points' means.
    block_s
        (P,) s.
    suspected
        See `settled`.
    """
    nothing = taken = Taken(*_whitened(points, model, noise))
    samples = block_s / model.known.sample_time_s
    # of white noise a block's amplitude has 4/N of the samples' variance
    sensors = np.median(noise.sigma[:, -2:] * np.sqrt(samples * points.n_blocks / 4)[:, None], axis=0)
    kept_up = leakage(points, model, controller, block_s, sensors)
    if kept_up is not None:
        more = taken.with_one_more(Source(kept_up, np.ones(len(samples))))
        taken = more if more.likelihood > nothing.likelihood + EVIDENCE else taken
    driven = bool(taken.sources)
    doubt = SUSPECTED if suspected else EVIDENCE
    typical = float(np.median(block_s))
    found: list[tuple[complex, float]] = []
    poles = slow_poles(model, controller, typical, GONE)
    # what lasts over blocks first: nothing else looks like it, while it looks like what dies within the first one
    for reach, end in ((LASTING, 1.0), (GONE, LASTING)):
        ringings = {
            pole: RingingPole.of(points, model, controller, pole).ringing(block_s)
            for pole in poles
            if reach < np.exp(pole.real * typical) <= end
        }
        while ringings:  # the loudest first
            tried = {pole: taken.started(ringing, points.axis) for pole, ringing in ringings.items()}
            pole = max(tried, key=lambda p: tried[p][0])
            evidence, size = tried[pole]
            if evidence < doubt + np.log(len(ringings)):
                break
            taken = taken.with_one_more(Source.started(ringings.pop(pole).left, size, points.axis))
            found.append((pole, evidence))
        for pole, ringing in ringings.items():
            if driven and _rings_on(pole, typical):
                size = np.full(len(samples), taken.allowed(ringing))
                taken = taken.with_one_more(Source.started(ringing.left, size))
    if not taken.sources:
        return points, ()
    transients = []
    starts = [s for s in taken.sources if s.group is not None]
    for (pole, evidence), source in zip(found, starts, strict=True):
        share = np.abs(taken.alone(source).mean(axis=1)) / noise.sigma
        transients.append(Transient(pole, float(share.max()), evidence, float(np.exp(pole.real * typical))))
    return replace(_less(points, taken.blocks), unsettled=taken.unknown), tuple(transients)


def _rings_on(pole: complex, block_s: float) -> bool:
    """Whether a pole is a mode's, which swings on for blocks: what may be left of other starts would cost ki and ks."""
    return bool(np.exp(pole.real * block_s) > LASTING and abs(pole.imag) > -pole.real)


def _whitened(points: PlanePoints, model: PlaneModel, noise: NoiseModel) -> tuple[Complex, Complex]:
    """Residuals of the blocks (P, B, c), and what makes one block's noise white, (P, c, c)."""
    i, y = predicted_blocks(model, points, None)
    return residual_blocks(points, i, y), np.asarray(noise.whitener() / np.sqrt(points.n_blocks))


def _less(points: PlanePoints, taken: Complex) -> PlanePoints:
    if points.I is None:
        return replace(points, Y=points.Y - taken)
    return replace(points, I=points.I - taken[:, :, :2], Y=points.Y - taken[:, :, 2:])


def _whole_periods(omega: Real, seconds: float) -> Real:
    """Blocks of about so many seconds, at least one period, (P,) s."""
    period = 2 * np.pi / omega
    return np.asarray(np.maximum(1, np.round(seconds / period)) * period)
