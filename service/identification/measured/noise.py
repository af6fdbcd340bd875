"""Covariance of the averaged residuals, from the scatter of the blocks.

Six blocks give a variance to 40 % only, and weights that noisy cost efficiency and coverage. So each point's
variance is drawn towards the mean of its neighbours in frequency, by as much as the scatter of
all variances says that neighbours are alike (empirical Bayes for variances, Smyth, Stat. Appl. Genet.
Mol. Biol. 3, 2004). No measured magnitude enters a weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, median_filter
from scipy.special import digamma, gammaincinv, polygamma

from service.identification.arrays import Complex, Real

NEIGHBOURS = 12
ESTIMATED_WEIGHTS = 1.06
"""What whitening with an estimated instead of the true covariance makes of a mean square of 1 in six-block data."""
INDEPENDENT = 1.5
"""Times as many as these are independent in a mean over neighbours, whose weights are triangular."""
CHANCE = 1e-3
"""Share of the frequencies that chance alone may take for noisier than their neighbours."""
FEW, MANY = 30, 300
"""Rounds in which a law of the variances is found: where neighbours correct it, and where nothing does."""
SETTLED = 1e-5
"""Change of a share of the law in one round, of the whole variance, below which it is found."""
ROUNDED = 1e-7
"""Share of a signal that its noise is at least, as single precision leaves it: the blocks of a simulation without noise
do not scatter at all, and beside none everything would be many times the noise."""
DRIFT = 3.0
"""Variance of the mean of drifting blocks, in units of one block's: what is left of the transient is no noise."""


