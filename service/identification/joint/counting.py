"""Counting modes: from a start, from another start, or from what was counted in nearly the same data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.joint.fits import JointFits
from service.identification.joint.refine import Refined
from service.identification.joint.residuals import Weights
from service.identification.measured.etfe import FrequencyResponse
from service.identification.plane.layout import N_MODE
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import likeliest
from service.identification.steps.flexible import is_visible, search, shapes_of, tells
from service.identification.steps.rational import LONE_LINE
from service.identification.steps.start import modes_from, remote, with_modes, with_split

MAX_MODES = 9
ADEQUATE = 1.5
"""Residual over noise below which a model counts as agreeing with the data while modes are counted."""
LOST = 10.0
"""The same beyond which a fit is taken to have begun with the wrong modes."""
CLEAR = 10.0
"""Fall of the description length that a mode within the band has to bring."""
BEYOND_GAIN = 25.0
"""Gain of twice the log likelihood that one beyond the band has to bring: of six parameters for nothing chance has more
than that in three of ten thousand cases. With 20, which chance has in three of a thousand, one identification in a few
hundred told of a mode where none is."""
SAME = 1e-4
"""Relative difference of cost and frequencies up to which two starts led to one fit."""
MUCH_LESS = 0.5
"""Residual over noise, in units of what it was, below which a search that found no model may find one."""
EXPLAINED = 0.1
"""Of the misfit: no more than this is left where a mode without a peak that the lines show explains what is wrong."""
APART = 0.01
"""Relative difference of frequencies beyond which a pole of the data is none of a model's modes."""


@dataclass(frozen=True)
class Counted:
    """Joint fits by number of modes, and the number that the data support."""

    start: PlaneModel
    tried: dict[int, Refined]
    number: int
    first: Refined
    """From which the count began."""
    rejected: tuple[Refined, ...] = ()
    """From which others began that need more words."""

    @property
    def best(self) -> Refined:
        """The fit with that number."""
        return self.tried[self.number]

    @property
    def from_start(self) -> bool:
        """Whether the start led anywhere with all of its modes."""
        return self.first.model.layout.n_modes == self.start.layout.n_modes


