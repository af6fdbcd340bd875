"""Hum (interference at a fixed frequency) distinguished from noise by its phase from block to block.

The blocks of a point are consecutive, so a hum of f hertz leaks into block b of T seconds as a exp(2 pi i f T b), with
an amplitude a of its own in every signal. Noise has no such pattern: of the blocks' deviations from their mean, which
have B - 1 complex dimensions, it has a share of 1/(B - 1) in that one. So a point's blocks are fitted by least squares
with three patterns: a constant (the response), and the hum's phasor turning forward and backward.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.estimate import Estimate, plain_mean

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

MAIN_LOBE, LOBES = 1.0, 3.0
"""Distances from the hum, in frequency resolutions 1/T of a block, up to which its coherence is tested, and up to which
its amplitude is estimated."""
STRONG_LEAKAGE = (0.5, 0.75, 0.95)
"""Shares of the main lobe within which leakage is strong; the narrowest one that has points is used."""
MAINS_OFF = 0.01
"""Relative distance from its nominal frequency within which the mains is nearly always (EN 50160)."""
PATTERNS = 3
"""Patterns fitted to the blocks of a point: the response, and the hum turning forward and backward."""
LEAST_ADVANCE_RAD = 1.0
"""Smallest advance of the phase from block to block at which a hum is distinguished from a slow drift."""

OWN_SHARE = 0.3
"""Share of a hum's pattern that must remain once a louder hum's pattern is projected out."""
SAME_PATTERN_RATIO = 0.02
"""Ratio of singular values below which two patterns count as one: at half a turn a block both directions agree."""


def coherence(sweep: Sweep, signal: Complex, frequency_hz: float, by: Estimate | None = None) -> tuple[float, float]:
    """Share of a signal's scatter near a frequency that has the pattern of a hum there.

    Parameters
    ----------
    sweep
        With the length of its blocks; at least 3 of them a point.
    signal
        (P, B, H, n) i or y of the sweep.
    frequency_hz
    by
        Estimate of the responses beside a louder hum. Only points where that could be taken off count then.

    Returns
    -------
    tuple
        Mean share, and by how many standard deviations it exceeds that of noise; (0, 0) where too few points are near.
    """
    points, blocks = signal.shape[:2]
    usable = np.ones(points, dtype=bool) if by is None else (by.dof > 1) & (by.dof < blocks - 1)
    by = by or plain_mean(points, blocks)
    hum = np.einsum("pbc,pc->pb", by.residual_map, _patterns(sweep, frequency_hz)[:, :, 1])
    norm = (np.abs(hum) ** 2).sum(axis=1)
    scatter = np.einsum("pbc,pchn->pbhn", by.residual_map, signal)
    along_hum = (np.abs(np.einsum("pb,pbhn->phn", hum.conj(), scatter)) ** 2).sum(axis=-1)
    along_hum /= np.maximum(norm, 1e-12)[:, None]
    share = along_hum / np.maximum((np.abs(scatter) ** 2).sum(axis=(1, 3)), 1e-300)
    where = _near(sweep, frequency_hz, MAIN_LOBE) & (usable & (norm > OWN_SHARE * blocks))[:, None]
    x = share[where]
    if len(x) < 4 or blocks < 3:
        return 0.0, 0.0
    dof = np.broadcast_to(by.dof[:, None], share.shape)[where]
    of_noise = 1 / dof
    # Noise's share has a beta distribution (1, d - 1). Channels count as one: a mode may make them all move together.
    variance = of_noise * (1 - of_noise) / (dof + 1)
    excess = float((x - of_noise).sum())
    return float(x.mean()), excess / float(np.sqrt(variance.sum()))


def hum_frequency(sweep: Sweep, signal: Complex, about_hz: float) -> tuple[float, float]:
    """Frequency of a hum near a nominal one, and its standard deviation, Hz, by how its phase turns.

    The most likely one, where the blocks of each cell that is near are a response, a hum that turns forward and
    backward, and noise of any variance; channels count as one, as they do in `coherence`. Lines of one block length
    leave several frequencies, which the standard deviation then spans. ``signal`` is i or y of the sweep, (P, B, H, n),
    with the length of its blocks. Where no line is near, the nominal frequency is returned with `MAINS_OFF` of it.
    """
    cells, farthest = _near(sweep, about_hz, MAIN_LOBE), MAINS_OFF * about_hz
    used = cells.any(axis=1)
    blocks, cells, block_s = signal[used], cells[used], _block_s(sweep)[used]
    dof = blocks.shape[1] - PATTERNS
    if not used.any() or dof < 1:
        return about_hz, farthest

    def surprise(f: float) -> float:
        """Negative log-likelihood."""
        # an orthonormal basis, also of the space of two patterns that are nearly alike
        basis, _ = np.linalg.qr(_turning(block_s, blocks.shape[1], f))
        rest = blocks - np.einsum("pbk,pck,pchn->pbhn", basis, basis.conj(), blocks)
        return float(dof * np.log(np.maximum((np.abs(rest) ** 2).sum(axis=(1, 3)), 1e-300)[cells]).sum())

    step = 1 / (4 * float(block_s.max()) * blocks.shape[1])
    grid = about_hz + np.arange(-farthest - step, farthest + 2 * step, step)
    on_grid = np.array([surprise(f) for f in grid])
    lowest = np.flatnonzero((on_grid[1:-1] <= on_grid[:-2]) & (on_grid[1:-1] <= on_grid[2:])) + 1
    minima = [_minimum(surprise, float(grid[k]), step) for k in lowest] or [(about_hz, farthest)]
    likelihood = np.array([-surprise(f) + np.log(deviation) for f, deviation in minima])
    share = scipy.special.softmax(likelihood)
    best = minima[int(np.argmax(share))][0]
    spread = float(np.sqrt(sum(w * (s**2 + (f - best) ** 2) for w, (f, s) in zip(share, minima, strict=True))))
    return best, min(spread, farthest)


def _minimum(surprise: Callable[[float], float], about: float, step: float) -> tuple[float, float]:
    """A minimum of a negative log-likelihood within a step, and the standard deviation by its curvature."""
    found = scipy.optimize.minimize_scalar(
        surprise, bounds=(about - step, about + step), method="bounded", options={"xatol": step / 1e3}
    )
    f, h = float(found.x), step / 5
    curvature = (surprise(f + h) - 2 * surprise(f) + surprise(f - h)) / h**2
    return f, float(1 / np.sqrt(max(curvature, 1 / step**2)))


def hum_power(sweep: Sweep, signal: Complex, frequency_hz: float) -> Real:
    """Squared amplitude of a hum where its leakage is strong, (K, n), corrected for leakage and noise: may be negative.

    The same K points for every signal of a sweep, each with a phase of its own; none where no line comes near it.
    """
    blocks = signal.shape[1]
    reaches = (_near(sweep, frequency_hz, share * MAIN_LOBE) for share in STRONG_LEAKAGE)
    near = next((cells for cells in reaches if cells.any()), np.zeros((len(sweep.axis), len(sweep.harmonics)), bool))
    distance = (sweep.frequency_hz[:, None] * np.array(sweep.harmonics) - frequency_hz) * _block_s(sweep)[:, None]
    patterns = _patterns(sweep, frequency_hz)
    found, inverse = _coefficients(patterns, signal), _inverse(patterns)
    same = _directions_alike(inverse, patterns)[:, None, None]  # then each direction was given half of the hum
    power = np.abs(np.where(same, found[:, 1] + found[:, 2], found[:, 1])) ** 2
    if blocks > PATTERNS:  # take off the noise's share
        rest = signal - np.einsum("pbk,pkhn->pbhn", patterns, found)
        rows = np.where(same[..., 0], inverse[:, 1] + inverse[:, 2], inverse[:, 1])
        variance = (np.abs(rest) ** 2).sum(axis=1) / (blocks - PATTERNS + same)
        power -= variance * (np.abs(rows) ** 2).sum(axis=1)[:, None, None]
    return np.asarray((power / np.sinc(distance)[..., None] ** 2)[near])


def without_hum(sweep: Sweep, frequency_hz: float) -> Sweep:
    """The sweep with one hum taken off its blocks, wherever its phase distinguishes it from the response.

    As it is where the length of its blocks, and so the phase, is not known.
    """
    if sweep.block_samples is None:
        return sweep
    by = beside_hum(sweep, frequency_hz)
    U, Y = (_hum_removed(X, by) for X in (sweep.U, sweep.Y))
    return replace(sweep, U=U, I=None if sweep.I is None else _hum_removed(sweep.I, by), Y=Y)


def heard_in(sweep: Sweep, frequency_hz: float) -> Mask:
    """Harmonics of points that a hum leaks into and where its phase distinguishes it from the response, (P, H).

    None of them where the length of the blocks is not known.
    """
    if sweep.block_samples is None:
        return np.zeros((sweep.n_points, len(sweep.harmonics)), dtype=bool)
    return _near(sweep, frequency_hz, LOBES)


def beside_hum(sweep: Sweep, frequency_hz: float) -> Estimate:
    """Estimate of responses beside a hum: least squares where both can be distinguished, else the plain mean."""
    patterns, distinct = _patterns(sweep, frequency_hz), _phase_advance(sweep, frequency_hz) > LEAST_ADVANCE_RAD
    inverse, (points, blocks) = _inverse(patterns), patterns.shape[:2]
    plain = plain_mean(points, blocks)
    dof = np.maximum(blocks - np.round(np.trace(inverse @ patterns, axis1=1, axis2=2).real), 1.0)
    residual_map = (np.eye(blocks) - patterns @ inverse) * np.sqrt((blocks - 1) / dof)[:, None, None]
    return Estimate(
        np.where(distinct[:, None], inverse[:, 0], plain.weights),
        np.where(distinct[:, None, None], residual_map, plain.residual_map),
        np.where(distinct, dof, plain.dof),
    )


def left_in_mean(sweep: Sweep, signal: Complex, frequencies_hz: Sequence[float]) -> Real:
    """Amplitude that hums leave in a signal's mean over the blocks, rms over their phases, (P, H, n).

    The loudest hum comes first. `without_hum` has taken it off the means where its phase distinguishes it, and what it
    leaks is not attributed to the others.
    """
    at, whole_s = sweep.frequency_hz[:, None] * np.array(sweep.harmonics), signal.shape[1] * _block_s(sweep)[:, None]
    power = np.zeros((*at.shape, signal.shape[3]))
    for k, f in enumerate(frequencies_hz):
        leakage = sum(np.sinc((at + way * f) * whole_s) ** 2 for way in (-1, 1))
        distinct = (_phase_advance(sweep, f) > LEAST_ADVANCE_RAD)[:, None]
        remains = ~distinct if k == 0 and signal.shape[1] > PATTERNS else np.ones_like(distinct)
        power += (leakage * remains)[..., None] * _hum_amplitude(sweep, signal, f) ** 2
        signal = _hum_removed(signal, beside_hum(sweep, f))
    return np.asarray(np.sqrt(power))


def slow_leaks(sweep: Sweep, signal: Complex, frequencies_hz: Sequence[float]) -> Real:
    """Amplitude of hums in a block where they turn too slowly to be distinguished from a slow drift, (P, H, n)."""
    at, block_s = sweep.frequency_hz[:, None] * np.array(sweep.harmonics), _block_s(sweep)[:, None]
    leaks = np.zeros((*at.shape, signal.shape[3]))
    for f in frequencies_hz:
        slow = (_phase_advance(sweep, f) <= LEAST_ADVANCE_RAD)[:, None]
        in_a_block = sum(np.abs(np.sinc((at + way * f) * block_s)) for way in (-1, 1))
        leaks += (in_a_block * slow)[..., None] * _hum_amplitude(sweep, signal, f)
        signal = _hum_removed(signal, beside_hum(sweep, f))
    return leaks


def _hum_amplitude(sweep: Sweep, signal: Complex, frequency_hz: float) -> Real:
    """Amplitude of a hum in each channel, (n,), from all cells that it leaks into."""
    near = heard_in(sweep, frequency_hz)
    leaked = _coefficients(_patterns(sweep, frequency_hz), signal)[:, 1][near]
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    share = np.sinc((at - frequency_hz) * _block_s(sweep)[:, None])[near]
    return np.asarray(np.sqrt((np.abs(leaked) ** 2).sum(axis=0) / max(float((share**2).sum()), 1.0)))


def _hum_removed(signal: Complex, by: Estimate) -> Complex:
    """Blocks (P, B, H, n) whose mean is the response of an estimate, and whose deviations are those that it leaves."""
    response = np.einsum("pb,pbhn->phn", by.weights, signal)[:, None]
    return np.asarray(response + np.einsum("pbc,pchn->pbhn", by.residual_map, signal))


def deviation(blocks: Complex) -> Complex:
    """Blocks, (P, B, ...), less their mean."""
    return np.asarray(blocks - blocks.mean(axis=1, keepdims=True))


def _patterns(sweep: Sweep, frequency_hz: float) -> Complex:
    """Regressors of a point's blocks, (P, B, 3): a constant (the response), the hum turning forward and backward."""
    return _turning(_block_s(sweep), sweep.Y.shape[1], frequency_hz)


