"""Whether a value of the datasheet that no tolerance covers explains a part of the loop, where it is another.

The bias current sets the air gap, and with it all of the force law beyond its linear part: where it is wrong, a rotor
that swings far seems to saturate, to drift or to touch something. A mode that the datasheet has elsewhere than the
rotor, or that the rotor has not at all, looks like one more mode of the rig, which takes it off again. And a loop that
is faster than its stated computing delay would have an effect of less than nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from service.gap.fitting.candidates import Candidate
from service.gap.measured.observation import Observation
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE, noise_levels
from service.gap.weighing.shrinkage import closure_of
from service.gap.weighing.significance import mean_power
from service.gap.weighing.verdict import CLOSES, MAX_SHARE_LEFT, Verdict
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from service.gap.which.moved_modes import mean_hz, twin_of, without_mode
from service.gap.which.refits import cost
from sim.effects import CATALOGUE
from sim.rig import Rig

MODE, DELAY = "extra_flexible_mode", "loop_delay"

STEP, SMALL_STEP = 0.2, 0.05
"""Change of ln of the bias current by which it is first tried, up and down; and, where a nonlinear effect or none is
named, by which it is tried, too: a sheet's air gap is hardly known better."""
FARTHEST = math.log(2.5)
"""Change of its ln beyond which a wrong bias current is not looked for."""
CURVED = 0.05
"""Relative gap of the plant up to which the force law beyond its linear part may be all of it."""
TRIED = 0.3
"""Share of the plant's excess that one step of the bias must take off for its value to be looked for."""
CLOSE = 0.01
"""Change of its ln to which it is found: the air gap is hardly known better. Likewise of a computing delay."""
SHORTER = (0.1, 0.7)
"""Shares of the stated computing delay from which a shorter one is fitted."""
NO_RIG = 10.0
"""Times the plain twin's cost that a bias counts as with which there is no rig."""


def misstated(e: Explained, verdict: Verdict, unseen: Observation) -> str | None:
    """What the datasheet states wrongly of a part, in words, where that explains it as well as effects; or None."""
    if verdict.kind == "no_gap":
        return None
    if (e.part.path == "amplifier" or e.part.from_control) and (faster := _less_delay(e)):
        return faster
    if e.part.path != "plant":
        return None
    if elsewhere := _modes_elsewhere(e, unseen):
        return elsewhere
    bends = not verdict.effects or any(CATALOGUE[name].nonlinear for name in verdict.effects)
    if e.relative_gap < CURVED and (bias := _another_bias(e, (STEP, SMALL_STEP) if bends else (STEP,))):
        return bias
    return _absent_mode(e) if MODE in verdict.effects or not verdict.effects else None


def _modes_elsewhere(e: Explained, unseen: Observation) -> str | None:
    """The datasheet's modes at other frequencies that explain the plant, on unseen data too, in words; or None."""
    moved = e.moved
    if moved is None or not _explains(e, cost(moved.candidate), CLEAR_CHI_SQUARE):
        return None
    (_, before), (_, after) = (
        on_sweep(e, e.null.candidate, unseen),
        on_sweep(replace(e, ground=moved.ground), moved.candidate, unseen),
    )
    closes = closure_of(mean_power(before), mean_power(after))
    if closes is not None and closes < CLOSES:
        return None
    there = "" if closes is None else f", {100 * closes:.0f} % of it on unseen data"
    return (
        f"with {moved} the twin explains it{there}: correct frequency_hz, or find what has changed the rotor, and "
        "diagnose again"
    )


def _less_delay(e: Explained) -> str | None:
    """The computing delay, shorter than stated, that explains the amplifiers, in words; or None."""
    rig, start = e.ground.nuisance.rig, CATALOGUE[DELAY].null()
    stated_s = rig.controller.computing_delay_s
    if stated_s == 0.0:
        return None
    undelayed = replace(rig, controller=replace(rig.controller, computing_delay_s=0.0))
    starts = tuple(({**start, "delay_s": share * stated_s},) for share in SHORTER)
    c = twin_of(e.ground, undelayed, e.null.candidate.fit.theta, effects=(DELAY,), starts=starts)
    if c is None or not _explains(e, c.fit.cost, 0.0):
        return None
    delay_s = c.fit.values[0]["delay_s"]
    if delay_s > (1 - CLOSE) * stated_s:
        return None
    found, stated = (f"{round(1e6 * s, 1):g} us" for s in (delay_s, stated_s))
    return (
        f"with a computing delay of {found} instead of the datasheet's {stated} the twin explains it: correct "
        "computing_delay_s, and diagnose again"
    )


