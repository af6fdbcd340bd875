"""Whether the log itself is at fault: a signal that the loop saw otherwise than it was written down.

Such a log makes gaps in two parts of the loop at once, and two effects that are not there could explain them. One
cause is simpler: with that signal worked out from the others, the plain twin explains the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE
from service.gap.measured.observation import Observation
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE, noise_levels
from service.gap.weighing.significance import SIGNIFICANT
from service.gap.which.explained import Explained, gap_significance
from sim import control_law

Complex = NDArray[np.complex128]

CURED = 0.1
"""Share of the plant's excess that may be left once the signal is worked out."""
DISPLACEMENT = "the logged displacement is not the one that the controller used"


def log_fault(
    fitter: Fitter,
    before: Sequence[Explained],
    ground: Ground,
    plain: tuple[Candidate, tuple[Complex, ...]],
    logged: Sequence[Observation],
) -> str | None:
    """What is wrong with the log, in words, or None.

    Parameters
    ----------
    before
        The parts ahead of the plant, as effects explain them.
    ground, plain
        The plant's, and its plain twin with what that leaves.
    logged
        The plant's observations as logged: of those before, fewer sweeps may have been fitted.
    """
    gap = {e.part.path: e for e in before if e.significance > SIGNIFICANT}
    if not gap or gap_significance(plain[1], ground.observations) <= SIGNIFICANT:
        return None
    if "controller" in gap and "logging_offset" not in gap["controller"].order[0].candidate.effects:
        worked_out, as_uncertain = _worked_out(ground)
        if _plain_excess(fitter, worked_out) < CURED * _plain_excess(fitter, as_uncertain):
            return DISPLACEMENT
    if "amplifier" in gap:
        driven = gap["amplifier"].ground
        silent = tuple(replace(o, I=None) for o in logged)
        through = next(part for part in parts(driven.nuisance, silent) if part.from_control)
        silent_ground = Ground(driven.nuisance, through, silent, driven.theta, driven.found)
        # Amplifiers within a wide datasheet may make up for a lag of the plant: then it is no cure to leave them alone.
        c = gap["amplifier"].order[0].candidate
        found = (*driven.found, *zip(c.effects, c.fit.values, strict=True))
        cured, believed = (_plain_excess(fitter, g) for g in (silent_ground, replace(silent_ground, found=found)))
        if cured < CURED * min(_excess(plain[0].fit), believed):
            return "the logged coil current is not the one that moves the rotor"
    return None


def faint_log_fault(fitter: Fitter, before: Sequence[Explained], plant: Explained, best: Candidate) -> str | None:
    """The same where the plant's gap is so faint that only an effect, ``best``, shows that there is one; or None.

    Noise is estimated, and where it is overestimated a faint gap leaves no excess over the number of values. What the
    effect leaves, where that is less, is then the measure for the plain twin with the displacement worked out.
    """
    controller = next((e for e in before if e.part.path == "controller" and e.significance > SIGNIFICANT), None)
    if controller is None or not best.effects or "logging_offset" in controller.order[0].candidate.effects:
        return None
    worked_out, as_uncertain = _worked_out(plant.ground)
    told = Task(as_uncertain, best.effects, (best.fit.values,), best.fit.theta, (MIDDLE, EXACT))
    cured, plain, explained = fitter.each([_plain(worked_out), _plain(as_uncertain), told])
    if cured is None or plain is None or explained is None:
        return None
    noise = noise_levels(plain, [cured, explained])
    left, gap = (_excess(c.fit, noise) for c in (cured, plain))
    return DISPLACEMENT if gap > CLEAR_CHI_SQUARE and left < CURED * gap else None


def _worked_out(ground: Ground) -> tuple[Ground, Ground]:
    """The plant with the displacement that the controller betrays, and with the logged one made as uncertain.

    Worked out, the displacement is less certain; a gap that only that hides is not cured.
    """
    worked_out = tuple(as_the_controller_saw(ground, o) for o in ground.observations)
    as_uncertain = tuple(replace(o, sd_y=w.sd_y) for o, w in zip(ground.observations, worked_out, strict=True))
    return replace(ground, observations=worked_out), replace(ground, observations=as_uncertain)


def as_the_controller_saw(ground: Ground, o: Observation) -> Observation:
    """The observation with the displacement that the output of the datasheet's controller betrays, y = (r - u) / C.

    The mean is left as logged.
    """
    law, Y, sd_y = ground.nuisance.rig.controller, o.Y.copy(), o.sd_y.copy()
    for k, h in enumerate(o.harmonics):
        if h:
            C = control_law.response(law, 2 * np.pi * h * o.points_hz)[:, None]
            Y[:, k] = (o.R[:, k] - o.U[:, k]) / C
            sd_y[:, k] = np.hypot(sd_y[:, k], o.sd_u[:, k] / np.abs(C))
    return replace(o, Y=Y, sd_y=sd_y)


def _plain_excess(fitter: Fitter, ground: Ground) -> float:
    """What the plain twin, refitted, leaves of the plant on another ground."""
    (plain,) = fitter.each([_plain(ground)])
    return np.inf if plain is None else _excess(plain.fit)


def _plain(ground: Ground) -> Task:
    return Task(ground, (), ((),), ground.theta, (COARSE, MIDDLE, EXACT))


def _excess(fit: Fit, noise: Sequence[float] | None = None) -> float:
    """Chi-square of the fundamentals beyond their noise, and the price of the datasheet's values.

    ``noise`` is that of every group; one per residual where it is not given.
    """
    levels = [float(count) for _, count in fit.groups] if noise is None else noise
    beyond = (max(chi - level, 0.0) for (chi, _), level in zip(fit.groups[::2], levels[::2], strict=True))
    return sum(beyond) + fit.penalty
