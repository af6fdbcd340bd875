"""How many flexible modes: joint fits with one mode less and one more, judged by their description length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.etfe import FrequencyResponse
from service.identification.evidence import Evidence, leave_one_out
from service.identification.flexible import PoleResidue, search, shapes_of
from service.identification.plane_model import MODE_NAMES, N_MODE, Layout, PlaneModel
from service.identification.refine import Data, Refined, Weights, refine, residuals
from service.identification.split import (
    LOOSE,
    Knowledge,
    Posterior,
    Split,
    held_at_start,
    log_ratios,
    posterior,
    split_rows,
)
from service.identification.zoh import Real

MAX_MODES = 6
SPLIT_ROUNDS = 6
ADEQUATE = 1.5
"""Residual over noise below which a model counts as agreeing with the data while modes are counted."""

LOST = 10.0
"""The same beyond which a fit is taken to have begun with the wrong modes."""


@dataclass(frozen=True)
class Selected:
    """The joint fit with the number of modes that the data support."""

    refined: Refined
    splits: Posterior | None
    """What is known of the shapes' splits; None without modes."""
    evidence: tuple[Evidence, ...]
    candidates: tuple[PlaneModel, ...] = ()
    """The joint fits that the evidence is of."""


def with_modes(model: PlaneModel, modes: Real) -> PlaneModel:
    """The same plane with other modes, (n, 6) in the order of `MODE_NAMES`, ascending."""
    modes = np.asarray(modes, dtype=float).reshape(-1, N_MODE)
    modes = modes[np.argsort(modes[:, 0])]
    layout = Layout(model.layout.amplifier_orders, len(modes))
    start = model.layout.delay + 1
    theta = np.concatenate([model.theta[:start], modes.ravel(), model.theta[model.layout.extended]])
    return replace(model, layout=layout, theta=theta)


def modes_from(search_result: PoleResidue, ki: Real) -> Real:
    """Start of the modes' parameters from a pole-residue model of the plant, (n, 6)."""
    rows = []
    for nu, sigma, residue in zip(
        search_result.nu_rad_s, search_result.sigma_rad_s, search_result.residues, strict=True
    ):
        bearing, sensor = shapes_of(residue, ki)
        rows.append([nu, sigma, *bearing, *sensor])
    return np.array(rows).reshape(-1, len(MODE_NAMES))


def coarse_number(models: list[PoleResidue], left: FrequencyResponse, weight: Real, floor: float) -> tuple[int, Real]:
    """Number of modes that a pole-residue model needs to come down to a relative misfit ``floor``, and the misfits.

    The joint fit decides; this only says where to start.
    """
    n = 2 * left.value.size
    cost = [float(np.sum(np.abs(left.value * weight) ** 2))]
    cost += [float(np.sum(np.abs((left.value - m.response(left.omega)) * weight) ** 2)) for m in models]
    level = 4 * len(left.omega) * floor**2
    score = [n * np.log(c + level) + 10 * k * np.log(n) for k, c in enumerate(cost)]
    return int(np.argmin(score)), np.array(cost)


def choose_modes(
    start: PlaneModel,
    data: Data,
    plant: FrequencyResponse,
    coarse: list[PoleResidue],
    n_start: int,
    lowest_rad_s: float,
    knowledge: Knowledge,
) -> Selected:
    """Joint fit with the number of modes that the description length supports.

    Parameters
    ----------
    start
        Rigid plane with amplifiers fitted.
    plant
        Measured plant from coil current to y, for the search of further modes.
    coarse, n_start
        Pole-residue models with 1, 2, ... modes, and which number to begin with.
    lowest_rad_s
        No mode is looked for below.

    The datasheet's word, where it is asked for, counts in the last fit: modes are chosen by the data alone.
    """
    asked, data = data, replace(data, prior=None)
    modes, first = _begun(start, data, coarse[:n_start], knowledge)
    n_start = len(modes)
    weights = first.weights
    tried: dict[int, Refined] = {n_start: first}
    # fewer: leave out the mode that matters least, while that is no loss
    now = n_start
    while now > 0:
        tried[now - 1] = _without_one(tried[now], data, weights, knowledge)
        if _score(tried[now - 1], data) > _score(tried[now], data) + 10.0:
            break
        now -= 1
    # more: while it pays, looking one further when a mode helps much but not enough
    if now == n_start:
        at = now
        while at < MAX_MODES:
            more = _with_one_more(tried[at], data, plant, weights, lowest_rad_s, knowledge)
            if more is None:
                break
            at += 1
            tried[at] = more
            if _pays(tried[now], more, data):
                now = at
            elif at - now > 1 or _data_cost(more, data) > 0.5 * _data_cost(tried[now], data):
                break
    evidence = tuple(
        Evidence(
            f"{n} modes" if n != 1 else "1 mode",
            r.fit.n_free,
            _n_data(r, data),
            _data_cost(r, data),
            n == now,
            r.fit.status,
            _left_out(r, data),
        )
        for n, r in sorted(tried.items())
    )
    candidates = tuple(r.model for _, r in sorted(tried.items()))
    if _rms(tried[now], data) > ADEQUATE:
        wrong = _forgiving(with_modes(start, modes), data, knowledge)
        return Selected(*_finished(wrong, asked, knowledge), evidence, candidates)
    return Selected(*_finished(tried[now], asked, knowledge), evidence, candidates)


