"""Hum told from noise by its phase: from block to block it advances by its own frequency times the block's length.

The blocks of a point follow one another, so a hum of f hertz leaks into block b of T seconds as a exp(2 pi i f T b),
with an amplitude of its own in every signal. Noise has no such pattern: of the blocks' deviations from their mean, in
B - 1 complex dimensions, it has 1/(B - 1) in that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.estimate import Estimate, plain_mean

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

MAIN_LOBE, LOBES = 1.0, 3.0
"""Distance in resolutions of a block, 1/T, up to which a hum leaks most, and up to which its size is taken from."""
LARGE = (0.5, 0.75, 0.95)
"""Shares of the main lobe within which leakage is large: of the first one where there are points."""
PATTERNS = 3
"""What is told apart in the blocks of a point: a response, and the hum turning either way."""
TURNS = 1.0
"""Smallest advance of the phase from block to block, rad, that is no slow drift."""

OWN_SHARE = 0.3
"""Share of a hum's pattern that another's must leave of it."""
SAME_PATTERN_RATIO = 0.02
"""Ratio of singular values below which two patterns are one: half a turn from block to block is the same either way."""


def coherence(sweep: Sweep, signal: Complex, frequency_hz: float, by: Estimate | None = None) -> tuple[float, float]:
    """How much of a signal's scatter near a frequency has the pattern of a hum there.

    Parameters
    ----------
    sweep
        With the length of its blocks; at least 3 of them a point.
    signal
        (P, B, H, n) i or y of the sweep.
    frequency_hz
    by
        How the responses are estimated: beside a louder hum. Only the points where that is taken off are heard then.

    Returns
    -------
    tuple
        Mean share, and by how many standard deviations it is above that of noise; (0, 0) where too few points are near.
    """
    points, blocks = signal.shape[:2]
    told = np.ones(points, dtype=bool) if by is None else (by.free > 1) & (by.free < blocks - 1)
    by = by or plain_mean(points, blocks)
    turning = np.einsum("pbc,pc->pb", by.left, _pattern(sweep, frequency_hz)[:, :, 1])
    norm = (np.abs(turning) ** 2).sum(axis=1)
    scatter = np.einsum("pbc,pchn->pbhn", by.left, signal)
    in_it = (np.abs(np.einsum("pb,pbhn->phn", turning.conj(), scatter)) ** 2).sum(axis=-1)
    in_it /= np.maximum(norm, 1e-12)[:, None]
    share = in_it / np.maximum((np.abs(scatter) ** 2).sum(axis=(1, 3)), 1e-300)
    where = _near(sweep, frequency_hz, MAIN_LOBE) & (told & (norm > OWN_SHARE * blocks))[:, None]
    x = share[where]
    if len(x) < 4 or blocks < 3:
        return 0.0, 0.0
    free = np.broadcast_to(by.free[:, None], share.shape)[where]
    of_noise = 1 / free
    # the share of noise is beta distributed with 1 and d - 1; channels are counted as one, as a mode may join them
    variance = of_noise * (1 - of_noise) / (free + 1)
    excess = float((x - of_noise).sum())
    return float(x.mean()), excess / float(np.sqrt(variance.sum()))


def hum_power(sweep: Sweep, signal: Complex, frequency_hz: float) -> Real:
    """Squared amplitude of a hum where its leakage is large, (K, n), leakage and noise allowed for; it may be negative.

    The same K points for every signal of a sweep, each with a phase of its own; none where no line comes near it.
    """
    blocks = signal.shape[1]
    reaches = (_near(sweep, frequency_hz, share * MAIN_LOBE) for share in LARGE)
    near = next((cells for cells in reaches if cells.any()), np.zeros((len(sweep.axis), len(sweep.harmonics)), bool))
    apart = (sweep.frequency_hz[:, None] * np.array(sweep.harmonics) - frequency_hz) * _block_s(sweep)[:, None]
    pattern = _pattern(sweep, frequency_hz)
    found, inverse = _coefficients(pattern, signal), _inverse(pattern)
    alike = _alike(inverse, pattern)[:, None, None]  # turning either way is the same: both hold half of it
    power = np.abs(np.where(alike, found[:, 1] + found[:, 2], found[:, 1])) ** 2
    if blocks > PATTERNS:
        rest = signal - np.einsum("pbk,pkhn->pbhn", pattern, found)
        rows = np.where(alike[..., 0], inverse[:, 1] + inverse[:, 2], inverse[:, 1])
        scatter = (np.abs(rest) ** 2).sum(axis=1) / (blocks - PATTERNS + alike)
        power -= scatter * (np.abs(rows) ** 2).sum(axis=1)[:, None, None]
    return np.asarray((power / np.sinc(apart)[..., None] ** 2)[near])


def without_hum(sweep: Sweep, frequency_hz: float) -> Sweep:
    """The sweep with one hum taken off its blocks, wherever it can be told from the response."""
    by = beside_hum(sweep, frequency_hz)
    U, Y = (_less(X, by) for X in (sweep.U, sweep.Y))
    return replace(sweep, U=U, I=None if sweep.I is None else _less(sweep.I, by), Y=Y)


def heard_in(sweep: Sweep, frequency_hz: float) -> Mask:
    """Harmonics of the points into which a hum leaks much and where its phase tells it from the response, (P, H)."""
    return _near(sweep, frequency_hz, LOBES)


def beside_hum(sweep: Sweep, frequency_hz: float) -> Estimate:
    """How responses are estimated beside a hum: least squares where it can be told from them, else the plain mean."""
    pattern, told_apart = _pattern(sweep, frequency_hz), _turning(sweep, frequency_hz) > TURNS
    inverse, (points, blocks) = _inverse(pattern), pattern.shape[:2]
    plain = plain_mean(points, blocks)
    free = np.maximum(blocks - np.round(np.trace(inverse @ pattern, axis1=1, axis2=2).real), 1.0)
    left = (np.eye(blocks) - pattern @ inverse) * np.sqrt((blocks - 1) / free)[:, None, None]
    return Estimate(
        np.where(told_apart[:, None], inverse[:, 0], plain.weights),
        np.where(told_apart[:, None, None], left, plain.left),
        np.where(told_apart, free, plain.free),
    )


def left_in_mean(sweep: Sweep, signal: Complex, frequencies_hz: Sequence[float]) -> Real:
    """Amplitude that hums leave in a signal's mean over the blocks, rms over their phases, (P, H, n).

    The loudest first: what it leaks is not taken for one of the others, and `without_hum` has taken it off.
    """
    at, whole_s = sweep.frequency_hz[:, None] * np.array(sweep.harmonics), signal.shape[1] * _block_s(sweep)[:, None]
    power = np.zeros((*at.shape, signal.shape[3]))
    for k, f in enumerate(frequencies_hz):
        leaks = sum(np.sinc((at + way * f) * whole_s) ** 2 for way in (-1, 1))
        told_apart = (_turning(sweep, f) > TURNS)[:, None]
        left = ~told_apart if k == 0 and signal.shape[1] > PATTERNS else np.ones_like(told_apart)
        power += (leaks * left)[..., None] * _size(sweep, signal, f) ** 2
        signal = _less(signal, beside_hum(sweep, f))
    return np.asarray(np.sqrt(power))


def slow_leaks(sweep: Sweep, signal: Complex, frequencies_hz: Sequence[float]) -> Real:
    """Amplitude of hums in a block where they turn too slowly to be told from a slow drift, (P, H, n)."""
    at, block_s = sweep.frequency_hz[:, None] * np.array(sweep.harmonics), _block_s(sweep)[:, None]
    leaks = np.zeros((*at.shape, signal.shape[3]))
    for f in frequencies_hz:
        slow = (_turning(sweep, f) <= TURNS)[:, None]
        in_a_block = sum(np.abs(np.sinc((at + way * f) * block_s)) for way in (-1, 1))
        leaks += (in_a_block * slow)[..., None] * _size(sweep, signal, f)
        signal = _less(signal, beside_hum(sweep, f))
    return leaks


def _size(sweep: Sweep, signal: Complex, frequency_hz: float) -> Real:
    """Amplitude of a hum in each channel, (n,), from wherever it leaks to."""
    near = heard_in(sweep, frequency_hz)
    leaked = _coefficients(_pattern(sweep, frequency_hz), signal)[:, 1][near]
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    share = np.sinc((at - frequency_hz) * _block_s(sweep)[:, None])[near]
    return np.asarray(np.sqrt((np.abs(leaked) ** 2).sum(axis=0) / max(float((share**2).sum()), 1.0)))


def _less(signal: Complex, by: Estimate) -> Complex:
    """Blocks (P, B, H, n) with the response that an estimate gives as their mean, and what it leaves as scatter."""
    response = np.einsum("pb,pbhn->phn", by.weights, signal)[:, None]
    return np.asarray(response + np.einsum("pbc,pchn->pbhn", by.left, signal))


def deviation(blocks: Complex) -> Complex:
    """Blocks, (P, B, ...), less their mean."""
    return np.asarray(blocks - blocks.mean(axis=1, keepdims=True))


def _pattern(sweep: Sweep, frequency_hz: float) -> Complex:
    """What a response and a hum leave in the blocks, (P, B, 3): a constant, and the hum's phase turning either way."""
    phase = 2 * np.pi * frequency_hz * _block_s(sweep)[:, None] * np.arange(sweep.Y.shape[1])
    return np.stack([np.ones_like(phase), np.exp(1j * phase), np.exp(-1j * phase)], axis=-1)


