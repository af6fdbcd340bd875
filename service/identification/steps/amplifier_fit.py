"""Step 3: amplifiers channel by channel, first order, raised when the residual says so.

What a plane's two channels are late by is one delay, of the controller that computes both. A channel by itself may have
another one, which passes for an order that it lacks: orders are chosen with the delay in common where that tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.measured.noise import block_noise
from service.identification.measured.points import PlanePoints
from service.identification.plane import amplifier
from service.identification.plane.amplifier import N_PARAMETERS
from service.identification.statistics.evidence import Evidence, best, leave_one_out
from service.identification.statistics.least_squares import minimise

ORDERS = (1, 2, 3)
FASTEST = 20.0
"""Of natural frequency times sample time: beyond it the samples tell nothing."""


@dataclass(frozen=True)
class AmplifierFit:
    """The amplifier of one channel."""

    parameters: tuple[float, ...]
    delay_s: float
    evidence: tuple[Evidence, ...]
    """One per order that was tried."""
    fits: tuple[tuple[int, Real, float], ...]
    """(order, parameters, delay) of each."""

    @property
    def order(self) -> int:
        """Chosen order."""
        return len(self.parameters) - 1


@dataclass(frozen=True)
class Channel:
    """Points at which u and i of one channel are known."""

    omega: Real
    """(P,)"""
    u: Complex
    i: Complex
    sigma: Real
    """(P,) standard deviation of i."""
    sample_time_s: float
    computing_delay_s: float

    def residual(self, theta: Real) -> tuple[Real, Real] | None:
        """In units of the noise, (2 P,), of parameters and delay, and its slope to them; None where not physical."""
        if np.any(theta[:-1] <= 0) or not np.all(np.isfinite(theta)) or abs(theta[-1]) > 20 * self.sample_time_s:
            return None
        if np.max(np.r_[theta[1], theta[3:-1]]) * self.sample_time_s > FASTEST:
            return None
        late = theta[-1] + self.computing_delay_s
        response, slope = amplifier.sampled(self.omega, theta[:-1], late, self.sample_time_s)
        weight = np.sqrt(2.0) / self.sigma
        e = weight * (self.i - response * self.u)
        d = -(weight * self.u)[:, None] * slope
        return np.concatenate([e.real, e.imag]), np.concatenate([d.real, d.imag])


def amplifier_fits(
    sets: list[PlanePoints],
    nominal: tuple[tuple[float, ...], tuple[float, ...]],
    sample_time_s: float,
    computing_delay_s: float,
) -> tuple[AmplifierFit, AmplifierFit]:
    """Models of a plane's two amplifiers from all points at which their u and i are known.

    Parameters
    ----------
    sets
        Points of the plant's and of the amplifier's sweep.
    nominal
        (gain, w) or (gain, w, zeta) of the datasheet for A and B: where the search starts.
    """
    a, b = (_channel(sets, c, sample_time_s, computing_delay_s) for c in (0, 1))
    return with_one_delay((a, b), (amplifier_fit(a, nominal[0]), amplifier_fit(b, nominal[1])))


def amplifier_fit(channel: Channel, nominal: tuple[float, ...]) -> AmplifierFit:
    """Model of one amplifier by itself; ``nominal`` as in `amplifier_fits`."""
    candidates, found = [], []
    start = np.array([*nominal[:2], *(nominal[2:3] or (0.8,))])
    delay = 0.0
    for order in ORDERS:
        theta = np.append(_start(order, start, channel.sample_time_s), delay)
        theta, cost, left_out = _fit(theta, channel)
        found.append((order, theta[:-1], float(theta[-1])))
        n = 2 * len(channel.omega)
        candidates.append(Evidence(f"order {order}", len(theta), n, cost, leave_one_out_rms=left_out))
        if order >= 2:
            start, delay = theta[:3], float(theta[-1])
    return _picked(found, candidates, best(candidates))


def with_one_delay(
    channels: tuple[Channel, Channel], alone: tuple[AmplifierFit, AmplifierFit]
) -> tuple[AmplifierFit, AmplifierFit]:
    """The same, of higher orders where the two channels' delays would differ beyond doubt, and then would not."""
    orders = list(product(ORDERS[alone[0].order - 1 :], ORDERS[alone[1].order - 1 :]))
    candidates = [_together(channels, alone, orders[0])]
    cost = sum(f.evidence[f.order - 1].cost for f in alone)
    if best([candidates[0], replace(candidates[0], n_parameters=candidates[0].n_parameters + 1, cost=cost)]) == 0:
        return alone
    candidates += [_together(channels, alone, o) for o in orders[1:]]
    chosen = orders[best(candidates)]
    a, b = (_picked(list(f.fits), list(f.evidence), o - 1) for f, o in zip(alone, chosen, strict=True))
    return a, b