@dataclass(frozen=True)
class Counting:
    """The search for the number of modes from one start or another."""

    fits: JointFits
    plant: FrequencyResponse
    lowest_rad_s: float

    def or_from(self, found: Counted, starts: list[PlaneModel], beside: float = 0.0) -> Counted:
        """What was found, or what other starts lead to, whichever describes the data in fewer words."""
        if not starts:
            return found
        first, before = self._begun(starts, beside), (found.first, *found.rejected)
        if any(self._alike(first, f) for f in before):  # and so would be what is counted from there
            return found
        other = self._counted(starts[0], first)
        if self.fits.length(other.best) < self.fits.length(found.best):
            return replace(other, rejected=before)
        return replace(found, rejected=(*found.rejected, first))

    def or_sharp(self, found: Counted, start: PlaneModel | None) -> Counted:
        """What was found, or what a start leads to that has peaks which no lines show, if there is one.

        Only where every such mode of the outcome is told without the line that gains most by it: a peak beside one line
        could take up anything that is wrong with that line.
        """
        if start is None:
            return found
        other = self.or_from(found, [start])
        best, omega = other.best, self.fits.data.plant.omega
        if best is found.best:
            return other
        lone = [k for k, m in enumerate(best.model.modes) if is_lone(m, omega)]
        if all(self._is_told_elsewhere(best, k) for k in lone):
            return other
        return replace(found, rejected=(*found.rejected, other.first))

    def from_starts(self, starts: list[PlaneModel], beside: float = 0.0) -> Counted:
        """Count from the first of the starts that leads anywhere; ``beside``: see `JointFits.begun`."""
        return self._counted(starts[0], self._begun(starts, beside))

    def _counted(self, start: PlaneModel, first: Refined) -> Counted:
        """Count from a fit, and where it began."""
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
            return Counted(start, tried, now, first)
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
        # and fewer again: what one took up for others that were not there yet may be nothing beside them
        while now > begun:
            fewer = self._without_one(tried[now], weights)
            if self._needed(fewer, tried[now]):
                break
            now -= 1
            tried[now] = fewer
        return Counted(start, tried, now, first)

    def _alike(self, one: Refined, other: Refined) -> bool:
        """Whether two starts led to the same fit."""
        a, b = one.model, other.model
        if a.layout != b.layout or not np.allclose(a.modes[:, 0], b.modes[:, 0], rtol=SAME):
            return False
        return abs(self.fits.cost(one) - self.fits.cost(other)) < SAME * self.fits.cost(other)

    def still_standing(
        self, candidates: Sequence[PlaneModel], place: int, unexplained: float | None, start: PlaneModel
    ) -> Counted | None:
        """The choice that was made for nearly the same data, fitted to these; None where these speak against it.

        One mode less or one more may now be better, also one that only the poles of these data tell of, ``start``. Or
        these data have much less that no model explains: what was searched for in the others may then be told better
        here.

        Parameters
        ----------
        candidates, place
            The joint fits of those data by rising number of modes, and which of them was chosen.
        unexplained
            Its residual over noise, where that was no model of those data.
        """
        chosen = candidates[place]
        n = chosen.layout.n_modes
        if chosen.layout.amplifier_orders != start.layout.amplifier_orders:
            return None
        first = self.fits.once_more(chosen)
        tried = {n: first}
        for fewer in candidates[max(place - 1, 0) : place]:
            tried[fewer.layout.n_modes] = self.fits.again(fewer, first.weights)
        found, rms = Counted(chosen, tried, n, first), self.fits.rms(first)
        if unexplained is not None and rms > ADEQUATE:
            return found if rms > MUCH_LESS * unexplained else None
        if rms > ADEQUATE or n == MAX_MODES:
            return None
        seen = [m for m in self.fits.inside(start).modes if np.all(np.abs(first.model.modes[:, 0] / m[0] - 1) > APART)]
        if (more := self._with_one_more(first, first.weights, seen)) is not None:
            if self._pays(first, more):
                return None
            tried[n + 1] = more
        return found if n == 0 or (n - 1 in tried and self._needed(tried[n - 1], first)) else None

    def _begun(self, starts: list[PlaneModel], beside: float) -> Refined:
        """The joint fit from the first start, or where that is lost from the others, and in the end from fewer modes.

        On coarse data several poles may stand for one peak, or one be sharper than the lines around it can tell.
        """
        found = self.fits.begun(starts[0], beside)
        if self.fits.rms(found) > LOST:
            starts = [starts[0], *self._with_a_peak_below(starts[0]), *starts[1:]]
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
        """The joint fit without the mode that the measured lines see least of, or one for two in one peak."""
        fewer = self._without(refined, self._least_seen(refined.model), weights)
        if (one := _merged(refined.model)) is None:
            return fewer
        return min(fewer, self.fits.again(one, weights), key=self.fits.cost)

    def _without(self, refined: Refined, k: int, weights: Weights) -> Refined:
        keep = np.delete(refined.model.modes, k, axis=0)
        return self.fits.again(with_modes(refined.model, keep), weights)

    def _least_seen(self, model: PlaneModel) -> int:
        return int(np.argmin([self._seen(with_modes(model, m[None, :])) for m in model.modes]))

    def _seen(self, model: PlaneModel) -> float:
        """What modes add to the rigid plant, in units of the noise."""
        omega = self.plant.omega
        rigid = with_modes(model, np.empty((0, N_MODE))).plant_response(omega)
        return float(np.linalg.norm((model.plant_response(omega) - rigid) / self.plant.std))

    def _with_one_more(self, refined: Refined, weights: Weights, seen: Sequence[Real] = ()) -> Refined | None:
        """The better of a joint fit with one more mode within the band, or one of those seen, and one beyond it."""
        plant, knowledge = self.plant, self.fits.knowledge
        left = plant.value - refined.model.plant_response(plant.omega)
        extra = [remote(plant, left, refined.model.ki)]
        found = search(plant.omega, left, 1.0 / plant.std, 1, self.lowest_rad_s)
        if found:
            extra.append(modes_from(found[0], refined.model.ki))
        extra += [mode[None, :] for mode in seen]
        if self.fits.rms(refined) > ADEQUATE:
            extra += self._peak_below(refined.model)
        tried = []
        for modes in extra:
            alone = with_modes(refined.model, modes)
            alone = with_split(alone, likeliest(alone, knowledge))
            more = with_modes(refined.model, np.vstack([refined.model.modes, alone.modes]))
            tried.append(self.fits.again(more, weights))
        sound = [t for t in tried if not self._has_lone(t.model) or self._has_feet(t, refined)]
        return min(sound, key=self.fits.cost, default=None)

    def _peak_below(self, model: PlaneModel) -> list[Real]:
        """The mode that what a model leaves calls loudest for where none is looked for otherwise, [(1, 6)] or none.

        A support is no flexible mode of the rotor, and may well resonate below the first one.
        """
        plant = self.plant
        left = plant.value - model.plant_response(plant.omega)
        found = [modes_from(f, model.ki) for f in search(plant.omega, left, 1.0 / plant.std, 1, 0.0)]
        return [m for m in found if m[0, 0] < self.lowest_rad_s and is_visible(m[0, 0], m[0, 1], plant.omega)]

    def _with_a_peak_below(self, start: PlaneModel) -> list[PlaneModel]:
        return [with_modes(start, np.vstack([start.modes, mode])) for mode in self._peak_below(start)]

    def _has_lone(self, model: PlaneModel) -> bool:
        return any(is_lone(m, self.fits.data.plant.omega) for m in model.modes)

    def _has_feet(self, more: Refined, fewer: Refined) -> bool:
        """Whether a mode explains what is wrong on many lines, though none lies within its peak."""
        if self.fits.cost(more) > EXPLAINED * self.fits.cost(fewer):
            return False
        gain = self._gain(more, fewer)
        return bool(gain.max() < LONE_LINE * gain.sum())

    def _gain(self, more: Refined, fewer: Refined) -> Real:
        """What each line of the plant gains, in squares of its noise, (F,)."""
        plant = self.plant
        off = [
            np.sum(np.abs((plant.value - t.model.plant_response(plant.omega)) / plant.std) ** 2, axis=(1, 2))
            for t in (fewer, more)
        ]
        return np.asarray(off[0] - off[1])

    def _is_told_elsewhere(self, refined: Refined, k: int) -> bool:
        """Whether a mode is needed to explain the lines without the one that gains most by it."""
        loudest = self.plant.omega[np.argmax(self._gain(refined, self._without(refined, k, refined.weights)))]
        data = self.fits.data
        rest = replace(data, plant=data.plant.select(~np.isclose(data.plant.omega, loudest, rtol=1e-6, atol=0.0)))
        there = replace(self, fits=JointFits(rest, self.fits.knowledge))
        more = there.fits.once_more(refined.model)
        fewer = there._without(more, k, more.weights)
        explained = there.fits.cost(more) < EXPLAINED * there.fits.cost(fewer)
        return there._needed(fewer, more) and (explained or there.fits.rms(more) < ADEQUATE)

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


def _merged(model: PlaneModel) -> PlaneModel | None:
    """The plane with one mode in place of two whose peaks lie within each other's width; None without such."""
    modes = model.modes[np.argsort(model.modes[:, 0])]
    for k in range(len(modes) - 1):
        pair = modes[k : k + 2]
        if pair[1, 0] - pair[0, 0] > pair[:, 1].sum():
            continue
        residues = np.einsum("ks,kb->ksb", pair[:, 4:6], pair[:, 2:4])
        bearing, sensor = shapes_of(residues.sum(axis=0), np.ones(2))
        nu, sigma = np.average(pair[:, :2], axis=0, weights=np.linalg.norm(residues, axis=(1, 2)))
        return with_modes(model, np.vstack([modes[:k], [nu, sigma, *bearing, *sensor], modes[k + 2 :]]))
    return None


def is_lone(mode: NDArray[np.float64], omega: NDArray[np.float64]) -> bool:
    """Whether a mode within the band, or less than a line beyond it, is sharper than the lines around it can tell."""
    nu, sigma = mode[:2]
    lines = np.unique(omega)
    end = lines[-1] + (lines[-1] - lines[-2])
    return bool(nu <= end and sigma < 0.2 * nu and not tells(nu, sigma, lines))
