"""Tasks to fit one more effect beside those of an explanation, from starts that its residuals suggest."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE, PROBE, Stage
from service.gap.fitting.starts.of_effect import starts
from service.gap.fitting.starts.slews import largest_rate
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.measured.observation import Observation
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

NARROW_MINIMUM = ("touchdown_contact", "thermal_drift")
"""Effects with a good start in a narrow minimum, which a rough stage would leave."""
GOOD_START = ("support_resonance", "extra_flexible_mode", "magnetic_saturation")
"""Effects with so good a start that a rough stage may leave it where its floor hides the effect.

Of saturation's laws, by the current and by the flux, such a stage would keep those whose noise it likes best: a gap of
0.2 to 0.4 % was none of the catalogue's so."""


def residuals(ground: Ground, candidate: Candidate) -> tuple[Complex, ...]:
    """Weighted residuals of an explanation of a part, (P, H, n) per sweep."""
    return tuple(Problem.of(ground, candidate.fit).residuals(candidate.fit))


def task_beside(
    name: str,
    first: Candidate,
    null: Candidate,
    left: Sequence[Complex],
    ground: Ground,
    theta: Real,
    rough: tuple[Stage, ...],
) -> Task:
    """Task to fit the effect ``name`` beside those of ``first``, whose residuals are ``left``.

    It starts from the nuisance vector ``theta``; ``rough`` are the rough stages for effects with a good start.
    """
    effect_starts, effects = partial(_starts, first, name, tuple(left), ground), (*first.effects, name)
    frozen = first if any(slow_to_compute(e) for e in first.effects) else None
    if name in NARROW_MINIMUM:
        return Task(ground, effects, effect_starts, first.fit.theta, (PROBE,), frozen, null.occam)
    # Without rough stages a probe would end far from the minimum; only the plant is costly enough to be probed first.
    last = PROBE if ground.part.path == "plant" else EXACT
    good = name in GOOD_START
    stages = (*(rough if good else rough_stages(ground)), last)
    return Task(ground, effects, effect_starts, theta, stages, frozen, null.occam, good_start=good)


def _starts(
    first: Candidate, name: str, left: Sequence[Complex], ground: Ground
) -> tuple[tuple[dict[str, float], ...], ...]:
    """Starts of an effect beside those of ``first``; of a nonlinear one from the sweep that excites it most."""
    sweeps = range(len(ground.observations))
    k = max(sweeps, key=lambda k: _excitation(name, ground.observations[k])) if CATALOGUE[name].nonlinear else 0
    unexplained = SweepResiduals(first.fit.rig, left[k], ground.observations[k], ground)
    return tuple((*first.fit.values, s) for s in starts(CATALOGUE[name], unexplained))


def _excitation(name: str, o: Observation) -> float:
    """How much a sweep excites a nonlinear effect: the slope of the current, A/s, or the displacement, m."""
    return largest_rate(o) if CATALOGUE[name].path == "amplifier" else float(np.abs(o.Y).max())


def rough_stages(ground: Ground) -> tuple[Stage, ...]:
    """Rough stages of a fit: only the plant has resonances that need them."""
    return (COARSE, MIDDLE) if ground.part.path == "plant" else ()


def rough_beside(first: Candidate, ground: Ground) -> tuple[Stage, ...]:
    """Rough stages of a fit beside ``first`` from a good start: those whose floor its residuals exceed.

    To the others all residuals are noise, and they would move a good start of a faint effect anywhere.
    """
    problem = Problem.of(ground, first.fit)
    return tuple(stage for stage in rough_stages(ground) if not problem.within_floor(first.fit, stage))
