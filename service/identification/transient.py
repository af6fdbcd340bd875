"""What had not died away when a point was recorded, taken out of its blocks.

A tone that starts, or follows another, makes the slow poles of the closed loop ring. A mode of 500 Hz that the loop
damps with 5 1/s still holds a fifth of its transient after 0.3 s, and a damping ratio read from such points is off by a
tenth. Model and controller know the pole p and the shape c of its ringing in u: seen through the plant it leaves

    alpha lambda^b (G(p) - G(jw)) c,    lambda = exp((p - jw) T),

in what y differs from G u in block b of length T (and the same for i with the amplifier), so that one complex number
alpha per point is all that is unknown. It shows in how the blocks change from one to the next; a mode of 900 Hz that
the loop damps with 60 1/s dies within the first one, and is still several times the noise in a point's mean. The
alphas of a pole have a common size (r/(jw - p), times what one start leaves), and what is not known of them
(`service.identification.transient_size`) is added to the covariance of the point's mean. Where the blocks show no
transient beyond doubt, and none that looks different with time reversed, nothing is changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.noise import NoiseModel
from service.identification.plane_model import PlaneModel
from service.identification.points import PlanePoints
from service.identification.refine import refine
from service.identification.residuals import Data, noise_of, predicted_blocks, residual_blocks
from service.identification.ringing import RingingPole, slow_poles
from service.identification.split import Split, log_ratios
from service.identification.transient_size import Along, Taken, evidence_of
from service.identification.zoh import Complex, Real

GONE = 1e-3
"""What is left of a transient after one block below which a pole is not looked at. One that dies within the first block
is in that block alone, in a form that model and controller know."""
LASTING = 0.3
"""The same above which it rings over several blocks: only such a one tells how long they are, and is worth a word."""
EVIDENCE = 6.5
"""Gain of log likelihood beyond which blocks show a transient: chance has more in three of a thousand cases. More by
the logarithm of how many poles, and lengths of blocks where these are looked for, were tried."""
SUSPECTED = 2.0
"""The same where the other plane's points, recorded alike, show one: what stays below still biases a damping."""
BLOCK_S = np.geomspace(0.01, 1.0, 231)
"""Lengths of blocks, s, to be tried where a file does not tell them; each is made whole periods."""
NOISE = 1.3
"""So many times as much has to be gained as with time reversed. A mode that noise keeps ringing looks the same either
way; one that dies away does not."""
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
    left: float
    """Of it after one block."""
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
    taken, told_by = Taken(e, white), None
    found: list[Transient] = []
    lengths = _lengths(points.omega, block_s)
    least = SUSPECTED if suspected else EVIDENCE
    poles = slow_poles(model, controller, float(BLOCK_S[0]), GONE)
    # what lasts over blocks first: nothing else looks like it, while it looks like what dies within the first one
    for reach, end in ((LASTING, 1.0), (GONE, LASTING)):
        loops = {
            pole: RingingPole.of(points, model, controller, pole)
            for pole in poles
            if any(reach < np.exp(pole.real * np.median(t)) <= end for t in lengths)
        }
        if reach == GONE and len(lengths) > 1:  # it does not tell how long the blocks are
            break
        while loops:  # the loudest first: it also tells how long the blocks are
            along = {pole: Along.of(loop.start, taken.left, white) for pole, loop in loops.items()}
            tried = {
                (pole, k): evidence_of(loop.ringing(t), along[pole], points)
                for pole, loop in loops.items()
                for k, t in enumerate(lengths)
                if np.exp(pole.real * np.median(t)) > reach
            }
            if not tried:
                break
            (pole, length), (evidence, size) = max(tried.items(), key=lambda item: item[1][0])
            forwards = loops[pole].ringing(lengths[length])
            backwards = evidence_of(forwards.backwards(), along[pole], points)[0]
            if evidence < least + np.log(len(lengths) * len(loops)) + NOISE * backwards:
                loops.pop(pole)
                continue
            told_by = BLOCK_S[length] if len(lengths) > 1 else told_by
            lengths = [lengths[length]]
            loops.pop(pole)
            taken = taken.and_one(forwards, size, points.axis)
            share = np.abs(taken.alone(-1).mean(axis=1)) / noise.sigma
            after = float(np.exp(pole.real * np.median(lengths[0])))
            block = None if told_by is None else float(told_by)
            found.append(Transient(pole, float(share.max()), evidence, after, block))
    if not found:
        return points, ()
    return replace(_less(points, taken.blocks), unsettled=taken.unknown), tuple(found)


def _lengths(omega: Real, block_s: Real | float | None) -> list[Real]:
    """Lengths of blocks to be tried, (P,) each."""
    if isinstance(block_s, np.ndarray):
        return [block_s]
    return [_whole_periods(omega, float(t)) for t in (BLOCK_S if block_s is None else [block_s])]


def _less(points: PlanePoints, taken: Complex) -> PlanePoints:
    if points.I is None:
        return replace(points, Y=points.Y - taken)
    return replace(points, I=points.I - taken[:, :, :2], Y=points.Y - taken[:, :, 2:])


def _whole_periods(omega: Real, seconds: float) -> Real:
    """Blocks of about so many seconds, at least one period, (P,) s."""
    period = 2 * np.pi / omega
    return np.asarray(np.maximum(1, np.round(seconds / period)) * period)
