"""Flexible modes of the datasheet at other frequencies than it states, where these explain a plant.

A frequency that was computed is often off by some per cent, and its tolerance that of a measured one. The plain twin
moves it by four tolerances at most, and no effect takes a mode to another place: what explained such a plant best was
one more mode beside it, with many values of the datasheet drawn off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Starts, Task, fit_task
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import displacement, measured_signal, weight
from service.gap.fitting.stage import EXACT, Stage
from service.gap.fitting.starts.resonances import resonances
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE
from service.gap.which.one_more_effect import rough_stages
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import FlexibleMode, Rig

Real = NDArray[np.float64]

TAKES_OFF = 0.5
"""Share of what is left of the gap that the move of one more mode must take off."""
AT_BOUND = 0.9
"""Share of the farthest that the plain twin moves a mode from which it is at its bound."""
MOVES = 4
"""Fits of a mode from where the last one left it: each moves it by four tolerances at most."""
FARTHEST = math.log(2.0)
"""Change of the logarithm of a frequency up to which it is taken for that of the same mode."""


@dataclass(frozen=True)
class MovedModes:
    """The plain twin with some modes of the datasheet at other frequencies."""

    ground: Ground
    """the part's, with that datasheet"""
    candidate: Candidate
    """the twin as fitted; it has no effect"""
    factors: Mapping[int, float] = field(default_factory=dict)
    """by mode, the factor of the frequency that the datasheet states; within its tolerance the fit has moved it on"""

    def __str__(self) -> str:
        """The modes moved: "the datasheet's mode of 470 Hz at 490 Hz"."""
        here, found = self.ground.nuisance.rig, self.candidate.fit.rig
        places = [f"{mean_hz(here, k) / by:.4g} Hz at {mean_hz(found, k):.4g} Hz" for k, by in self.factors.items()]
        return f"the datasheet's {'modes' if len(places) > 1 else 'mode'} of {' and of '.join(sorted(places))}"


def moved_modes(ground: Ground, null: Candidate) -> MovedModes | None:
    """The twin with modes moved one by one, each to where the data show it, while that takes off half of what is left.

    ``null`` is the plain twin. None where no move does so, where the datasheet knows no mode, and of other parts than
    the plant.
    """
    best, noise = MovedModes(ground, null), null.fit.n_residuals
    if ground.part.path != "plant" or null.fit.cost - noise < CLEAR_CHI_SQUARE:
        return None
    for _ in range(ground.nuisance.n_modes):
        before = best.candidate.fit.cost
        tried = [_with_one_more(best, mode) for mode in range(ground.nuisance.n_modes) if mode not in best.factors]
        found = min((m for m in tried if m is not None), key=lambda m: m.candidate.fit.cost, default=None)
        if found is None or before - found.candidate.fit.cost < TAKES_OFF * (before - noise):
            break
        best = found
    return best if best.factors else None


def _with_one_more(before: MovedModes, mode: int) -> MovedModes | None:
    """The twin with one more mode moved; None where the data show it near where it is, or not at all.

    It begins where the data show the mode, and where the twin ``before`` has it that moves it as far as it may. From
    there the twin may take it on, again and again, as lines far apart show a narrow peak a few per cent off.
    """
    nu = before.ground.nuisance
    stated_hz, tolerance = mean_hz(nu.rig, mode), float(nu.sigma[nu.names.index(f"mode{mode + 1}_frequency_x")])
    far = AT_BOUND * TOLERANCE_BOUND * tolerance
    fitted_hz, seen_hz = mean_hz(before.candidate.fit.rig, mode), _seen_hz(before.ground, mode)
    at_bound = abs(math.log(fitted_hz / stated_hz)) > far
    starts = [fitted_hz] if at_bound else []
    if seen_hz is not None and (at_bound or abs(math.log(seen_hz / stated_hz)) > far):
        starts.append(seen_hz)
    found = [m for hz in starts for m in _from(before, mode, hz / stated_hz, tolerance)]
    found = [m for m in found if far < abs(math.log(m.factors[mode])) <= FARTHEST]
    return min(found, key=lambda m: m.candidate.fit.cost, default=None)


def _from(before: MovedModes, mode: int, by: float, tolerance: float) -> list[MovedModes]:
    """The twins with one more mode moved ``by`` a factor, and from where each of them leaves it."""
    found: list[MovedModes] = []
    rig = before.ground.nuisance.rig
    for _ in range(MOVES):
        moved = _changed(rig, mode, _at_frequency(by))
        c = twin_of(before.ground, moved, before.ground.theta, (*rough_stages(before.ground), EXACT))
        if c is None:
            break
        found.append(MovedModes(with_rig(before.ground, moved), c, {**before.factors, mode: by}))
        last, by = by, mean_hz(c.fit.rig, mode) / mean_hz(rig, mode)
        if abs(math.log(by / last)) < tolerance:
            break
    return found


def _seen_hz(ground: Ground, mode: int) -> float | None:
    """Where the main sweep shows one resonance most, Hz, if the twin has all modes but this one; or None."""
    without, o = with_rig(ground, without_mode(ground.nuisance.rig, mode)), ground.observations[0]
    with suppress(AmbError, np.linalg.LinAlgError):
        rig = without.rig(ground.theta)
        z = (measured_signal(o, "y") - displacement(rig, o)[:, None]) * weight(o, "y")
        found = resonances(CATALOGUE["extra_flexible_mode"], SweepResiduals(rig, z, o, without), 1)
        return found[0]["frequency_hz"]
    return None


def twin_of(
    ground: Ground,
    rig: Rig,
    theta: Real,
    stages: tuple[Stage, ...] = (EXACT,),
    effects: tuple[str, ...] = (),
    starts: Starts = ((),),
) -> Candidate | None:
    """A twin fitted with another rig as its datasheet's, from ``theta``, (k,); None where there is none to compute."""
    with suppress(AmbError, np.linalg.LinAlgError):
        return fit_task(Task(with_rig(ground, rig), effects, starts, theta, stages))
    return None


def with_rig(ground: Ground, rig: Rig) -> Ground:
    """The ground with another rig as its datasheet's."""
    return replace(ground, nuisance=replace(ground.nuisance, rig=rig))


def without_mode(rig: Rig, mode: int) -> Rig:
    """The rig whose magnets do not excite a mode, and whose sensors do not see it."""
    return _changed(rig, mode, lambda m: replace(m, shape_at_bearings=(0.0, 0.0), shape_at_sensors=(0.0, 0.0)))


def mean_hz(rig: Rig, mode: int) -> float:
    """Frequency of a mode, Hz, the mean of the planes."""
    return float(np.mean([plane[mode].natural_frequency_rad_s for plane in rig.rotor.modes])) / (2 * math.pi)


def _at_frequency(by: float) -> Callable[[FlexibleMode], FlexibleMode]:
    return lambda m: replace(m, natural_frequency_rad_s=by * m.natural_frequency_rad_s)


def _changed(rig: Rig, mode: int, change: Callable[[FlexibleMode], FlexibleMode]) -> Rig:
    """The rig with one mode changed in every plane."""
    planes = (tuple(change(m) if k == mode else m for k, m in enumerate(plane)) for plane in rig.rotor.modes)
    return replace(rig, rotor=replace(rig.rotor, modes=tuple(planes)))
