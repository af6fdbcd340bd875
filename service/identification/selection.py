"""How many flexible modes: joint fits with one mode less and one more, judged by their description length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.etfe import FrequencyResponse
from service.identification.evidence import Evidence, leave_one_out
from service.identification.finish import finished
from service.identification.flexible import is_visible, search, tells
from service.identification.plane_model import N_MODE, PlaneModel
from service.identification.rational import LONE_LINE
from service.identification.refine import NEAR, Data, Refined, Weights, refine, residuals
from service.identification.split import Knowledge, Posterior, knowledge_rows, likeliest
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
MOSTLY = 0.5
"""Of a model's relative error: what is left where modes beyond the band explain most of it."""
COARSE = 60
"""Lines fewer than which leave it to chance what the poles and residues of a plant stand for."""
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
        The staged fit's, where modes are looked for in what it leaves: on few lines, or where ``start`` led nowhere.
    plant
        Measured plant from coil current to y, for the search of further modes.
    lowest_rad_s
        No mode is looked for below.

    The datasheet's word, where it is asked for, counts in the last fit: modes are chosen by the data alone.
    """
    alone = replace(data, prior=None)
    tried, now = _counted([start], alone, plant, lowest_rad_s, knowledge, 0.0)
    if _rms(tried[now], alone) > ADEQUATE or len(plant.omega) < COARSE:
        searched = searched_starts(rigid_model, plant, lowest_rad_s)
        if searched:
            other, then = _counted(searched, alone, plant, lowest_rad_s, knowledge, 0.0)
            if _score(other[then], alone) < _score(tried[now], alone):
                start, tried, now = searched[0], other, then
    if _rms(tried[now], alone) > ADEQUATE and _work(start) > WORK:
        other, then = _counted([start], alone, plant, lowest_rad_s, knowledge, SOFT)
        if _score(other[then], alone) < _score(tried[now], alone):
            tried, now = other, then
    inside = _inside(start, alone)
    if inside.layout.n_modes < start.layout.n_modes and _rms(tried[now], alone) > LOST:
        other, then = _counted([inside], alone, plant, lowest_rad_s, knowledge, 0.0)
        if _score(other[then], alone) < _score(tried[now], alone):
            tried, now = other, then
    evidence = tuple(
        Evidence(
            f"{n} modes" if n != 1 else "1 mode",
            r.fit.n_free,
            _n_data(r, alone),
            _data_cost(r, alone),
            n == now,
            r.fit.status,
            _left_out(r, alone, knowledge),
        )
        for n, r in sorted(tried.items())
    )
    candidates = tuple(r.model for _, r in sorted(tried.items()))
    best = tried[now]
    if _rms(best, alone) > ADEQUATE:
        best = _forgiving_start(with_split(start, likeliest(start, knowledge)), alone, knowledge)
    return Selected(*finished(best, data, _free(best.model, data), knowledge), evidence, candidates)


def _counted(
    starts: list[PlaneModel], data: Data, plant: FrequencyResponse, lowest: float, knowledge: Knowledge, beside: float
) -> tuple[dict[int, Refined], int]:
    """Joint fits by number of modes, and the number that the data support; ``beside``: see `_joint`."""
    first = _begun(starts, data, plant, knowledge, beside)
    weights, now = first.weights, first.model.layout.n_modes
    begun = now
    tried: dict[int, Refined] = {now: first}
    # fewer: leave out the mode that matters least, while that is no loss
    while now > 0:
        tried[now - 1] = _without_one(tried[now], data, plant, weights, knowledge)
        if _needed(tried[now - 1], tried[now], data):
            break
        now -= 1
    if now != begun and _rms(tried[now], data) < LOST:
        return tried, now
    # more: while it pays, looking one further when a mode helps much but not enough
    at = now
    while at < MAX_MODES:
        more = _with_one_more(tried[at], data, plant, weights, lowest, knowledge)
        if more is None:
            break
        at += 1
        tried[at] = more
        if _pays(tried[now], more, data):
            now = at
        elif at - now > 1 or _data_cost(more, data) > 0.5 * _data_cost(tried[now], data):
            break
    return tried, now


def _begun(
    starts: list[PlaneModel], data: Data, plant: FrequencyResponse, knowledge: Knowledge, beside: float
) -> Refined:
    """The joint fit from the first start, or where that is lost from the others, and in the end from fewer modes.

    On coarse data several poles may stand for one peak, or one be sharper than the lines around it can tell.
    """
    found = _joint(starts[0], data, knowledge, beside)
    for start in starts[1:]:
        found = _better(found, start, data, knowledge, beside)
    start = starts[0]
    while start.layout.n_modes > 1 and _rms(found, data) > LOST:
        start = with_modes(start, np.delete(start.modes, _least_seen(start, plant), axis=0))
        found = _better(found, start, data, knowledge, beside)
    return found


def _better(found: Refined, start: PlaneModel, data: Data, knowledge: Knowledge, beside: float) -> Refined:
    """A lost fit, or the one from another start where that halves the misfit."""
    if _rms(found, data) < LOST:
        return found
    other = _joint(start, data, knowledge, beside)
    return other if _data_cost(other, data) < 0.5 * _data_cost(found, data) else found


def _work(model: PlaneModel) -> float:
    """Share of a mode's stiffness that the position stiffness takes, the largest of the modes."""
    m = model.modes
    return float(np.max(m[:, 2:4] ** 2 @ model.ks / m[:, 0] ** 2, initial=0.0))


