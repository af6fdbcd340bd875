"""Fits begun: one more effect beside those of an explanation, from where the data say that it may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE, PROBE, Stage
from service.gap.fitting.starts.left import Left
from service.gap.fitting.starts.of_effect import starts
from service.gap.fitting.starts.slews import largest_rate
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.measured.observation import Observation
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

SHARP = ("touchdown_contact", "thermal_drift")
"""Effects whose start is good and whose valley is narrow: a rough fit would lose it."""
LOOKED_FOR = ("support_resonance", "extra_flexible_mode")
"""Effects whose start the data give so well that a rough fit may lose it where it hardly sees the effect."""


def residuals(ground: Ground, candidate: Candidate) -> tuple[Complex, ...]:
    """What an explanation leaves of a part, weighted, (P, H, n) per sweep."""
    return tuple(Problem.of(ground, candidate.fit).residuals(candidate.fit))


def beside(
    name: str,
    first: Candidate,
    null: Candidate,
    left: Sequence[Complex],
    ground: Ground,
    theta: Real,
    rough: tuple[Stage, ...],
) -> Task:
    """Task to fit one more effect beside those of ``first``, which leaves ``left``, from deviations ``theta``.

    ``rough`` are the stages from a good start.
    """
    beginnings, effects = _starts(first, name, left, ground), (*first.effects, name)
    held = first if any(slow_to_compute(e) for e in first.effects) else None
    if name in SHARP:
        return Task(ground, effects, beginnings, first.fit.theta, (PROBE,), held, null.occam)
    # Without rough stages a probe would end far from the valley; the plant alone is costly.
    last = PROBE if ground.part.path == "plant" else EXACT
    first_stages = rough if name in LOOKED_FOR else rough_stages(ground)
    return Task(ground, effects, beginnings, theta, (*first_stages, last), held, null.occam)


def _starts(
    first: Candidate, name: str, left: Sequence[Complex], ground: Ground
) -> tuple[tuple[dict[str, float], ...], ...]:
    """Starts of an effect beside those of ``first``; a nonlinear one's found in the sweep that drives it most."""
    sweeps = range(len(ground.observations))
    k = max(sweeps, key=lambda k: _driven(name, ground.observations[k])) if CATALOGUE[name].nonlinear else 0
    unexplained = Left(first.fit.rig, left[k], ground.observations[k], ground)
    return tuple((*first.fit.values, s) for s in starts(CATALOGUE[name], unexplained))


def _driven(name: str, o: Observation) -> float:
    """How far a sweep drives a nonlinear effect: by the rate of the current, A/s, or by the rotor's motion, m."""
    return largest_rate(o) if CATALOGUE[name].path == "amplifier" else float(np.abs(o.Y).max())


def rough_stages(ground: Ground) -> tuple[Stage, ...]:
    """First stages of a fit: only the plant has resonances that need them."""
    return (COARSE, MIDDLE) if ground.part.path == "plant" else ()


def rough_beside(first: Candidate, ground: Ground) -> tuple[Stage, ...]:
    """First stages of a fit beside ``first`` from a good start: those within whose floor that is not yet.

    To the others all that is left is noise: they would lead a good start of a faint effect anywhere.
    """
    problem = Problem.of(ground, first.fit)
    return tuple(stage for stage in rough_stages(ground) if not problem.within_floor(first.fit, stage))
