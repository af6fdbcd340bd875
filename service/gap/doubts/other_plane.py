"""Couplings of x and y as they show in data of one plane alone: through the closed loop of the other plane.

A share k of the force of x acts in y and moves the rotor there; the loop of y responds, and a share k of its force acts
in x. So the plant of x changes by k squared times a response of y's closed loop, which may look like a lag of some
nanoseconds. The unmeasured plane is assumed to be like the measured one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import displacement_jacobian
from service.gap.fitting.predict import at_speed_of, weight
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT
from service.gap.weighing.verdict import MAX_SHARE_LEFT
from service.gap.which.explained import Explained
from sim.actuator import gap_factor
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model
from sim.wording import in_words

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

STRENGTH = {"magnetic_cross_coupling": "rotation_rad", "cross_coupled_stiffness": "stiffness_n_per_m"}


@dataclass(frozen=True)
class Across:
    """An effect that couples x and y and could explain the plant's gap."""

    effect: str
    strength: float
    """in the unit of the effect's `STRENGTH` parameter"""
    left: float
    """share of the gap that it leaves"""

    @property
    def words(self) -> str:
        """The effect with its strength."""
        unit = next(p.unit for p in CATALOGUE[self.effect].parameters if p.name == STRENGTH[self.effect])
        return f"{in_words(self.effect)} of {self.strength:.2g} {unit}"


def across_alike(e: Explained) -> list[Across]:
    """Couplings that explain most of the plant's gap of a rig with two axes, the best first.

    Nuisance values are refitted beside each, to first order.
    """
    has_gap = e.significance > SIGNIFICANT or bool(e.chosen.effects)  # an effect may show a gap that no band shows
    if e.part.path != "plant" or e.ground.nuisance.rig.n_axes > 2 or not has_gap:
        return []
    o, fit = e.ground.observations[0], e.null.candidate.fit
    f = o.fundamental
    w = weight(o, "y")[:, f]
    z = _real(e.plain[0][:, f])
    rig = at_speed_of(fit.rig, o)
    J = displacement_jacobian(e.ground.nuisance, rig, o)
    J = np.stack([_real(w * J[:, :, k]) for k in fit.active], axis=1)
    hessian = J.T @ J + np.eye(J.shape[1])
    before = float(z @ z)
    noise = min(float(z.size), *(r.candidate.fit.groups[0][0] for r in e.order))
    found = []
    for effect, change in signatures(rig, o).items():
        d = _real(w * change)
        by_nuisance = J.T @ d
        power = float(d @ d - by_nuisance @ np.linalg.solve(hessian, by_nuisance))
        if power <= 0:
            continue
        square = float(d @ z) / power  # J^T z is in balance with the prior at the plain twin's fit
        if effect == "cross_coupled_stiffness" and square <= 0:  # k out and -k back: no real k
            continue
        after = before - square**2 * power
        left = max(after - noise, 0.0) / max(before - noise, 1e-9)
        known = CATALOGUE[effect].of(e.ground.nuisance.rig).parameters
        parameter = next(p for p in known if p.name == STRENGTH[effect])
        strength = float(np.sqrt(abs(square)))
        if left <= MAX_SHARE_LEFT and strength <= parameter.high:
            found.append(Across(effect, strength, left))
    return sorted(found, key=lambda a: a.left)


def signatures(rig: Rig, o: Observation) -> dict[str, Complex]:
    """Change of y at the fundamental, (P, n), per squared strength of each effect; ``rig`` at the observation's speed.

    Magnets rotated by an angle a change y by a^2 times their signature, a symmetric coupling of share b by -b^2 times
    it. What a rotation takes off the gain of its own plane is an error of ki and ks.
    """
    model = linear_model(rig, o.frequency_hz)
    ki, C = np.diag(model.point.ki), model.controllers[:, :, None]
    ks = (model.point.ks * gap_factor(rig.magnets, model.omega_rad_s))[:, :, None] * np.eye(rig.n_axes)
    there = ki @ model.flux_per_u + ks @ model.bearing_per_u  # magnets' force per u
    controlled = C * model.sensitivity @ model.y_per_force  # -u per force in the other plane, its loop closed
    moved = model.bearing_per_force - model.bearing_per_u @ controlled  # its bearings' displacement per force
    back = ks @ moved - ki @ model.flux_per_u @ controlled  # what its magnets answer
    U = o.U[:, o.fundamental, :, None]

    def change(of: Complex) -> Complex:
        return np.asarray((of[o.line] @ U)[..., 0])

    return {
        "magnetic_cross_coupling": change(-model.y_per_force @ back @ there),
        "cross_coupled_stiffness": change(-model.y_per_force @ moved @ model.bearing_per_u),
    }


def _real(z: Complex) -> Real:
    return np.concatenate([z.real.ravel(), z.imag.ravel()])
