"""How many flexible modes: joint fits with one mode less and one more, judged by their description length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.etfe import FrequencyResponse
from service.identification.evidence import Evidence
from service.identification.finish import finished
from service.identification.flexible import is_visible, search, tells
from service.identification.joint import JointFits
from service.identification.plane_model import N_MODE, PlaneModel
from service.identification.rational import LONE_LINE
from service.identification.refine import Refined
from service.identification.residuals import Data, Weights
from service.identification.split import Knowledge, Posterior, likeliest
from service.identification.start import modes_from, remote, searched_starts, with_modes, with_split

MAX_MODES = 9
ADEQUATE = 1.5
"""Residual over noise below which a model counts as agreeing with the data while modes are counted."""
LOST = 10.0
"""The same beyond which a fit is taken to have begun with the wrong modes."""
CLEAR = 10.0
"""Fall of the description length that a mode within the band has to bring."""
BEYOND_GAIN = 20.0
"""Gain of twice the log likelihood that one beyond the band has to bring: of six parameters for nothing chance has more
than that in three of a thousand cases."""
COARSE = 60
"""Lines fewer than which leave it to chance what the poles and residues of a plant stand for: it then begins with modes
of what the rigid rotor leaves."""
WORK = 0.005
"""Share of a mode's stiffness that the position stiffness takes beyond which a fit may have begun at wrong splits."""
SOFT = 1.5
"""Then it begins once more with shapes so much smaller at the bearings, where the position stiffness does no work."""


@dataclass(frozen=True)
class Selected:
    """The joint fit with the number of modes that the data support."""

    refined: Refined
    splits: Posterior | None
    """What is known of the shapes' splits; None without modes."""
    evidence: tuple[Evidence, ...]
    candidates: tuple[PlaneModel, ...] = ()
    """The joint fits that the evidence is of."""


def choose_modes(
    start: PlaneModel,
    rigid_model: PlaneModel,
    data: Data,
    plant: FrequencyResponse,
    lowest_rad_s: float,
    knowledge: Knowledge,
) -> Selected:
    """Joint fit with the number of modes that the description length supports.

    Parameters
    ----------
    start
        Plane to begin with, amplifiers fitted, modes where the measured plant has its poles.
    rigid_model
        The staged fit's; modes are looked for in what it leaves on few lines, or where ``start`` led nowhere.
    plant
        Measured plant from coil current to y, for the search of further modes.
    lowest_rad_s
        No mode is looked for below.

    The datasheet's word, where it is asked for, counts in the last fit: modes are chosen by the data alone.
    """
    fits = JointFits(replace(data, prior=None), knowledge)
    counting = _Counting(fits, plant, lowest_rad_s)
    coarse = len(plant.omega) < COARSE
    searched = searched_starts(rigid_model, plant, lowest_rad_s) if coarse else []
    found = counting.from_starts(searched or [start])
    if fits.rms(found.best) > ADEQUATE:
        found = counting.or_from(found, [start] if searched else searched_starts(rigid_model, plant, lowest_rad_s))
    if fits.rms(found.best) > ADEQUATE and _work(found.start) > WORK:
        found = counting.or_from(found, [found.start], SOFT)
    inside = fits.inside(found.start)
    if inside.layout.n_modes < found.start.layout.n_modes and fits.rms(found.best) > LOST:
        found = counting.or_from(found, [inside])
    numbers = sorted(found.tried)
    evidence = tuple(
        fits.evidence("1 mode" if n == 1 else f"{n} modes", found.tried[n], n == found.number) for n in numbers
    )
    candidates = tuple(found.tried[n].model for n in numbers)
    best = found.best
    if fits.rms(best) > ADEQUATE:
        best = fits.forgiving(found.start)
    free = JointFits(data, knowledge).free(best.model)
    return Selected(*finished(best, data, free, knowledge), evidence, candidates)


def _work(model: PlaneModel) -> float:
    """Share of a mode's stiffness that the position stiffness takes, the largest of the modes."""
    m = model.modes
    return float(np.max(m[:, 2:4] ** 2 @ model.ks / m[:, 0] ** 2, initial=0.0))


@dataclass(frozen=True)
class _Counted:
    """Joint fits by number of modes, and the number that the data support."""

    start: PlaneModel
    tried: dict[int, Refined]
    number: int

    @property
    def best(self) -> Refined:
        return self.tried[self.number]