def _begun(start: PlaneModel, data: Data, coarse: list[PoleResidue], knowledge: Knowledge) -> tuple[Real, Refined]:
    """The modes to begin with and the joint fit from them.

    On coarse data the search takes one peak for several, and another has too few lines to be believed. Then the fit
    is lost, and the searches with fewer poles are believed instead, all of them.
    """
    modes = modes_from(coarse[-1], start.ki) if coarse else np.empty((0, N_MODE))
    modes = modes[[is_visible(m[0], m[1], data.plant.omega) for m in modes]]
    found = _joint(with_modes(start, modes), data, knowledge)
    for fewer in reversed(coarse[:-1]):
        if _rms(found, data) < LOST:
            break
        others = modes_from(fewer, start.ki)
        other = _joint(with_modes(start, others), data, knowledge)
        if _data_cost(other, data) < 0.5 * _data_cost(found, data):
            modes, found = others, other
    return modes, found


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
    return refine(model, data, _free(model, data), relative=relative, split=held_at_start(model, knowledge))


def _finished(refined: Refined, data: Data, knowledge: Knowledge) -> tuple[Refined, Posterior | None]:
    """Joint fit with the splits at the mean of what is known of them, and that knowledge."""
    n_modes = refined.model.layout.n_modes
    if n_modes == 0:
        if data.prior is None:
            return refined, None
        free = _free(refined.model, data)
        told = refine(refined.model, data, free, relative=refined.relative, weights=refined.weights)
        return replace(told, noise=refined.noise), None
    now, ratios = refined, log_ratios(refined.model)
    known = Posterior(ratios, np.eye(n_modes))
    for _ in range(SPLIT_ROUNDS):
        # what the data say of a split is linear near the fit only, so it is read where the fit is held
        r, jacobian = now.fit.residual[:-n_modes], now.fit.jacobian[:-n_modes]
        known = posterior(now.model, r, jacobian, now.fit.free, knowledge, use_data=refined.relative == 0)
        spread = np.sqrt(np.diag(known.covariance))
        moved = float(np.max(np.abs(known.log_ratios - ratios) / np.maximum(spread, 1e-3)))
        ratios = known.log_ratios
        now = refine(
            with_split(now.model, ratios),
            data,
            _free(refined.model, data),
            relative=refined.relative,
            split=Split(ratios),
            weights=refined.weights,
        )
        if moved < 0.3:
            break
    return replace(now, noise=refined.noise, relative=refined.relative), known


def with_split(model: PlaneModel, ratios: Real) -> PlaneModel:
    """The same plane with each mode's shape split as told, ln(|phi_s|/|phi_b|)."""
    modes = model.modes.copy()
    factor = np.exp(0.5 * (ratios - log_ratios(model)))[:, None]
    modes[:, 2:4] /= factor
    modes[:, 4:6] *= factor
    return with_modes(model, modes)


def _free(model: PlaneModel, data: Data) -> NDArray[np.bool_]:
    """What a joint fit moves: without currents, amplifiers and delay stay as the datasheet has them."""
    free = model.layout.free()
    if data.plant.I is None:
        free[model.layout.delay] = False
        for place in model.layout.amplifiers:
            free[place] = False
    return free


