"""The last joint fit: the shapes' splits held where data and knowledge together put them, and their spread about it.

The data tell of splits by the work of the position stiffness, and by how far the bearings move at the loudest lines
(`refine.residuals_following`); the latter only where the model agrees with them, for another force law would tell of
other splits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.joint.refine import FAR, NEAR, Refined, amplitude_of, refine, residuals_following
from service.identification.joint.residuals import residuals
from service.identification.measured.data import Data
from service.identification.priors.split import ROWS, Knowledge, Posterior, Split
from service.identification.priors.split_posterior import posterior
from service.identification.priors.tolerances import Tolerances

MOST_STEPS = 200
CLEAR = 10.0
"""Rise of the misfit that is not the priors' doing."""


def finished(
    refined: Refined, data: Data, free: NDArray[np.bool_], knowledge: Knowledge
) -> tuple[Refined, Posterior | None]:
    """Joint fit with the splits held at their likeliest values, and what is known of them.

    Parameters
    ----------
    refined
        Joint fit of data and knowledge together.
    """
    n_modes = refined.model.layout.n_modes
    if n_modes == 0:
        if data.prior is None:
            return refined, None
        return _fitted(refined, data, free, None, FAR), None
    reach, likeliest = FAR, _fitted(refined, data, free, knowledge, FAR)
    if _data_cost(likeliest, data) > _data_cost(refined, data) + CLEAR:
        # no displacement was measured there: bearings that the data then disagree with do not move so far
        reach, likeliest = NEAR, _fitted(refined, data, free, knowledge, NEAR)
    n = ROWS * n_modes
    r, jacobian, moves = likeliest.fit.residual[:-n], likeliest.fit.jacobian[:-n], likeliest.fit.free
    if data.loose is not None:
        r, jacobian, moves = _with_loose(likeliest, data, data.loose)
    known = posterior(likeliest.model, r, jacobian, moves, knowledge, use_data=refined.relative == 0)
    return _fitted(likeliest, data, free, Split.of(likeliest.model, knowledge.end_rad_s), reach), known


def _with_loose(refined: Refined, data: Data, loose: Tolerances) -> tuple[Real, Real, NDArray[np.bool_]]:
    """Residuals of the data, their slopes, and what moves, where what is held may move within its tolerances.

    The work of the position stiffness, parts in a thousand, is also that of a mass or a distance which is off by as
    much: with these held, the data would tell splits ten times and more as well as they do.
    """
    moves = refined.fit.free.copy()
    moves[refined.model.layout.given] = True
    with_it = replace(data, released=loose)
    r, slopes = residuals_following(refined.model, with_it, refined.weights, moves, refined.reach)
    assert slopes is not None
    return r, slopes, moves


def _fitted(
    refined: Refined, data: Data, free: NDArray[np.bool_], held: Split | Knowledge | None, reach: float
) -> Refined:
    found = refine(
        refined.model,
        data,
        free,
        relative=refined.relative,
        split=held,
        weights=refined.weights,
        max_iterations=MOST_STEPS,
        reach=reach,
        following=isinstance(held, Knowledge) and not refined.relative,
    )
    return replace(found, told_noise=refined.noise, relative=refined.relative)


def _data_cost(refined: Refined, data: Data) -> float:
    """Misfit of the data alone, with the amplitudes at the bearings that the model sees."""
    amplitude = amplitude_of(refined.model, data.plant, refined.reach)
    r, _ = residuals(refined.model, replace(data, prior=None), refined.weights, amplitude, gradient=False)
    return float(r @ r)
