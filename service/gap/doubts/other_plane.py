"""What couples x and y, seen in one plane alone: it goes out to the other plane and comes back through its loop.

A share k of the force of x acts in y and moves the rotor there; the loop of y answers, and a share k of its force
comes back. So the plant of x changes by the square of k, in the shape of y's closed loop; a lag of some nanoseconds
looks like that. The other plane is taken to be built as the measured one.
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
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model
from sim.wording import in_words

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

STRENGTH = {"magnetic_cross_coupling": "rotation_rad", "cross_coupled_stiffness": "stiffness_n_per_m"}


@dataclass(frozen=True)
class Across:
    """An effect that couples x and y and could make the plant's gap."""

    effect: str
    strength: float
    """that it would have, in the unit of the effect's own parameter"""
    left: float
    """share of the gap that it would leave"""

    @property
    def words(self) -> str:
        """The effect with its strength."""
        unit = next(p.unit for p in CATALOGUE[self.effect].parameters if p.name == STRENGTH[self.effect])
        return f"{in_words(self.effect)} of {self.strength:.2g} {unit}"


def across_alike(e: Explained) -> list[Across]:
    """Effects across that explain the plant's gap of a rig with two axes as well as another law of one effect would.

    The datasheet's values are refitted beside each, to first order.
    """
    there = e.significance > SIGNIFICANT or bool(e.chosen.effects)  # an effect may tell what no band does by itself
    if e.part.path != "plant" or e.ground.nuisance.rig.n_axes > 2 or not there:
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
        taken = J.T @ d
        size = float(d @ d - taken @ np.linalg.solve(hessian, taken))
        if size <= 0:
            continue
        square = float(d @ z) / size  # the refitted values are where the plain twin's are best already
        if effect == "cross_coupled_stiffness" and square <= 0:  # what goes out by k comes back by -k
            continue
        after = before - square**2 * size
        left = max(after - noise, 0.0) / max(before - noise, 1e-9)
        known = CATALOGUE[effect].of(e.ground.nuisance.rig).parameters
        parameter = next(p for p in known if p.name == STRENGTH[effect])
        strength = float(np.sqrt(abs(square)))
        if left <= MAX_SHARE_LEFT and strength <= parameter.high:
            found.append(Across(effect, strength, left))
    return sorted(found, key=lambda a: a.left)


def signatures(rig: Rig, o: Observation) -> dict[str, Complex]:
    """Change of y at the fundamental, (P, n), per square of an effect's strength; ``rig`` at the observation's speed.

    Magnets that are turned by a give a^2 times theirs, beside what their own plane has less; a symmetric share of b
    gives -b^2 times it.
    """
    model = linear_model(rig, o.frequency_hz)
    ki, ks, C = np.diag(model.point.ki), np.diag(model.point.ks), model.controller[:, None, None]
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