def _joint(model: PlaneModel, data: Data, knowledge: Knowledge) -> Refined:
    """Forgiving first, then in units of the noise."""
    free = _free(model, data)
    split = held_at_start(model, knowledge)
    model = with_split(model, split.log_ratios)
    # step 3 has the amplifiers: they wait until the rest has found its place
    plant = free.copy()
    for place in model.layout.amplifiers:
        plant[place] = False
    rough = refine(model, data, plant, relative=0.03, nonlinear=False, split=split, max_iterations=40)
    better = refine(rough.model, data, plant, relative=0.003, nonlinear=True, split=split)
    return refine(better.model, data, free, split=split)


def _without_one(refined: Refined, data: Data, weights: Weights, knowledge: Knowledge) -> Refined:
    modes = refined.model.modes
    strength = [np.linalg.norm(m[2:4]) * np.linalg.norm(m[4:6]) / (2 * abs(m[1]) * m[0] + 1e-12) for m in modes]
    keep = np.delete(modes, int(np.argmin(strength)), axis=0)
    return _again(with_modes(refined.model, keep), data, weights, knowledge)


def _with_one_more(
    refined: Refined,
    data: Data,
    plant: FrequencyResponse,
    weights: Weights,
    lowest: float,
    knowledge: Knowledge,
) -> Refined | None:
    left = plant.value - refined.model.plant_response(plant.omega)
    found = search(plant.omega, left, 1.0 / plant.std, 1, lowest)
    if not found:
        return None
    extra = modes_from(found[0], refined.model.ki)
    return _again(with_modes(refined.model, np.vstack([refined.model.modes, extra])), data, weights, knowledge)


def _again(model: PlaneModel, data: Data, weights: Weights, knowledge: Knowledge) -> Refined:
    return refine(
        model, data, _free(model, data), split=held_at_start(model, knowledge), weights=weights, max_iterations=25
    )


def _data_cost(refined: Refined, data: Data) -> float:
    r, _ = residuals(refined.model, data, refined.weights, refined.amplitude, gradient=False)
    return float(r @ r)


def _left_out(refined: Refined, data: Data) -> float:
    r, jacobian = residuals(refined.model, data, refined.weights, refined.amplitude)
    assert jacobian is not None
    held, slope = split_rows(refined.model, Split(log_ratios(refined.model), LOOSE))
    whole = np.vstack([jacobian, slope])[:, refined.fit.free]
    # the rows that hold splits are at rest and not left out: they only share the leverage
    padded = leave_one_out(np.concatenate([r, np.zeros(len(held))]), whole)
    return padded * float(np.sqrt((len(r) + len(held)) / len(r)))


def _n_data(refined: Refined, data: Data) -> int:
    return len(residuals(refined.model, data, refined.weights, refined.amplitude, gradient=False)[0])


def _score(refined: Refined, data: Data) -> float:
    return Evidence("", refined.fit.n_free, _n_data(refined, data), _data_cost(refined, data)).mdl


def _pays(now: Refined, more: Refined, data: Data) -> bool:
    """Whether one more mode is worth it: clearly better, and a mode rather than a patch on another effect.

    A mode above the band, one without a peak, or one that lies between two lines and rings for longer than they can
    tell, is taken only where it makes the model agree with the data.
    """
    if _score(more, data) > _score(now, data) - 10.0:
        return False
    return _rms(more, data) < ADEQUATE or (
        _data_cost(more, data) < 0.7 * _data_cost(now, data) and all_visible(more.model, data)
    )


def all_visible(model: PlaneModel, data: Data) -> bool:
    """Whether every mode has a peak that the measured lines can show."""
    return all(is_visible(m[0], m[1], data.plant.omega) for m in model.modes)


def is_visible(nu_rad_s: float, sigma_rad_s: float, omega: Real) -> bool:
    """Whether a pole is a peak within the band, wide enough for the lines around it to tell."""
    near = float(np.sort(np.abs(np.unique(omega) - nu_rad_s))[:2].mean())
    in_band = nu_rad_s <= omega.max()
    return bool(in_band and 1e-5 * nu_rad_s < sigma_rad_s < 0.2 * nu_rad_s and sigma_rad_s > 0.02 * near)


def _rms(refined: Refined, data: Data) -> float:
    return float(np.sqrt(_data_cost(refined, data) / _n_data(refined, data)))