@dataclass(frozen=True)
class NoiseModel:
    """Covariance of the mean of the blocks."""

    covariance: Complex
    """(P, c, c) Hermitian, E[e e^H] of the mean."""
    prior_blocks: float
    """How many blocks' worth of weight the neighbours have; inf when all points are alike."""
    drifting: NDArray[np.bool_]
    """(P,) points at which the blocks still change steadily: a transient was not over."""
    inflation: float = ESTIMATED_WEIGHTS
    """Mean square of residuals in units of these deviations, at most, where it would be 1 in units of the true ones:
    few blocks tell a variance badly, and the mean of 1/s^2 is above 1/sigma^2."""

    @property
    def sigma(self) -> Real:
        """(P, c) standard deviation of the complex mean."""
        return np.asarray(np.sqrt(np.einsum("pcc->pc", self.covariance).real))

    def whitener(self) -> Complex:
        """(P, c, c) W with W cov W^H = I."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))


def block_noise(
    residual: Complex,
    omega: Real,
    correlated: bool = True,
    magnitude: Real | None = None,
    suspect: NDArray[np.bool_] | None = None,
    sparse: bool = False,
    rings: Real | None = None,
    unknown: Real | None = None,
    block_s: Real | None = None,
) -> NoiseModel:
    """Noise of the mean residual from its blocks.

    Parameters
    ----------
    residual
        (P, B, c) residuals block by block; their mean over the blocks does not matter.
    omega
        (P,) rad/s, to find neighbours.
    correlated
        Whether channels are correlated; the correlation is pooled over more neighbours.
    magnitude
        (P, c) size of the signals as a model has them, for noise that grows with them (timing, gain, quantised
        phase): the variance follows a + b magnitude^2 before neighbours are compared.
    suspect
        (P,) points that are taken for drifting whatever their blocks say.
    sparse
        Whether frequencies are so far apart that a resonance may raise the scatter of one and not of its neighbours:
        points of one frequency that together scatter more than chance allows keep their own variance.
    rings
        (K, P, c) sizes with which what rings in the blocks grows, pole by pole: the noise is wanted without it, as the
        law of all points has it, for what rings hides a point's own, and how channels and blocks hang together.
    unknown
        (P, c) variance in what was taken out of the blocks, which their scatter no longer shows.
    block_s
        (P,) length of the blocks, for noise that is white and falls with it.
    """
    n, blocks, channels = residual.shape
    dof = blocks - 1
    spread = residual - residual.mean(axis=1, keepdims=True)
    own = np.sum(np.abs(spread) ** 2, axis=1) / dof  # (P, c)
    own = np.maximum(own, 1e-30 + 1e-12 * np.median(own, axis=0))
    shown = own
    own = own if unknown is None else own + unknown
    order = np.argsort(omega, kind="stable")
    trend, quiet, rounding = np.ones_like(own), np.ones_like(own), np.zeros_like(own)
    if magnitude is not None:
        rounding = (ROUNDED * magnitude) ** 2
        own = np.maximum(own, rounding)
        calm = [magnitude]
        if block_s is not None:
            calm.append(np.broadcast_to(1 / np.sqrt(block_s)[:, None], own.shape))
        trend, quiet = _trend(own, calm, [] if rings is None else rings, dof, FEW if rings is None else MANY)
        if rings is not None:
            variance = np.maximum(np.mean(own, axis=0) * trend * quiet, rounding)
            return NoiseModel(_diagonal(variance) / blocks, float("inf"), np.zeros(n, dtype=bool))
    own = own / trend
    # a point's blocks are as long for every channel: what all channels share is told apart first
    level = np.exp(_smooth(np.log(own), order, NEIGHBOURS) - _log_bias(dof))
    shared, prior_shared = _drawn_together(np.mean(own / level, axis=1, keepdims=True), order, dof * channels)
    pooled = _smooth(own / shared, order, NEIGHBOURS) * shared
    ratio, prior = _drawn_together(own / pooled, order, dof)
    own, variance = own * trend, ratio * pooled * trend
    if sparse:
        variance = _own_where_larger(variance, own, omega, dof)
    variance = variance * _mean_factor(spread / np.sqrt(variance)[:, None, :], order)
    variance = np.maximum(variance, rounding)
    drifting = _drifting(spread, shown / trend, order)
    if suspect is not None:
        drifting = drifting | suspect[:, None]
    variance = np.where(drifting, np.maximum(variance, own) * blocks * DRIFT, variance)
    if correlated and channels > 1:
        root = np.sqrt(variance)
        covariance = _correlation(spread / np.sqrt(own)[:, None, :], order) * root[:, :, None] * root[:, None, :]
    else:
        covariance = _diagonal(variance)
    alike = float(prior) / max(dof, 1) if np.isfinite(prior) else float("inf")
    freedom = np.array([dof * channels + prior_shared, dof + prior])
    inflation = _weights_allowance(blocks) * float(np.prod(1.0 + 1.0 / np.maximum(freedom - 1.0, 1.0)))
    return NoiseModel(covariance / blocks, alike, np.any(drifting, axis=1), inflation)


def _correlation(unit: Complex, order: NDArray[np.int64]) -> Complex:
    """Correlation (P, c, c) of the channels, pooled over neighbours, from blocks (P, B, c) in their deviations' units.

    What pure chance gives is shrunk away.
    """
    n, blocks, channels = unit.shape
    dof = blocks - 1
    product = np.einsum("pbc,pbd->pcd", unit, unit.conj()) / dof
    width = 4 * NEIGHBOURS
    smooth = _smooth(product.reshape(n, -1), order, width).reshape(n, channels, channels)
    scale = np.sqrt(np.einsum("pcc->pc", smooth).real)
    scale[scale == 0] = 1.0  # neighbours that do not scatter at all: told below to hang together with nothing
    correlation = smooth / (scale[:, :, None] * scale[:, None, :])
    count = dof * min(n, 2 * width + 1)
    off = ~np.eye(channels, dtype=bool)
    strength = np.abs(correlation) ** 2
    keep = np.where(off, np.clip(1.0 - 4.0 / (count * np.maximum(strength, 1e-12)), 0.0, 1.0), 1.0)
    correlation = correlation * keep * np.where(off, 0.995, 1.0)
    floor = np.linalg.eigvalsh(correlation)[:, 0]
    correlation[floor < 1e-3] = np.eye(channels)
    return np.asarray(correlation)


def _own_where_larger(variance: Real, own: Real, omega: Real, dof: int) -> Real:
    """Variance (P, c), or what the points of one frequency show of their own where that is more than chance allows."""
    _, place, count = np.unique(np.round(omega, 6), return_inverse=True, return_counts=True)
    ratio = np.zeros((len(count), own.shape[1]))
    np.add.at(ratio, place, own / variance)
    shown = (ratio / count[:, None])[place]
    freedom = dof * count[place][:, None]
    limit = gammaincinv(freedom, 1 - CHANCE) / freedom
    return np.asarray(np.where(shown > limit, shown * variance, variance))


def _diagonal(variance: Real) -> Complex:
    """Covariance (P, c, c) of channels that have nothing to do with one another."""
    return np.asarray(variance[:, :, None] * np.eye(variance.shape[1]), dtype=np.complex128)


def _trend(own: Real, calm: Sequence[Real], rings: Sequence[Real] | Real, dof: int, rounds: int) -> tuple[Real, Real]:
    """Variance a + sum b_k magnitude_k^2 of each channel, by maximum likelihood of the block variances, (P, c).

    A share b is kept only where it clearly helps, so that plain additive noise stays plain.

    Returns
    -------
    trend, quiet
        Of it all, in units of the mean, and the share of it that does not grow with any of ``rings``.
    """
    flat = np.mean(own, axis=0)
    squares = [m**2 / np.maximum(np.mean(m**2, axis=0), 1e-300) for m in (*calm, *rings)]
    trend, quiet = np.ones_like(own), np.ones_like(own)
    for kept in range(1, len(squares) + 1):
        parts = np.stack([np.ones_like(own), *squares[:kept]])
        shares = np.tile(flat / len(parts), (len(parts), 1))
        v = np.einsum("kc,kpc->pc", shares, parts)
        for _ in range(rounds):  # multiplicative steps keep all positive and never lower the likelihood
            before = shares.copy()
            for k, q in enumerate(parts):
                share = q / v
                shares[k] *= np.sqrt(np.einsum("pc,pc->c", share, own / v) / share.sum(axis=0))
                v += (shares[k] - before[k]) * q
            if np.all(np.abs(shares - before) < SETTLED * flat):
                break
        v = np.einsum("kc,kpc->pc", shares, parts)
        gain = 2 * dof * np.sum(np.log(flat * trend / v) + own / (flat * trend) - own / v, axis=0)
        clear = gain > 10.0 + np.log(len(own))
        still = np.einsum("kc,kpc->pc", shares[: 1 + len(calm)], parts[: 1 + len(calm)])
        trend = np.where(clear, v / flat, trend)
        quiet = np.where(clear, still / v, quiet)
    return trend, quiet


def _mean_factor(unit: Complex, order: NDArray[np.int64]) -> Real:
    """Variance of the mean times B over the variance of a block, (P, c): 1 for independent blocks.

    Noise that the loop feeds back moves the rotor, and the state at a block's borders leaks into its amplitude with
    opposite signs on either side: neighbouring blocks are then correlated negatively, and the mean is better than
    the scatter says (near resonances and at low frequencies). A drift works the other way. The lag-one correlation is
    pooled over neighbours and counts only as far as chance does not explain it.
    """
    blocks = unit.shape[1]
    if blocks < 4:
        return np.ones((unit.shape[0], unit.shape[2]))
    s0 = _smooth(np.sum(np.abs(unit) ** 2, axis=1), order, NEIGHBOURS)
    s1 = _smooth(np.sum(unit[:, 1:] * unit[:, :-1].conj(), axis=1).real, order, NEIGHBOURS)
    shown, chance = _lag_one(blocks)
    gamma = np.linalg.solve(shown, np.stack([s0.ravel(), s1.ravel()])).reshape(2, *s0.shape)
    rho = gamma[1] / np.maximum(gamma[0], 1e-12)
    chance = chance / min(unit.shape[0], INDEPENDENT * NEIGHBOURS)
    rho = np.clip(rho * np.clip(1.0 - 2.0 * chance / np.maximum(rho**2, 1e-12), 0.0, 1.0), -0.5, 0.9)
    level = (blocks - 1) / (blocks - 1 - 2 * (1 - 1 / blocks) * rho)  # gamma0 per demeaned variance
    return np.asarray(level * (1 + 2 * (1 - 1 / blocks) * rho))


def _lag_one(blocks: int) -> tuple[Real, float]:
    """What demeaned blocks show of a covariance gamma0 I + gamma1 T, T the first off-diagonals, and how well.

    Returns
    -------
    shown, variance
        (2, 2) mean power and lag-one product per (gamma0, gamma1), and the variance of gamma1/gamma0 by one channel of
        one point where there is no correlation: of z^H A z it is tr A^2.
    """
    centre = np.eye(blocks) - 1.0 / blocks
    shift = 0.5 * (np.eye(blocks, k=1) + np.eye(blocks, k=-1))
    inner = centre @ shift @ centre
    shown = np.array(
        [[np.trace(centre), np.trace(centre @ (2 * shift))], [np.trace(inner), np.trace(inner @ (2 * shift))]]
    )
    of_rho = np.linalg.inv(shown)[1]
    form = centre @ (of_rho[0] * np.eye(blocks) + of_rho[1] * shift) @ centre
    return shown, float(np.sum(form**2))


def _weights_allowance(blocks: int) -> float:
    """What the correlation of few blocks, which is estimated, makes of a mean square of 1."""
    if blocks < 4:
        return ESTIMATED_WEIGHTS
    return 1.0 + (ESTIMATED_WEIGHTS - 1.0) * _lag_one(blocks)[1] / _lag_one(6)[1]


def _drifting(spread: Complex, own: Real, order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Points whose blocks scatter far more than their neighbours' and follow one another smoothly, (P, c)."""
    n, blocks, _ = spread.shape
    if blocks < 4 or n < 2 * NEIGHBOURS:
        return np.zeros(own.shape, dtype=bool)
    usual = np.empty_like(own)
    usual[order] = median_filter(own[order], size=(2 * NEIGHBOURS + 1, 1), mode="nearest")
    power = np.sum(np.abs(spread) ** 2, axis=1)
    along = np.sum((spread[:, 1:] * spread[:, :-1].conj()).real, axis=1) / np.maximum(power, 1e-300)
    return np.asarray((own > 8 * usual) & (along > 0.3))


