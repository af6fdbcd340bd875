"""Noise of a check's few tones, from what the rig does at rest.

A commissioning has hundreds of points, so each one's variance can be drawn from its neighbours' blocks. A check has
some twenty frequencies between 10 Hz and 1 kHz: neighbours are not alike, and near a mode the blocks scatter several
times more than the mean of them does, because what the rotor moves at a block's border leaks into both blocks with
opposite signs. Weights from blocks then leave standard deviations a third too small. The zero-excitation record has
blocks about as long as a whole tone; its residuals under the model are the noise of a tone's mean. The tones' own
blocks only tell whether excitation makes more of it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from service.experiment.data import Experiment, Sweep
from service.identification.arrays import Complex, Real
from service.identification.joint.residuals import Weights, predicted_blocks, residual_blocks
from service.identification.measured.noise import DRIFT, block_noise
from service.identification.measured.points import PlanePoints, planes_of, same_frequency
from service.identification.plane.model import PlaneModel
from service.identification.statistics.whitening import whitener

OCTAVES = 0.5
"""Half-width of the smoothing of the spectrum at rest."""
LINE = 10.0
"""A line of the record that stands so far above the others, in variance, is the mains': tones keep clear of it."""


def check_weights(model: PlaneModel, points: PlanePoints, experiment: Experiment) -> Weights:
    """Whitening of a check's residuals under a model."""
    i, y = predicted_blocks(model, points, None)
    residual = residual_blocks(points, i, y)
    seconds = _block_seconds(experiment.main)[points.index]
    density = rest_density(model, points, experiment)
    if density is None:
        scale = 1 / np.sqrt(seconds)
        size = y if points.I is None else np.concatenate([i, y], axis=2)
        alike = residual / scale[:, None, None]
        magnitude = np.abs(size.mean(axis=1)) / scale[:, None]
        covariance = block_noise(alike, points.omega, magnitude=magnitude, suspect=points.suspect).covariance
        covariance = covariance * (scale**2)[:, None, None]
    else:
        blocks = points.n_blocks
        covariance = density / (blocks * seconds)[:, None, None]
        own = _of_frequency(np.var(residual, axis=1, ddof=1) * seconds[:, None], points.omega) / seconds[:, None]
        ratio = own / (blocks * np.einsum("pcc->pc", covariance).real)
        level = np.median(ratio, axis=0) / _median_of_variance(2 * (blocks - 1))
        covariance = covariance * np.sqrt(level)[:, None] * np.sqrt(level)
        # what leaks at borders cancels in the mean but for the first and the last: a share of one in so many blocks
        leak = np.maximum(ratio / level - 1.0, 0.0) / blocks
        # what has not settled is off by more than its noise
        off = np.where(points.suspect[:, None], np.maximum(ratio / level, 1.0) * blocks * DRIFT, 1.0 + leak)
        covariance = covariance * np.sqrt(off)[:, :, None] * np.sqrt(off)[:, None, :]
    return Weights(whitener(covariance), None)


def rest_density(model: PlaneModel, points: PlanePoints, experiment: Experiment) -> Complex | None:
    """Covariance times block length of the residuals at rest, at the points' frequencies, (P, c, c).

    The residuals are those of the fit: what i and y do that the model does not predict from u. None without a record.
    """
    with_i = points.I is not None
    rest = next((s for s in experiment.sweeps if s.kind == "noise" and s.n_points and 1 in s.harmonics), None)
    if rest is None or rest.U.shape[1] < 2 or (with_i and rest.I is None):
        return None
    pair = list(planes_of(tuple(experiment.axes))[points.plane])
    where = (slice(None), slice(None), rest.harmonic(1), pair)
    use = rest.frequency_hz > 0
    omega = 2 * np.pi * rest.frequency_hz[use]
    u = rest.U[where][use]
    parts = [rest.Y[where][use] - np.einsum("pyu,pbu->pby", model.response(omega), u)]
    if with_i:
        assert rest.I is not None
        parts.insert(0, rest.I[where][use] - model.amplifier_response(omega, base_band=False)[:, None, :] * u)
    e = np.concatenate(parts, axis=2)
    e = e - e.mean(axis=1, keepdims=True)
    e = e * np.sqrt(_block_seconds(rest)[use] / (e.shape[1] - 1))[:, None, None]
    power = np.sum(np.abs(e) ** 2, axis=1)
    usual = np.median(power, axis=0)
    if not np.all(usual > 0):
        return None
    e = e * np.sqrt(np.minimum(1.0, LINE * usual / np.maximum(power, 1e-300)))[:, None, :]
    density = np.einsum("pbc,pbd->pcd", e, e.conj())
    weight = np.exp(-0.5 * (np.log2(points.omega[:, None] / omega) / OCTAVES) ** 2) + 1e-12
    near = np.einsum("pk,kcd->pcd", weight / weight.sum(axis=1, keepdims=True), density)
    return np.asarray(near + 1e-3 * np.diag(usual))


def _of_frequency(values: Real, omega: Real) -> Real:
    """Mean over the points of each frequency: the same noise, whichever axis is excited."""
    out = values.copy()
    for group in same_frequency(omega):
        out[group] = values[group].mean(axis=0)
    return out


def _median_of_variance(freedom: int) -> float:
    """Median of a complex variance estimate in units of the variance.

    >>> round(_median_of_variance(5), 3)
    0.934
    """
    return float(gammaincinv(freedom, 0.5) / freedom)


def _block_seconds(sweep: Sweep) -> Real:
    """Length of every point's blocks, s; one for all where the file does not tell."""
    if sweep.block_samples is None:
        return np.ones(sweep.n_points)
    return np.asarray(sweep.block_samples / sweep.sample_rate_hz)
