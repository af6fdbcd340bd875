"""Whether the log itself is at fault: a signal that the loop saw otherwise than it was written down.

Such a log makes gaps in two parts of the loop at once, and two effects that are not there could explain them. One
cause is simpler: with that signal worked out from the others, the plain twin explains the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.gap.candidates import Fitter, Task
from service.gap.fit import COARSE, EXACT, MIDDLE, Fit
from service.gap.observation import Observation
from service.gap.part import Ground, parts
from service.gap.search import Explained
from sim import control_law

SIGNIFICANT = 5.0
"""Significance from which a part has a gap."""
CURED = 0.1
"""Share of the plant's excess that may be left once the signal is worked out."""


def log_fault(fitter: Fitter, found: Sequence[Explained]) -> str | None:
    """What is wrong with the log, in words, or None; ``found`` are the parts as effects explain them."""
    gap = {e.part.path: e for e in found if e.significance > SIGNIFICANT}
    plant = gap.get("plant")
    if plant is None:
        return None
    if "controller" in gap and "logging_offset" not in gap["controller"].order[0].candidate.effects:
        worked_out = tuple(as_the_controller_saw(plant.ground, o) for o in plant.ground.observations)
        if _cured(fitter, plant, replace(plant.ground, observations=worked_out)):
            return "the logged displacement is not the one that the controller used"
    if "amplifier" in gap:
        before = gap["amplifier"].ground
        silent = tuple(replace(o, I=None) for o in before.observations)
        through = next(part for part in parts(before.nuisance, silent) if part.from_control)
        ground = Ground(before.nuisance, through, silent, before.theta, before.found)
        if _cured(fitter, plant, ground):
            return "the logged coil current is not the one that moves the rotor"
    return None


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


def _cured(fitter: Fitter, plant: Explained, ground: Ground) -> bool:
    """Whether on another ground the plain twin explains the plant."""
    plain = fitter.run([Task(ground, (), ((),), ground.theta, (COARSE, MIDDLE, EXACT))])[0]
    return _excess(plain.fit) < CURED * _excess(plant.null.candidate.fit)


def _excess(fit: Fit) -> float:
    """Chi-square of the fundamentals beyond their number, and the price of the datasheet's values."""
    return sum(max(chi - count, 0.0) for chi, count in fit.groups[::2]) + fit.penalty