def _drawn_together(ratio: Real, order: NDArray[np.int64], dof: int) -> tuple[Real, float]:
    """Variance ratios drawn towards their neighbours' mean, and the prior's degrees of freedom."""
    prior = _prior_dof(ratio, dof)
    weight = 1.0 if np.isinf(prior) else prior / (prior + dof)
    return weight * _smooth(ratio, order, NEIGHBOURS) + (1 - weight) * ratio, prior


def _smooth(values: Real, order: NDArray[np.int64], width: int) -> Real:
    """`_local_mean` along the ascending frequencies."""
    out = np.empty_like(values)
    out[order] = _local_mean(values[order], width)
    return out


def _local_mean(values: Real, width: int) -> Real:
    """Moving mean over ``2 width + 1`` rows with triangular weights, shorter at the ends; values (P, ...)."""
    n = len(values)
    half = np.concatenate([np.arange(1, width + 2), np.arange(width, 0, -1)]) / (width + 1.0)
    total = convolve1d(values, half, axis=0, mode="constant")
    mass = np.convolve(np.ones(n), half)[width : width + n]
    return np.asarray(total / mass.reshape(-1, *([1] * (values.ndim - 1))))


def _prior_dof(ratio: Real, dof: int) -> float:
    """Complex degrees of freedom of the neighbours' mean, from the scatter of the log variances."""
    log = np.log(ratio)
    centre = np.median(log, axis=0)
    scatter = float(np.mean((1.4826 * np.median(np.abs(log - centre), axis=0)) ** 2))
    tails = float(np.mean(np.var(log, axis=0)))
    excess = max(scatter, tails) - float(polygamma(1, dof))
    if excess <= 0.15 * float(polygamma(1, dof)):
        return float("inf")
    return _trigamma_inverse(excess)


def _trigamma_inverse(value: float) -> float:
    """x with trigamma(x) = value, by Newton on 1/trigamma."""
    x = 0.5 + 1.0 / value
    for _ in range(50):
        t = float(polygamma(1, x))
        step = t * (1 - t / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-8 * x:
            break
    return x


def _log_bias(dof: int) -> float:
    """E[log s^2] - log sigma^2 of a complex variance with ``dof`` degrees of freedom."""
    return float(digamma(dof) - np.log(dof))
