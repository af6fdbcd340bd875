"""Planes of one rotor fitted together: its mass, inertia, centre of gravity and places of sensors are common to them.

Gains of sensors, magnets, amplifiers and modes are each plane's own. What is common lies within tolerances, which count
once. The planes begin where each came to by itself, which agrees only where data tell: in directions of which they tell
nothing the planes lie apart, along valleys that are bent, so that no straight step leads from there to where they meet.

Only small signals count: what the law of the magnets adds at the measured amplitudes is taken out as each plane's model
has it. It would tell the gain of a sensor by how much the force bends, and real magnets do not bend it as ideal ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.joint.refine import Refined
from service.identification.joint.residuals import residuals
from service.identification.joint.selection import Selected
from service.identification.measured.data import Data
from service.identification.plane.layout import GIVEN
from service.identification.plane.model import PlaneModel
from service.identification.priors.beyond import beyond_rows
from service.identification.priors.given import Adjusted, Given, name_in_rig
from service.identification.priors.split import Split, split_rows
from service.identification.priors.tolerances import Tolerances
from service.identification.statistics.least_squares import covariance_of, minimise

MOST_STEPS = 200
DAMPING = 1e-14
"""Of the first step: a tolerance of a gain moves what is seen by tens of thousands of its noise, and together with ki
by nothing; a damping of more than the square of that in inverse would hold it where it is."""
IN_PROPORTION = 0.1
"""Relative step up to which a value changes by a factor; one that is about zero, as a shift is, goes straight."""


@dataclass(frozen=True)
class OneRotor:
    """Mass, geometry and sensor gains of a rig, as its planes together have them."""

    names: tuple[str, ...]
    """As in `GIVEN`, gains with their axis."""
    told: Real
    """What the datasheet says, (n,), and how well it knows."""
    tolerances: Real
    off: Real
    """How far they are from that, in tolerances, (n,), and the covariance of that, (n, n)."""
    covariance: Real

    def of(self, plane: str) -> Given:
        """Those of a plane."""
        at = [self.names.index(name_in_rig(name, plane)) for name in GIVEN]
        std = self.tolerances[at]
        return Given(self.told[at] + std * self.off[at], np.outer(std, std) * self.covariance[np.ix_(at, at)])

    @property
    def adjusted(self) -> tuple[Adjusted, ...]:
        """Every value."""
        columns = (
            self.told + self.tolerances * self.off,
            self.tolerances * np.sqrt(np.diag(self.covariance)),
            self.told,
            self.tolerances,
        )
        return tuple(Adjusted(*row) for row in zip(self.names, *(c.tolist() for c in columns), strict=True))


@dataclass(frozen=True)
class _Part:
    """A plane in the fit: where it begins, and which places of the common vector are its own."""

    selected: Selected
    data: Data
    own: NDArray[np.bool_]
    """(size,) what it moves beside what is given."""
    at: NDArray[np.int64]
    """Places of the latter, and of the former (``there``), in the common vector."""
    there: slice
    told: Tolerances

    def moved(self, whole: Real) -> PlaneModel:
        """The plane by the common vector."""
        model = self.selected.refined.model
        theta = model.theta.copy()
        theta[self.own] = whole[self.there]
        theta[model.layout.given] = self.told.values + self.told.stds * whole[self.at]
        return model.at(theta)

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """(n,) modes beyond the band."""
        return np.asarray(self.selected.refined.model.modes[:, 0] > self.data.plant.omega.max())

    def rows(self, trial: PlaneModel, size: int) -> tuple[Real, Real]:
        """Residuals of its data and of what is known of its modes, and their slopes to the common vector."""
        layout = trial.layout
        moving = self.own.copy()
        moving[layout.given] = True
        r, slopes = residuals(trial, self.data, self.selected.refined.weights, None, free=moving)
        assert slopes is not None
        if (splits := self.selected.splits) is not None:
            # not held, as where the last fit of a plane holds them: they go with the gains of the sensors
            more, its = split_rows(trial, Split(splits.log_ratios, 1.0))
            root = np.linalg.inv(np.linalg.cholesky(splits.covariance))
            beyond, its_beyond = beyond_rows(trial, self.beyond)
            r = np.concatenate([r, root @ more, beyond])
            slopes = np.vstack([slopes, root @ its[:, moving], its_beyond[:, moving]])
        n = int(self.own.sum())  # what is given comes last
        jacobian = np.zeros((len(r), size))
        jacobian[:, self.there] = slopes[:, :n]
        jacobian[:, self.at] = slopes[:, n:] * self.told.stds
        return r, jacobian


def one_rotor(planes: Mapping[str, tuple[Selected, Data]], told: Mapping[str, Tolerances]) -> OneRotor:
    """What planes that were fitted each by itself have in common.

    Parameters
    ----------
    planes
        Joint fits with what is given released, and their data.
    told
        What the datasheet says of that (`Tolerances.of_given`).
    """
    names = list(dict.fromkeys(name_in_rig(name, plane) for plane in planes for name in GIVEN))
    parts, begin, values, tolerances = _parts(planes, told, names)
    n = len(names)

    def residual(whole: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        trials = [part.moved(whole) for part in parts]
        if not all(trial.is_physical for trial in trials):
            return None
        rows = [part.rows(trial, len(whole)) for part, trial in zip(parts, trials, strict=True)]
        known = np.eye(n, len(whole))
        return np.concatenate([*(r for r, _ in rows), whole[:n]]), np.vstack([*(j for _, j in rows), known])

    scale, zero = np.ones(len(begin)), np.zeros(len(begin))
    scale[:n], zero[:n] = tolerances, values

    def moved(whole: Real, step: Real) -> Real:
        """In proportion: what data tell are products, and a straight step along a valley of one leaves it."""
        value, by = zero + scale * whole, scale * step
        share = np.divide(by, value, out=np.full_like(by, np.inf), where=value != 0)
        near = np.abs(share) < IN_PROPORTION
        return np.asarray((np.where(near, value * np.exp(np.where(near, share, 0.0)), value + by) - zero) / scale)

    fit = minimise(residual, begin, np.ones(len(begin), dtype=bool), MOST_STEPS, damping=DAMPING, moved=moved)
    of_data = fit.residual[:-n]
    jacobian = fit.jacobian.copy()
    jacobian[:-n] /= np.sqrt(max(float(of_data @ of_data) / len(of_data), 1.0))
    return OneRotor(tuple(names), values, tolerances, fit.theta[:n], covariance_of(jacobian)[:n, :n])


def _parts(
    planes: Mapping[str, tuple[Selected, Data]], told: Mapping[str, Tolerances], names: list[str]
) -> tuple[list[_Part], Real, Real, Real]:
    """The planes in the fit, where it begins, and what the datasheet says of ``names``, with its tolerances."""
    n = len(names)
    values, tolerances, off, times = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    parts, begin, start = [], [np.zeros(n)], n
    for plane, (selected, data) in planes.items():
        refined, own = selected.refined, told[plane]
        model = refined.model
        at = np.array([names.index(name_in_rig(name, plane)) for name in GIVEN])
        values[at], tolerances[at] = own.values, own.stds
        off[at] += (model.theta[model.layout.given] - own.values) / own.stds
        times[at] += 1
        moves = refined.fit.free.copy()
        moves[model.layout.given] = False
        begin.append(model.theta[moves])
        there = slice(start, start + len(begin[-1]))
        start = there.stop
        parts.append(_Part(selected, _small_signal(refined, data), moves, at, there, own))
    begin[0] = off / times
    return parts, np.concatenate(begin), values, tolerances


def _small_signal(refined: Refined, data: Data) -> Data:
    """The data as a linear magnet would have given them, without what is released."""
    model, points = refined.model, data.plant
    added = model.motion(points.at, refined.amplitude).y - model.motion(points.at).y
    return replace(data, released=None, plant=replace(points, Y=points.Y - added.T[:, None, :]))