def _another_bias(e: Explained, first: Sequence[float]) -> str | None:
    """The bias current that explains the plant better than its best effects do, in words; or None.

    ``first`` are the changes of its ln that are tried up and down before it is looked for. One near the datasheet's
    must lead what effects leave by a clear chi-square: a faint one looks alike.
    """
    null = e.null.candidate.fit.cost

    def cost_with(by: float) -> float:
        """The plain twin's cost with another bias; high where there is no such rig."""
        c = _fitted(e, _with_bias(e.ground.nuisance.rig, math.exp(by)))
        return NO_RIG * null if c is None else c.fit.cost

    steps = {sign * by: cost_with(sign * by) for by in first for sign in (1, -1)}
    better = min(steps, key=steps.__getitem__)
    if steps[better] > null - TRIED * (null - _noise(e)):
        return None
    bounds = (0.0, FARTHEST) if better > 0 else (-FARTHEST, 0.0)
    found = scipy.optimize.minimize_scalar(cost_with, bounds=bounds, method="bounded", options={"xatol": CLOSE})
    by, least = min((float(found.x), float(found.fun)), (better, steps[better]), key=lambda one: one[1])
    if not _explains(e, least, -CLEAR_CHI_SQUARE if abs(by) < STEP else 0.0):
        return None
    stated = e.ground.nuisance.rig.magnets.bias_current_a
    return (
        f"with {math.exp(by):.3g} times the datasheet's bias current, {_amperes(math.exp(by) * stated)}, the twin "
        "explains it: check bias_current_a, which sets the air gap, and diagnose again"
    )


def _absent_mode(e: Explained) -> str | None:
    """The mode of the datasheet without which the twin explains the plant, in words; or None."""
    rig = e.ground.nuisance.rig
    without = {k: _fitted(e, without_mode(rig, k)) for k in range(e.ground.nuisance.n_modes)}
    costs = {k: c.fit.cost for k, c in without.items() if c is not None}
    if not costs:
        return None
    k = min(costs, key=costs.__getitem__)
    if not _explains(e, costs[k], CLEAR_CHI_SQUARE):
        return None
    return (
        f"without the datasheet's mode at {mean_hz(rig, k):.4g} Hz the twin explains it: the rotor does not show that "
        "mode; take it out of the datasheet, or measure where it is, and diagnose again"
    )


def _explains(e: Explained, cost: float, worse: float) -> bool:
    """Whether a twin leaves hardly anything, and at most ``worse`` more than the best explanation by effects."""
    null, noise = e.null.candidate.fit.cost, _noise(e)
    clear = null - cost > max(CLEAR_CHI_SQUARE, (1 - MAX_SHARE_LEFT) * (null - noise))
    return clear and cost <= e.order[0].candidate.fit.cost + worse


def _noise(e: Explained) -> float:
    return sum(noise_levels(e.null.candidate, [r.candidate for r in e.order]))


def _fitted(e: Explained, rig: Rig) -> Candidate | None:
    """The plain twin fitted with another rig as its datasheet's; None where it is none that can be computed."""
    return twin_of(e.ground, rig, e.null.candidate.fit.theta)


def _with_bias(rig: Rig, factor: float) -> Rig:
    return replace(rig, magnets=replace(rig.magnets, bias_current_a=factor * rig.magnets.bias_current_a))


def _amperes(currents: np.ndarray) -> str:
    """Currents of all axes in words.

    >>> _amperes(np.array([2.75, 2.75])), _amperes(np.array([2.0, 2.5]))
    ('2.75 A', '2 to 2.5 A')
    """
    low, high = f"{currents.min():.3g}", f"{currents.max():.3g}"
    return f"{low} A" if low == high else f"{low} to {high} A"