def _together(
    channels: tuple[Channel, Channel], alone: tuple[AmplifierFit, AmplifierFit], orders: tuple[int, int]
) -> Evidence:
    """Scores of both amplifiers with these orders and one delay, from where each by itself has led."""
    own = [f.fits[o - 1] for f, o in zip(alone, orders, strict=True)]
    n = orders[0] + 1
    size = n + orders[1] + 2

    def residual(t: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        a, b = channels[0].residual(t[np.r_[:n, size - 1]]), channels[1].residual(t[n:])
        if a is None or b is None:
            return None
        slope = np.zeros((len(a[0]) + len(b[0]), size))
        slope[: len(a[0]), np.r_[:n, size - 1]], slope[len(a[0]) :, n:] = a[1], b[1]
        return np.concatenate([a[0], b[0]]), slope

    delay = float(np.mean([d for _, _, d in own]))
    theta = np.concatenate([own[0][1], own[1][1], [delay]])
    fit = minimise(residual, theta, np.ones(size, dtype=bool), max_iterations=40)
    return Evidence(f"orders {orders[0]} and {orders[1]}", size, len(fit.residual), fit.cost)


def _channel(sets: list[PlanePoints], channel: int, sample_time_s: float, computing_delay_s: float) -> Channel:
    # a channel's own points say nearly all; the others keep the gain honest at small currents
    own = [s.select(s.axis == channel) for s in sets if s.I is not None]
    omega = np.concatenate([s.omega for s in own])
    u = np.concatenate([s.u[:, channel] for s in own])
    blocks = [(np.asarray(s.I)[:, :, channel], s.U[:, :, channel]) for s in own]
    i = np.concatenate([b[0].mean(axis=1) for b in blocks])
    # u scatters with the noise that the loop feeds back: what i makes of it is no noise of i
    sigma = np.concatenate(
        [
            block_noise((bi - (bi.mean(axis=1) / bu.mean(axis=1))[:, None] * bu)[:, :, None], s.omega).sigma[:, 0]
            for (bi, bu), s in zip(blocks, own, strict=True)
        ]
    )
    return Channel(omega, u, i, sigma, sample_time_s, computing_delay_s)


def _picked(found: list[tuple[int, Real, float]], candidates: list[Evidence], pick: int) -> AmplifierFit:
    return AmplifierFit(
        tuple(found[pick][1].tolist()),
        found[pick][2],
        tuple(replace(e, chosen=k == pick) for k, e in enumerate(candidates)),
        tuple(found),
    )


def _start(order: int, known: Real, sample_time_s: float) -> Real:
    """Start of an order from the best second-order amplifier known; what lies beyond the samples is drawn in."""
    fastest = 0.5 * FASTEST / sample_time_s
    gain, w, zeta = known[0], min(known[1], fastest), known[2]
    return np.array([gain, w, zeta, min(6.0 * w, fastest)])[: N_PARAMETERS[order]]


def _fit(theta: Real, channel: Channel) -> tuple[Real, float, float]:
    def residual(t: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        return channel.residual(t)

    fit = minimise(residual, theta, np.ones(len(theta), dtype=bool), max_iterations=40)
    return fit.theta, fit.cost, leave_one_out(fit.residual, fit.jacobian)