def _forgiving_start(model: PlaneModel, data: Data, knowledge: Knowledge) -> Refined:
    """`_forgiving` without modes beyond the band, which take up what is wrong, unless they explain most of it."""
    inside = _inside(model, data)
    best = _forgiving(inside, data, knowledge)
    if inside.layout.n_modes == model.layout.n_modes:
        return best
    more = _forgiving(model, data, knowledge)
    return more if more.relative < MOSTLY * best.relative else best


def _inside(model: PlaneModel, data: Data) -> PlaneModel:
    """The same plane without modes beyond the band."""
    return with_modes(model, model.modes[model.modes[:, 0] <= data.plant.omega.max()])


def _forgiving(model: PlaneModel, data: Data, knowledge: Knowledge) -> Refined:
    """Joint fit for a model that cannot agree with the data: its error counts as a relative one beside the noise.

    Weighted by noise alone such a fit would follow the loudest lines wherever their error leads. The size of the
    relative error is what makes the residuals fit it.
    """
    level = 0.03
    found = _held(model, data, knowledge, relative=level)
    for _ in range(3):
        r, _ = residuals(found.model, data, found.weights, found.amplitude, gradient=False)
        level = float(np.clip(level * np.sqrt(r @ r / len(r)), 1e-4, 0.3))
        found = _held(found.model, data, knowledge, relative=level)
    return found


def _held(model: PlaneModel, data: Data, knowledge: Knowledge, relative: float) -> Refined:
    return refine(model, data, _free(model, data), relative=relative, split=knowledge, reach=NEAR)


def _free(model: PlaneModel, data: Data) -> NDArray[np.bool_]:
    """What a joint fit moves: without currents, amplifiers and delay stay as the datasheet has them."""
    free = model.layout.free()
    if data.plant.I is None:
        free[model.layout.delay] = False
        for place in model.layout.amplifiers:
            free[place] = False
    return free


def _joint(model: PlaneModel, data: Data, knowledge: Knowledge, beside: float) -> Refined:
    """Forgiving first, then in units of the noise, from splits so much beside the likeliest ones."""
    free = _free(model, data)
    model = with_split(model, likeliest(model, knowledge) + beside)
    # step 3 has the amplifiers: they wait until the rest has found its place
    plant = free.copy()
    for place in model.layout.amplifiers:
        plant[place] = False
    rough = refine(model, data, plant, relative=0.03, nonlinear=False, split=knowledge, max_iterations=40)
    better = refine(rough.model, data, plant, relative=0.003, nonlinear=True, split=knowledge, reach=NEAR)
    return refine(better.model, data, free, split=knowledge, reach=NEAR)


def _without_one(
    refined: Refined, data: Data, plant: FrequencyResponse, weights: Weights, knowledge: Knowledge
) -> Refined:
    """The joint fit without the mode that the measured lines see least of."""
    keep = np.delete(refined.model.modes, _least_seen(refined.model, plant), axis=0)
    return _again(with_modes(refined.model, keep), data, weights, knowledge)


def _least_seen(model: PlaneModel, plant: FrequencyResponse) -> int:
    return int(np.argmin([_seen(with_modes(model, m[None, :]), plant) for m in model.modes]))


def _seen(model: PlaneModel, plant: FrequencyResponse) -> float:
    """What modes add to the rigid plant, in units of the noise."""
    rigid = with_modes(model, np.empty((0, N_MODE))).plant_response(plant.omega)
    return float(np.linalg.norm((model.plant_response(plant.omega) - rigid) / plant.std))


