"""How large each line of a multisine should be: the powers that tell most within the limits. Pure.

The Fisher information of a line is proportional to its power, and so is what the line takes of a limit on the root
mean square of a signal. So the powers that make the product of the variances of the wanted figures smallest
(D_s-optimal) are the solution of a convex problem. The multiplicative algorithm (Silvey, Titterington and Torsney,
Commun. Stat. A 7, 1978) finds it: each power grows by what its line tells over what it costs (the dispersion function
of Pintelon and Schoukens, System Identification, 2nd ed., 5.4), and prices of limits rise where a limit is exceeded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.loop.margins import computed_response
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Points
from service.identification.plane.zoh import discrete_response
from service.identification.priors.split import Split, log_ratios, split_rows
from service.identification.statistics.derivatives import central_differences

ROUNDS = 300
STRIDE, PRICE_STRIDE = 0.7, 0.3
"""Exponents of the steps of powers and of prices: less than one, so that they do not overshoot."""
TRUST = 1e-9
"""Of the information of equal powers, added to keep what no line tells finite."""


@dataclass(frozen=True)
class LineInformation:
    """What every line tells of a plane, by its power."""

    matrices: Real
    """(L, 2, n, n) Fisher information of the n parameters of one second of one ampere at either axis."""
    held: Real
    """(n, n) of what no line has to tell: the shapes' splits."""
    wanted: Real
    """(k, n) gradients of the logarithms of the wanted figures: ki, ks, damping ratios of modes within the band."""


@dataclass(frozen=True)
class ClosedLoop:
    """Responses of a plane in its loop to one ampere of excitation."""

    u: Complex
    """(L, 2, 2) A/A: [line, signal's axis, excited axis]; of i and y, m/A, likewise."""
    i: Complex
    y: Complex


def closed_loop(model: PlaneModel, controller: tuple[Real, Real], omega: Real) -> ClosedLoop:
    """Responses from r, small signal.

    Parameters
    ----------
    controller
        Numerator and denominator of its discrete transfer function from -y to u.
    omega
        (L,) rad/s.
    """
    c = discrete_response(*controller, omega, model.known.sample_time_s)
    u = np.asarray(np.linalg.inv(np.eye(2) + c[:, None, None] * computed_response(model, omega)), dtype=np.complex128)
    columns = [model.predict(Points(omega, u[:, :, j])) for j in range(2)]
    return ClosedLoop(u, np.stack([p.i for p in columns], axis=2), np.stack([p.y for p in columns], axis=2))


def line_information(
    model: PlaneModel, controller: tuple[Real, Real], omega: Real, variance: Real, end_rad_s: float
) -> LineInformation:
    """Information of lines in closed loop.

    u is what the controller has made of the noise as well, so what is left of i and y, given u, is the amplifiers' and
    the sensors' own noise.

    Parameters
    ----------
    omega
        (L,) rad/s.
    variance
        (L, 4) E|e|^2 of i_A, i_B, y_A, y_B in a record of one second, A^2 and m^2.
    end_rad_s
        Of the band; the damping of a mode beyond it is not wanted.
    """
    free = model.layout.free()
    scale = np.where(model.theta[free] != 0, np.abs(model.theta[free]), 1.0)
    u = closed_loop(model, controller, omega).u
    matrices = []
    for j in range(2):
        p = model.predict(Points(omega, u[:, :, j]), gradient=True)
        assert p.d_i is not None
        assert p.d_y is not None
        slope = np.concatenate([p.d_i, p.d_y], axis=1)[:, :, free] * scale / np.sqrt(variance)[:, :, None]
        matrices.append(2 * (slope.conj().swapaxes(1, 2) @ slope).real)
    held = np.zeros((len(scale), len(scale)))
    if model.layout.n_modes:
        slope = split_rows(model, Split(log_ratios(model)))[1][:, free] * scale
        held = slope.T @ slope
    return LineInformation(np.stack(matrices, axis=1), held, _wanted(model, free, end_rad_s) * scale)


def _wanted(model: PlaneModel, free: np.ndarray, end_rad_s: float) -> Real:
    inside = model.modes[:, 0] <= end_rad_s

    def figures(theta: Real) -> Real:
        m = model.at(theta)
        return np.asarray(np.log(np.concatenate([m.ki, m.ks, np.maximum(m.damping_ratios[inside], 1e-300)])))

    return central_differences(figures, model.theta, free, 1e-6 * np.maximum(np.abs(model.theta[free]), 1e-9))


def best_powers(lines: Sequence[LineInformation], use: Real, rounds: int = ROUNDS) -> Real:
    """Powers a^2 of every line and axis that make the variances of the wanted figures smallest, (L, 2).

    Parameters
    ----------
    lines
        Of one plane, for several models that it may have: the mean of the logarithms of the variances counts.
    use
        (L, S, 2) share that the square of one ampere takes of the limit of each of S mean squares.

    Returns
    -------
    powers
        Within all limits, of which one at least is reached.
    """
    power = np.ones((use.shape[0], 2))
    prices = np.full(use.shape[1], 1.0 / use.shape[1])
    power /= np.max(np.einsum("lsj,lj->s", use, power))
    trust = [TRUST * np.diag(np.diag(np.einsum("lj,ljab->ab", power, i.matrices))) for i in lines]
    for _ in range(rounds):
        told = np.zeros_like(power)
        for info, more in zip(lines, trust, strict=True):
            whole = np.einsum("lj,ljab->ab", power, info.matrices) + info.held + more
            rows = np.linalg.solve(whole, info.wanted.T).T  # (k, n)
            variance = np.einsum("kn,kn->k", rows, info.wanted)
            told += np.einsum("ljab,ab->lj", info.matrices, np.einsum("ka,kb->ab", rows / variance[:, None], rows))
        cost = np.einsum("s,lsj->lj", prices, use)
        worth = told / np.maximum(cost, 1e-300)
        power = power * (worth * np.sum(cost * power) / np.sum(told * power)) ** STRIDE
        used = np.einsum("lsj,lj->s", use, power)
        prices = prices * (used / used.max()) ** PRICE_STRIDE
        prices /= prices.sum()
        power /= used.max()
    return power
