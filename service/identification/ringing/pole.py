"""What a pole of the closed loop leaves in a point's blocks when a tone starts or follows another.

See `transient` for the formula.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import Sampled, closed_loop_poles, sampled, with_currents
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel

STEPS = 50
"""In which a loop that grows in the model is made to decay, at most."""


@dataclass(frozen=True)
class Ringing:
    """One pole over the points: what a unit of it leaves in the first block, and how it goes on."""

    start: Complex
    """(P, c) before it is averaged over the first block."""
    mean: Complex
    """(P,) what averaging makes of it."""
    powers: Complex
    """(P, B)"""

    @property
    def trace(self) -> Complex:
        """What is left in the first block, (P, c)."""
        return self.mean[:, None] * self.start

    @property
    def left(self) -> Complex:
        """What is left in every block, (P, B, c)."""
        return np.asarray(self.powers[:, :, None] * self.trace[:, None, :])


@dataclass(frozen=True)
class RingingPole:
    """A pole and what it leaves, without what hangs on the length of the blocks."""

    points: PlanePoints
    away: Complex
    """(P,) (p - jw) times the sample time."""
    start: Complex
    """(P, c) of a transient as large as a start from rest leaves it, before it is averaged over a block."""
    sample_time_s: float

    @classmethod
    def of(cls, points: PlanePoints, model: PlaneModel, controller: tuple[Real, Real], pole: complex) -> RingingPole:
        """For one pole.

        Near it u = (I + C G)^-1 r is  v (w' r) / (w' D v) / (s - p),  D the derivative of I + C G to s at the pole, v
        and w its null vectors: with r at rest before, a tone of amplitude a begun at bearing k leaves
        |w_k / (w' D v)| a / |jw - p| along v, of a phase that hangs on when the point was recorded.

        Parameters
        ----------
        points, model, controller
            Where it is wanted; the plane; numerator and denominator of u = C(z)(-y), as it ran.
        pole
            rad/s, of the closed loop.
        """
        period, omega = model.known.sample_time_s, points.omega
        system = with_currents(model, sampled(model))
        z = np.exp(pole * period)
        at_pole = _transfer(system, np.array([z]))[0]
        c = complex(np.polyval(controller[0], z) / np.polyval(controller[1], z))
        w, _, vh = np.linalg.svd(np.eye(2) + c * at_pole[2:])
        left, right = w[:, -1].conj(), vh[-1].conj()
        step = 1e-5 * abs(pole)
        ahead, behind = (_returned(system, controller, np.exp((pole + d) * period)) for d in (step, -step))
        woken = np.abs(left / (left @ ((ahead - behind) / (2 * step)) @ right))
        seen = (at_pole - _transfer(system, np.exp(1j * omega * period))) @ right
        start = woken[points.axis] * np.abs(points.r[np.arange(len(omega)), points.axis]) / np.abs(1j * omega - pole)
        rung = start[:, None] * (seen if points.I is not None else seen[:, 2:])
        return cls(points, np.asarray((pole - 1j * omega) * period, dtype=np.complex128), rung, period)

    def ringing(self, block_s: Real) -> Ringing:
        """For blocks of a length, (P,) s."""
        turn = np.exp(self.away * (block_s / self.sample_time_s))
        mean = (turn - 1.0) / (np.expm1(self.away) * block_s / self.sample_time_s)
        powers = turn[:, None] ** np.arange(self.points.n_blocks)
        return Ringing(self.start, np.asarray(mean, dtype=np.complex128), np.asarray(powers, dtype=np.complex128))


def _returned(system: Sampled, controller: tuple[Real, Real], z: complex) -> Complex:
    """I + C G of the loop, (2, 2)."""
    c = complex(np.polyval(controller[0], z) / np.polyval(controller[1], z))
    return np.asarray(np.eye(2) + c * _transfer(system, np.array([z]))[0, 2:])


def _transfer(system: Sampled, z: Complex) -> Complex:
    inner = z[:, None, None] * np.eye(len(system.A)) - system.A
    right = np.broadcast_to(system.B.astype(complex), (len(z), *system.B.shape))
    return np.asarray(system.C @ np.linalg.solve(inner, right))


def slow_poles(model: PlaneModel, controller: tuple[Real, Real], block_s: float, gone: float) -> list[complex]:
    """Poles of the loop of which more than ``gone`` is left after a block, one of each pair, rad/s."""
    z = closed_loop_poles(model, controller)
    z = z[(np.abs(z) > 1e-6) & (np.abs(z) < 1.0) & (z.imag >= 0)]
    s = np.log(z) / model.known.sample_time_s
    return [complex(p) for p in s if np.exp(p.real * block_s) > gone]


def as_it_ran(model: PlaneModel, controller: tuple[Real, Real], decay_per_s: float) -> PlaneModel:
    """The model; where its loop grows, as no loop did in which a rotor was measured, one that decays with that rate.

    Points in which a mode rang can give it a damping far too small. What is missing is added to the damping of the mode
    next to what grows.
    """
    theta, tamed = model.theta.copy(), model
    for _ in range(STEPS):
        z = closed_loop_poles(tamed, controller)
        s = np.log(z[np.abs(z) > 1e-6]) / model.known.sample_time_s
        worst = complex(s[np.argmax(s.real)])
        if (tamed is model and worst.real < 0) or worst.real <= -decay_per_s:
            return tamed
        if not model.layout.n_modes:
            break
        k = int(np.argmin(np.abs(model.modes[:, 0] - abs(worst.imag))))
        theta[model.layout.mode(k).start + 1] += 2 * (worst.real + decay_per_s)
        tamed = model.at(theta)
        if not tamed.is_physical:  # what grows is no mode: a fit that found none there is told of where it is judged
            break
    return model