def _turning(block_s: Real, blocks: int, frequency_hz: float) -> Complex:
    phase = 2 * np.pi * frequency_hz * block_s[:, None] * np.arange(blocks)
    return np.stack([np.ones_like(phase), np.exp(1j * phase), np.exp(-1j * phase)], axis=-1)


def _coefficients(patterns: Complex, signal: Complex) -> Complex:
    """Least-squares coefficients of the patterns, (P, 3, H, n), of least norm where two patterns are alike."""
    return np.asarray(np.einsum("pkb,pbhn->pkhn", _inverse(patterns), signal))


def _inverse(patterns: Complex) -> Complex:
    return np.asarray(np.linalg.pinv(patterns, rcond=SAME_PATTERN_RATIO))


def _directions_alike(inverse: Complex, patterns: Complex) -> Mask:
    """Points where the hum turning forward and backward makes the same pattern, so that the rank is 2, (P,)."""
    return np.asarray(np.trace(inverse @ patterns, axis1=1, axis2=2).real < PATTERNS - 0.5)


def _near(sweep: Sweep, frequency_hz: float, resolutions: float) -> Mask:
    """Harmonics of points within so many resolutions of a frequency, where the phase advances enough, (P, H)."""
    advances = (_phase_advance(sweep, frequency_hz) > LEAST_ADVANCE_RAD)[:, None] & (np.array(sweep.harmonics) > 0)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    return np.asarray(advances & (np.abs(at - frequency_hz) * _block_s(sweep)[:, None] < resolutions))


def _phase_advance(sweep: Sweep, frequency_hz: float) -> Real:
    """Advance of a hum's phase from block to block modulo whole turns, 0 to pi, (P,), rad."""
    advance = 2 * np.pi * frequency_hz * _block_s(sweep)
    return np.asarray(np.abs((advance + np.pi) % (2 * np.pi) - np.pi))


def resolution_hz(sweep: Sweep) -> float:
    """Distance of two hums from which most points distinguish their phases, Hz."""
    return float(1 / (np.median(_block_s(sweep)) * sweep.Y.shape[1]))


def _block_s(sweep: Sweep) -> Real:
    """Length of each point's blocks, (P,), s.

    Raises
    ------
    ValueError
        It is not known; then there is no phase to ask for.
    """
    if sweep.block_samples is None:
        raise ValueError("the length of the sweep's blocks is not known")
    return np.asarray(sweep.block_samples / sweep.sample_rate_hz)