@dataclass(frozen=True)
class _Counting:
    """The search for the number of modes from one start or another."""

    fits: JointFits
    plant: FrequencyResponse
    lowest_rad_s: float

    def or_from(self, found: _Counted, starts: list[PlaneModel], beside: float = 0.0) -> _Counted:
        """What was found, or what other starts lead to, whichever describes the data in fewer words."""
        if not starts:
            return found
        other = self.from_starts(starts, beside)
        return other if self.fits.length(other.best) < self.fits.length(found.best) else found

    def from_starts(self, starts: list[PlaneModel], beside: float = 0.0) -> _Counted:
        """Count from the first of the starts that leads anywhere; ``beside``: see `JointFits.begun`."""
        first = self._begun(starts, beside)
        weights, now = first.weights, first.model.layout.n_modes
        begun = now
        tried: dict[int, Refined] = {now: first}
        # fewer: leave out the mode that matters least, while that is no loss
        while now > 0:
            tried[now - 1] = self._without_one(tried[now], weights)
            if self._needed(tried[now - 1], tried[now]):
                break
            now -= 1
        if now != begun and self.fits.rms(tried[now]) < LOST:
            return _Counted(starts[0], tried, now)
        # more: while it pays, looking one further when a mode helps much but not enough
        at = now
        while at < MAX_MODES:
            more = self._with_one_more(tried[at], weights)
            if more is None:
                break
            at += 1
            tried[at] = more
            if self._pays(tried[now], more):
                now = at
            elif at - now > 1 or self.fits.cost(more) > 0.5 * self.fits.cost(tried[now]):
                break
        return _Counted(starts[0], tried, now)

    def _begun(self, starts: list[PlaneModel], beside: float) -> Refined:
        """The joint fit from the first start, or where that is lost from the others, and in the end from fewer modes.

        On coarse data several poles may stand for one peak, or one be sharper than the lines around it can tell.
        """
        found = self.fits.begun(starts[0], beside)
        for start in starts[1:]:
            found = self._or_begun(found, start, beside)
        start = starts[0]
        while start.layout.n_modes > 1 and self.fits.rms(found) > LOST:
            start = with_modes(start, np.delete(start.modes, self._least_seen(start), axis=0))
            found = self._or_begun(found, start, beside)
        return found

    def _or_begun(self, found: Refined, start: PlaneModel, beside: float) -> Refined:
        """A fit, or where it is lost the one from another start if that halves the misfit."""
        if self.fits.rms(found) < LOST:
            return found
        other = self.fits.begun(start, beside)
        return other if self.fits.cost(other) < 0.5 * self.fits.cost(found) else found

    def _without_one(self, refined: Refined, weights: Weights) -> Refined:
        """The joint fit without the mode that the measured lines see least of."""
        keep = np.delete(refined.model.modes, self._least_seen(refined.model), axis=0)
        return self.fits.again(with_modes(refined.model, keep), weights)

    def _least_seen(self, model: PlaneModel) -> int:
        return int(np.argmin([self._seen(with_modes(model, m[None, :])) for m in model.modes]))

    def _seen(self, model: PlaneModel) -> float:
        """What modes add to the rigid plant, in units of the noise."""
        omega = self.plant.omega
        rigid = with_modes(model, np.empty((0, N_MODE))).plant_response(omega)
        return float(np.linalg.norm((model.plant_response(omega) - rigid) / self.plant.std))

    def _with_one_more(self, refined: Refined, weights: Weights) -> Refined | None:
        """The better of a joint fit with one more mode within the band and one with one beyond it."""
        plant, knowledge = self.plant, self.fits.knowledge
        left = plant.value - refined.model.plant_response(plant.omega)
        extra = [remote(plant, left, refined.model.ki)]
        found = search(plant.omega, left, 1.0 / plant.std, 1, self.lowest_rad_s)
        if found:
            extra.append(modes_from(found[0], refined.model.ki))
        tried = []
        for modes in extra:
            alone = with_modes(refined.model, modes)
            alone = with_split(alone, likeliest(alone, knowledge))
            more = with_modes(refined.model, np.vstack([refined.model.modes, alone.modes]))
            tried.append(self.fits.again(more, weights))
        sound = [t for t in tried if not self._has_lone(t.model) or self._has_feet(t, refined)]
        return min(sound, key=self.fits.cost, default=None)

    def _has_lone(self, model: PlaneModel) -> bool:
        return any(is_lone(m, self.fits.data.plant.omega) for m in model.modes)

    def _has_feet(self, more: Refined, fewer: Refined) -> bool:
        """Whether a mode explains what is wrong on many lines, though none lies within its peak."""
        if self.fits.cost(more) > 0.1 * self.fits.cost(fewer):
            return False
        plant = self.plant
        off = [
            np.sum(np.abs((plant.value - t.model.plant_response(plant.omega)) / plant.std) ** 2, axis=(1, 2))
            for t in (fewer, more)
        ]
        gain = off[0] - off[1]
        return bool(gain.max() < LONE_LINE * gain.sum())

    def _needed(self, fewer: Refined, more: Refined) -> bool:
        """Whether a fit with one mode more is better beyond doubt.

        A rotor's mode is a statement and has to shorten the description of the data. One beyond the band only takes up
        what lies there: without it every figure is off by what it would have taken, so it is left out only where it may
        well be nothing. What the highest line gains by it does not count: it could take up that line's error as no mode
        within the band can. Where few blocks tell the noise, chance gains more: as much more as the squares are larger.
        """
        if self.fits.beyond(more) > self.fits.beyond(fewer):
            (without, n), (cost, _) = (self.fits.cost_before_the_end(f) for f in (fewer, more))
            return bool(n * np.log(without / cost) / more.noise.inflation > BEYOND_GAIN)
        n = len(self.fits.residual(more))
        gain = n * np.log(self.fits.cost(fewer) / self.fits.cost(more)) / more.noise.inflation
        return bool(gain > (more.fit.n_free - fewer.fit.n_free) * np.log(n) + CLEAR)

    def _pays(self, now: Refined, more: Refined) -> bool:
        """Whether one more mode is worth it: clearly better, and a mode rather than a patch on another effect.

        A mode above the band, or one without a peak, is taken only where it makes the model agree with the data.
        """
        if not self._needed(now, more):
            return False
        omega = self.fits.data.plant.omega
        return self.fits.rms(more) < ADEQUATE or (
            self.fits.cost(more) < 0.7 * self.fits.cost(now)
            and all(is_visible(m[0], m[1], omega) for m in more.model.modes)
        )


def is_lone(mode: NDArray[np.float64], omega: NDArray[np.float64]) -> bool:
    """Whether a mode within the band, or less than a line beyond it, is sharper than the lines around it can tell."""
    nu, sigma = mode[:2]
    lines = np.unique(omega)
    end = lines[-1] + (lines[-1] - lines[-2])
    return bool(nu <= end and sigma < 0.2 * nu and not tells(nu, sigma, lines))
