"""Joint fits of a plane whose modes are counted: from a start, from one another, and where no model agrees."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.joint.refine import NEAR, Refined, refine
from service.identification.joint.residuals import Weights, residuals
from service.identification.measured.data import Data
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Knowledge, held_rows, likeliest
from service.identification.statistics.evidence import Evidence, leave_one_out
from service.identification.steps.start import with_modes, with_split

MOSTLY = 0.5
"""Of a model's relative error: what is left where modes beyond the band explain most of it."""

LEVELS, FITTING, BOUNDS = 8, 0.03, (1e-4, 0.3)
"""Rounds at most in which the size of a model's relative error is found, how near to 1 the residuals are to be with it,
and between what it lies."""


@dataclass(frozen=True)
class JointFits:
    """What every joint fit of a plane is made with, and how one is judged by the data alone."""

    data: Data
    knowledge: Knowledge
    _begun: dict[tuple[Layout, bytes, float], Refined] = field(default_factory=dict, repr=False, compare=False)
    """By where they began: where nothing fits, one search is led to the start of another."""

    def free(self, model: PlaneModel) -> NDArray[np.bool_]:
        """What a fit moves: without currents the delay stays as it is told, and amplifiers where no tolerance is."""
        free = model.layout.free(*(() if self.data.released is None else self.data.released.names))
        if self.data.plant.I is None:
            free[model.layout.delay] = False
            for place in model.layout.amplifiers if self.data.prior is None else ():
                free[place] = False
        return free

    def begun(self, start: PlaneModel, beside: float) -> Refined:
        """Forgiving first, then in units of the noise, from splits so much beside the likeliest ones."""
        key = (start.layout, start.theta.tobytes(), beside)
        if key not in self._begun:
            self._begun[key] = self._from(start, beside)
        return self._begun[key]

    def _from(self, start: PlaneModel, beside: float) -> Refined:
        free = self.free(start)
        model = with_split(start, likeliest(start, self.knowledge) + beside)
        # step 3 has the amplifiers: they wait until the rest has found its place
        plant = free.copy()
        for place in model.layout.amplifiers:
            plant[place] = False
        data, split = self.data, self.knowledge
        rough = refine(model, data, plant, relative=0.03, nonlinear=False, split=split, max_iterations=40)
        better = refine(rough.model, data, plant, relative=0.003, nonlinear=True, split=split, reach=NEAR)
        return refine(better.model, data, free, split=split, reach=NEAR)

    def again(self, model: PlaneModel, weights: Weights) -> Refined:
        """From another fit's outcome, with its weights."""
        return refine(model, self.data, self.free(model), split=self.knowledge, weights=weights, reach=NEAR)

    def once_more(self, model: PlaneModel) -> Refined:
        """From the outcome of a fit to nearly the same data."""
        return refine(model, self.data, self.free(model), split=self.knowledge, reach=NEAR)

    def forgiving(self, start: PlaneModel) -> Refined:
        """For a model that cannot agree: without modes beyond the band, which take up what is wrong.

        Unless they explain most of it.
        """
        start = with_split(start, likeliest(start, self.knowledge))
        inside = self.inside(start)
        best = self._with_error(inside)
        if inside.layout.n_modes == start.layout.n_modes:
            return best
        more = self._with_error(start)
        return more if more.relative < MOSTLY * best.relative else best

    def forgiving_again(self, before: Refined) -> Refined:
        """From the outcome of one to nearly the same data."""
        return self._with_error(before.model, before.relative)

    def _with_error(self, model: PlaneModel, level: float = 0.03) -> Refined:
        """The model's error counts as a relative one beside the noise.

        Weighted by noise alone such a fit would follow the loudest lines wherever their error leads. The size of the
        relative error is what makes the residuals fit it.
        """
        found = self._at_level(model, level)
        for _ in range(LEVELS):
            r, _ = residuals(found.model, self.data, found.weights, found.amplitude, gradient=False)
            rms = float(np.sqrt(r @ r / len(r)))
            if abs(rms - 1.0) < FITTING:
                break
            before, level = level, float(np.clip(level * rms, *BOUNDS))
            if level == before:
                break  # it is wrong by more than may be forgiven
            found = self._at_level(found.model, level)
        return found

    def _at_level(self, model: PlaneModel, relative: float) -> Refined:
        return refine(model, self.data, self.free(model), relative=relative, split=self.knowledge, reach=NEAR)

    def inside(self, model: PlaneModel) -> PlaneModel:
        """The same plane without modes beyond the band."""
        return with_modes(model, model.modes[model.modes[:, 0] <= self.data.plant.omega.max()])

    def beyond(self, refined: Refined) -> int:
        """Number of modes beyond the band."""
        return int(np.sum(refined.model.modes[:, 0] > self.data.plant.omega.max()))

    def residual(self, refined: Refined) -> NDArray[np.float64]:
        """Of the data, in units of the noise."""
        return residuals(refined.model, self.data, refined.weights, refined.amplitude, gradient=False)[0]

    def cost(self, refined: Refined) -> float:
        """Sum of squares of the data's residuals."""
        r = self.residual(refined)
        return float(r @ r)

    def cost_before_the_end(self, refined: Refined) -> tuple[float, int]:
        """Sum of squares of the data's residuals but those of the highest line, and their number."""
        points = self.data.plant
        r = self.residual(refined)
        inside = points.omega < points.omega.max() * (1 - 1e-6)
        size = (2 if points.I is None else 4) * 2 * len(inside)
        kept = r[:size].reshape(-1, len(inside), 2)[:, inside]
        return float(np.sum(kept**2) + r[size:] @ r[size:]), kept.size + len(r) - size

    def rms(self, refined: Refined) -> float:
        """Of the data's residuals."""
        return float(np.sqrt(np.mean(self.residual(refined) ** 2)))

    def length(self, refined: Refined) -> float:
        """Description length of the data."""
        return self._evidence("", refined).mdl

    def evidence(self, name: str, refined: Refined, chosen: bool) -> Evidence:
        """All scores of a fit."""
        whole = self._evidence(name, refined)
        left_out = self._left_out(refined)
        return replace(whole, chosen=chosen, note=refined.fit.status, leave_one_out_rms=left_out)

    def _evidence(self, name: str, refined: Refined) -> Evidence:
        r = self.residual(refined)
        return Evidence(name, refined.fit.n_free, len(r), float(r @ r))

    def _left_out(self, refined: Refined) -> float:
        r, jacobian = residuals(refined.model, self.data, refined.weights, refined.amplitude)
        assert jacobian is not None
        held, slope = held_rows(refined.model, self.knowledge)
        whole = np.vstack([jacobian, slope])[:, refined.fit.free]
        # what is known of splits is not left out: it only shares the leverage
        padded = leave_one_out(np.concatenate([r, np.zeros(len(held))]), whole)
        return padded * float(np.sqrt((len(r) + len(held)) / len(r)))
