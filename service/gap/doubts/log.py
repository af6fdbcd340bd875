"""Whether the log is at fault: a logged signal differs from the one in the loop.

Such a log makes gaps in two parts of the loop at once, which two effects that are not there could explain. It is at
fault if the plain twin explains the plant once that signal is computed from the others.
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
"""Share of the plant's excess that may be left once the signal is computed from the others."""
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
        The plant's ground, and its plain twin with the residuals of that.
    logged
        The plant's observations as logged; the parts in ``before`` may have been fitted to fewer sweeps.
    """
    gap = {e.part.path: e for e in before if e.significance > SIGNIFICANT}
    if not gap or gap_significance(plain[1], ground.observations) <= SIGNIFICANT:
        return None
    if "controller" in gap and "logging_offset" not in gap["controller"].order[0].candidate.effects:
        cured, logged_alike = _plain_excesses(fitter, *_with_displacement_computed(ground))
        if cured < CURED * logged_alike:
            return DISPLACEMENT
    if "amplifier" in gap:
        amplifiers = gap["amplifier"].ground
        without_i = tuple(replace(o, I=None) for o in logged)
        from_control = next(part for part in parts(amplifiers.nuisance, without_i) if part.from_control)
        ground_without_i = Ground(amplifiers.nuisance, from_control, without_i, amplifiers.theta, amplifiers.found)
        # Amplifiers with wide tolerances may compensate for a lag of the plant. So the excess must also be much less
        # than with the effects that the logged current shows in the amplifiers.
        c = gap["amplifier"].order[0].candidate
        found = (*amplifiers.found, *zip(c.effects, c.fit.values, strict=True))
        cured, believed = _plain_excesses(fitter, ground_without_i, replace(ground_without_i, found=found))
        if cured < CURED * min(_excess(plain[0].fit), believed):
            return "the logged coil current is not the one that moves the rotor"
    return None


def faint_log_fault(fitter: Fitter, before: Sequence[Explained], plant: Explained, best: Candidate) -> str | None:
    """The same where the plant's gap is so faint that only an effect, ``best``, shows that there is one; or None.

    Where noise is overestimated a faint gap leaves no excess over the number of residuals. Then the level of noise is
    the least chi-square of three fits: that effect, the plain twin, and the plain twin with the displacement computed.
    """
    controller = next((e for e in before if e.part.path == "controller" and e.significance > SIGNIFICANT), None)
    if controller is None or not best.effects or "logging_offset" in controller.order[0].candidate.effects:
        return None
    computed, as_uncertain = _with_displacement_computed(plant.ground)
    with_effect = Task(as_uncertain, best.effects, (best.fit.values,), best.fit.theta, (MIDDLE, EXACT))
    cured, plain, explained = fitter.each([_plain(computed), _plain(as_uncertain), with_effect])
    if cured is None or plain is None or explained is None:
        return None
    noise = noise_levels(plain, [cured, explained])
    left, gap = (_excess(c.fit, noise) for c in (cured, plain))
    return DISPLACEMENT if gap > CLEAR_CHI_SQUARE and left < CURED * gap else None


def _with_displacement_computed(ground: Ground) -> tuple[Ground, Ground]:
    """The plant with the displacement computed from the controller's output, and with the logged one as uncertain.

    The computed displacement has more noise; with the logged one at the same noise, both excesses can be compared.
    """
    computed = tuple(as_the_controller_saw(ground, o) for o in ground.observations)
    as_uncertain = tuple(replace(o, sd_y=c.sd_y) for o, c in zip(ground.observations, computed, strict=True))
    return replace(ground, observations=computed), replace(ground, observations=as_uncertain)


def as_the_controller_saw(ground: Ground, o: Observation) -> Observation:
    """The observation with y computed from the controller's output by the datasheet's law, y = (r - u) / C.

    Harmonic 0 stays as logged.
    """
    rig, Y, sd_y = ground.nuisance.rig, o.Y.copy(), o.sd_y.copy()
    for k, h in enumerate(o.harmonics):
        if h:
            omega = 2 * np.pi * h * o.points_hz
            C = control_law.responses(rig.controller, omega, rig.n_axes)
            late = np.exp(-1j * omega * rig.controller.sample_time_s * rig.logging_offset_samples)
            Y[:, k] = (o.R[:, k] - late[:, None] * o.U[:, k]) / C
            sd_y[:, k] = np.hypot(sd_y[:, k], o.sd_u[:, k] / np.abs(C))
    return replace(o, Y=Y, sd_y=sd_y)


def _plain_excesses(fitter: Fitter, *grounds: Ground) -> list[float]:
    """Excess of the plain twin, refitted on each ground; infinite where it cannot be fitted."""
    return [np.inf if plain is None else _excess(plain.fit) for plain in fitter.each(map(_plain, grounds))]


def _plain(ground: Ground) -> Task:
    """Task to fit the plain twin."""
    return Task(ground, (), ((),), ground.theta, (COARSE, MIDDLE, EXACT))


def _excess(fit: Fit, noise: Sequence[float] | None = None) -> float:
    """Chi-square of the fundamentals beyond noise, and the penalty.

    ``noise`` is that of each group in `Fit.groups`, by default one per residual.
    """
    levels = [float(count) for _, count in fit.groups] if noise is None else noise
    beyond = (max(chi - level, 0.0) for (chi, _), level in zip(fit.groups[::2], levels[::2], strict=True))
    return sum(beyond) + fit.penalty
