"""Step 3: amplifiers channel by channel, first order, raised when the residual says so."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.identification import amplifier
from service.identification.amplifier import N_PARAMETERS
from service.identification.evidence import Evidence, best, leave_one_out
from service.identification.least_squares import minimise
from service.identification.noise import block_noise
from service.identification.points import PlanePoints
from service.identification.zoh import Complex, Real

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


def amplifier_fit(
    sets: list[PlanePoints],
    channel: int,
    nominal: tuple[float, ...],
    sample_time_s: float,
    computing_delay_s: float,
    orders: tuple[int, ...] = (1, 2, 3),
) -> AmplifierFit:
    """Model of one amplifier from all points at which its u and i are known.

    Parameters
    ----------
    sets
        Points of the plant's and of the amplifier's sweep.
    channel
        0 for A, 1 for B.
    nominal
        (gain, w) or (gain, w, zeta) of the datasheet: where the search starts.
    """
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
    candidates, found = [], []
    start = np.array([*nominal[:2], *(nominal[2:3] or (0.8,))])
    delay = 0.0
    for order in orders:
        theta = np.append(_start(order, start, sample_time_s), delay)
        theta, cost, left_out = _fit(theta, omega, u, i, sigma, sample_time_s, computing_delay_s)
        found.append((order, theta[:-1], float(theta[-1])))
        candidates.append(Evidence(f"order {order}", len(theta), 2 * len(omega), cost, leave_one_out_rms=left_out))
        if order >= 2:
            start, delay = theta[:3], float(theta[-1])
    pick = best(candidates)
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


def _fit(
    theta: Real, omega: Real, u: Complex, i: Complex, sigma: Real, sample_time_s: float, computing_delay_s: float
) -> tuple[Real, float, float]:
    weight = np.sqrt(2.0) / sigma

    def residual(t: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        if np.any(t[:-1] <= 0) or not np.all(np.isfinite(t)) or abs(t[-1]) > 20 * sample_time_s:
            return None
        if np.max(np.r_[t[1], t[3:-1]]) * sample_time_s > FASTEST:
            return None
        response, slope = amplifier.sampled(omega, t[:-1], t[-1] + computing_delay_s, sample_time_s)
        e = weight * (i - response * u)
        d = -(weight * u)[:, None] * slope
        return np.concatenate([e.real, e.imag]), np.concatenate([d.real, d.imag])

    fit = minimise(residual, theta, np.ones(len(theta), dtype=bool), max_iterations=40)
    return fit.theta, fit.cost, leave_one_out(fit.residual, fit.jacobian)