def _with_one_more(
    refined: Refined,
    data: Data,
    plant: FrequencyResponse,
    weights: Weights,
    lowest: float,
    knowledge: Knowledge,
) -> Refined | None:
    """The better of a joint fit with one more mode within the band and one with one beyond it."""
    left = plant.value - refined.model.plant_response(plant.omega)
    extra = [remote(plant, left, refined.model.ki)]
    found = search(plant.omega, left, 1.0 / plant.std, 1, lowest)
    if found:
        extra.append(modes_from(found[0], refined.model.ki))
    tried = []
    for modes in extra:
        alone = with_modes(refined.model, modes)
        alone = with_split(alone, likeliest(alone, knowledge))
        more = with_modes(refined.model, np.vstack([refined.model.modes, alone.modes]))
        tried.append(_again(more, data, weights, knowledge))
    sound = [t for t in tried if not any(is_lone(m, data) for m in t.model.modes) or _has_feet(t, refined, data, plant)]
    return min(sound, key=lambda t: _data_cost(t, data), default=None)


def _has_feet(more: Refined, fewer: Refined, data: Data, plant: FrequencyResponse) -> bool:
    """Whether a mode explains what is wrong on many lines, though none lies within its peak."""
    if _data_cost(more, data) > 0.1 * _data_cost(fewer, data):
        return False
    off = [
        np.sum(np.abs((plant.value - t.model.plant_response(plant.omega)) / plant.std) ** 2, axis=(1, 2))
        for t in (fewer, more)
    ]
    gain = off[0] - off[1]
    return bool(gain.max() < LONE_LINE * gain.sum())


def _again(model: PlaneModel, data: Data, weights: Weights, knowledge: Knowledge) -> Refined:
    return refine(model, data, _free(model, data), split=knowledge, weights=weights, reach=NEAR)


def _data_cost(refined: Refined, data: Data) -> float:
    r, _ = residuals(refined.model, data, refined.weights, refined.amplitude, gradient=False)
    return float(r @ r)


def _left_out(refined: Refined, data: Data, knowledge: Knowledge) -> float:
    r, jacobian = residuals(refined.model, data, refined.weights, refined.amplitude)
    assert jacobian is not None
    held, slope = knowledge_rows(refined.model, knowledge)
    whole = np.vstack([jacobian, slope])[:, refined.fit.free]
    # what is known of splits is not left out: it only shares the leverage
    padded = leave_one_out(np.concatenate([r, np.zeros(len(held))]), whole)
    return padded * float(np.sqrt((len(r) + len(held)) / len(r)))


def _n_data(refined: Refined, data: Data) -> int:
    return len(residuals(refined.model, data, refined.weights, refined.amplitude, gradient=False)[0])


def _score(refined: Refined, data: Data) -> float:
    return Evidence("", refined.fit.n_free, _n_data(refined, data), _data_cost(refined, data)).mdl


def _needed(fewer: Refined, more: Refined, data: Data) -> bool:
    """Whether a fit with one mode more is better beyond doubt.

    A rotor's mode is a statement and has to shorten the description of the data. One beyond the band only takes up
    what lies there: without it every figure is off by what it would have taken, so it is left out only where it may
    well be nothing. Where few blocks tell the noise, chance gains more: as much more as the squares are larger.
    """
    n = _n_data(more, data)
    gain = n * np.log(_data_cost(fewer, data) / _data_cost(more, data)) / more.noise.inflation
    if _beyond(more, data) > _beyond(fewer, data):
        return bool(gain > BEYOND_GAIN)
    return bool(gain > (more.fit.n_free - fewer.fit.n_free) * np.log(n) + CLEAR)


def _beyond(refined: Refined, data: Data) -> int:
    return int(np.sum(refined.model.modes[:, 0] > data.plant.omega.max()))


def _pays(now: Refined, more: Refined, data: Data) -> bool:
    """Whether one more mode is worth it: clearly better, and a mode rather than a patch on another effect.

    A mode above the band, or one without a peak, is taken only where it makes the model agree with the data.
    """
    if not _needed(now, more, data):
        return False
    return _rms(more, data) < ADEQUATE or (
        _data_cost(more, data) < 0.7 * _data_cost(now, data) and all_visible(more.model, data)
    )


def all_visible(model: PlaneModel, data: Data) -> bool:
    """Whether every mode has a peak that the measured lines can show."""
    return all(is_visible(m[0], m[1], data.plant.omega) for m in model.modes)


def is_lone(mode: NDArray[np.float64], data: Data) -> bool:
    """Whether a mode within the band, or less than a line beyond it, is sharper than the lines around it can tell."""
    nu, sigma = mode[:2]
    lines = np.unique(data.plant.omega)
    end = lines[-1] + (lines[-1] - lines[-2])
    return bool(nu <= end and sigma < 0.2 * nu and not tells(nu, sigma, lines))


def _rms(refined: Refined, data: Data) -> float:
    return float(np.sqrt(_data_cost(refined, data) / _n_data(refined, data)))