def _coefficients(pattern: Complex, signal: Complex) -> Complex:
    """Least squares, (P, 3, H, n); what cannot be told apart is shared."""
    return np.asarray(np.einsum("pkb,pbhn->pkhn", _inverse(pattern), signal))


def _inverse(pattern: Complex) -> Complex:
    return np.asarray(np.linalg.pinv(pattern, rcond=SAME_PATTERN_RATIO))


def _alike(inverse: Complex, pattern: Complex) -> Mask:
    """Points where the hum turning either way leaves the same in the blocks, (P,)."""
    return np.asarray(np.trace(inverse @ pattern, axis1=1, axis2=2).real < PATTERNS - 0.5)


def _near(sweep: Sweep, frequency_hz: float, resolutions: float) -> Mask:
    """Harmonics of points within so many resolutions of a frequency, whose phase advances enough, (P, H)."""
    turns = (_turning(sweep, frequency_hz) > TURNS)[:, None] & (np.array(sweep.harmonics) > 0)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    return np.asarray(turns & (np.abs(at - frequency_hz) * _block_s(sweep)[:, None] < resolutions))


def _turning(sweep: Sweep, frequency_hz: float) -> Real:
    """Advance of a hum's phase from block to block but for whole turns, (P,), rad."""
    advance = 2 * np.pi * frequency_hz * _block_s(sweep)
    return np.asarray(np.abs((advance + np.pi) % (2 * np.pi) - np.pi))


def resolution_hz(sweep: Sweep) -> float:
    """How far apart two hums must be for most points to tell one from the other by their phases, Hz."""
    return float(1 / (np.median(_block_s(sweep)) * sweep.Y.shape[1]))


def _block_s(sweep: Sweep) -> Real:
    assert sweep.block_samples is not None
    return np.asarray(sweep.block_samples / sweep.sample_rate_hz)
