"""How many flexible modes: joint fits with one mode less and one more, judged by their description length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.identification.joint.counting import ADEQUATE, LOST, Counted, Counting
from service.identification.joint.finish import finished
from service.identification.joint.fits import JointFits
from service.identification.joint.refine import Refined
from service.identification.measured.data import Data
from service.identification.measured.etfe import FrequencyResponse
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Knowledge, Posterior
from service.identification.statistics.evidence import Evidence
from service.identification.steps.start import searched_starts, sharp_start

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
    before: Selected | None = None,
) -> Selected:
    """Joint fit with the number of modes that the description length supports.

    Parameters
    ----------
    start
        Plane to begin with, amplifiers fitted, modes where the measured plant has its poles.
    rigid_model
        The staged fit's; modes are looked for in what it leaves on few lines, or where ``start`` led nowhere; then also
        such as lie between lines that are too far apart to show their peaks.
    plant
        Measured plant from coil current to y, for the search of further modes.
    lowest_rad_s
        No mode is looked for below.
    before
        What was chosen for nearly the same data: where it still stands nothing is searched for once more.

    The datasheet's word, where it is asked for, counts in the last fit: modes are chosen by the data alone
    (`_without_word`).
    """
    fits = JointFits(_without_word(data), knowledge)
    counting = Counting(fits, plant, lowest_rad_s)
    if before is not None:
        place = next(k for k, e in enumerate(before.evidence) if e.chosen)
        unexplained = before.evidence[place].rms if before.refined.relative else None
        again = counting.still_standing(before.candidates, place, unexplained, start)
        if again is not None:
            explained = fits.rms(again.best) <= ADEQUATE
            return _selected(again, again.best if explained else fits.forgiving_again(before.refined), data, knowledge)
    coarse = len(plant.omega) < COARSE
    searched = searched_starts(rigid_model, plant, lowest_rad_s) if coarse else []
    found = counting.from_starts(searched or [start])
    if fits.rms(found.best) > ADEQUATE:
        found = counting.or_from(found, [start] if searched else searched_starts(rigid_model, plant, lowest_rad_s))
    if fits.rms(found.best) > ADEQUATE:
        found = counting.or_sharp(found, sharp_start(rigid_model, data.plant, plant, lowest_rad_s))
    if fits.rms(found.best) > ADEQUATE and found.from_start and _work(found.start) > WORK:
        found = counting.or_from(found, [found.start], SOFT)
    inside = fits.inside(found.start)
    if inside.layout.n_modes < found.start.layout.n_modes and fits.rms(found.best) > LOST:
        found = counting.or_from(found, [inside])
    best = found.best
    if fits.rms(best) > ADEQUATE:
        best = fits.forgiving(found.start if found.from_start else found.best.model)
    return _selected(found, best, data, knowledge)


def _selected(found: Counted, best: Refined, data: Data, knowledge: Knowledge) -> Selected:
    """The last fit from ``best``, and the evidence on the number of modes."""
    fits, numbers = JointFits(_without_word(data), knowledge), sorted(found.tried)
    evidence = tuple(
        fits.evidence("1 mode" if n == 1 else f"{n} modes", found.tried[n], n == found.number) for n in numbers
    )
    candidates = tuple(found.tried[n].model for n in numbers)
    free = JointFits(data, knowledge).free(best.model)
    return Selected(*finished(best, data, free, knowledge), evidence, candidates)


def _without_word(data: Data) -> Data:
    """The data without what the datasheet says of the rig, but for amplifiers that no logged current shows.

    Held at the datasheet's they would be wrong by their tolerances, which modes would take up or no model explain.
    """
    prior = None if data.plant.I is not None or data.prior is None else data.prior.of_amplifiers()
    return replace(data, prior=prior)


def _work(model: PlaneModel) -> float:
    """Share of a mode's stiffness that the position stiffness takes, the largest of the modes."""
    m = model.modes
    return float(np.max(m[:, 2:4] ** 2 @ model.ks / m[:, 0] ** 2, initial=0.0))
