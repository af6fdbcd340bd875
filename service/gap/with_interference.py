"""Interference that was found, added to the verdict, the twins and the closure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.experiment.data import Sweep
from service.gap.compose import Composition
from service.gap.fitting.candidates import Candidate
from service.gap.interference import DISTANCE_BINS, NEAR_HUM, Interference, at_speed, hums_hz, quiet_cells
from service.gap.measured.coherent import heard_in, without_hum
from service.gap.measured.observation import near_hum, usable
from service.gap.measured.scatter import block_scatter
from service.gap.weighing.shrinkage import J_OF_NOISE, RESAMPLES, Shrinkage, closure_of, interval_95
from service.gap.weighing.significance import SIGNIFICANT, significance
from service.gap.weighing.verdict import Verdict
from service.gap.which.explained import Explained
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.wording import in_words

PROBABILITY_NAMED_ALONE = 0.9
"""Probability of interference that is named as the cause of an unexplained gap near it."""


def with_sources(verdict: Verdict, sources: Sequence[Interference], found: Sequence[Explained] = ()) -> Verdict:
    """The verdict with the interference that was found.

    If that was detected by its size alone, it could not be taken off the means. So it is named as the cause of an
    unexplained gap that lies near its frequencies only. If it was detected by its phase, its leakage is known, and no
    gap is attributed to it.
    """
    if not sources:
        return verdict
    names = tuple(s.effect for s in sources)
    classes = tuple((s.effect, *s.aliases) for s in sources if s.aliases)
    if verdict.kind != "none_of_these":
        effects = (*verdict.effects, *names)
        kind = "effect" if len(effects) == 1 else "effects"
        return replace(verdict, kind=kind, effects=effects, indistinguishable=(*verdict.indistinguishable, *classes))
    by_phase = all(s.heard_hz for s in sources)
    unknown = [e for e in found if e.part.path == verdict.unexplained]
    if by_phase or verdict.another_rig or not all(_near(e, sources) for e in unknown):
        reasons = tuple(f"{in_words(s.effect)} at {s.frequency_hz:.4g} Hz is heard beside it" for s in sources)
        return replace(verdict, reasons=(*verdict.reasons, *reasons))
    return Verdict("effect" if len(names) == 1 else "effects", names, classes, PROBABILITY_NAMED_ALONE, ())


def runout_notes(sources: Sequence[Interference]) -> list[str]:
    """Notes on runout: at one speed an unbalance has the same signal."""
    return [
        f"the runout heard at {s.frequency_hz:.4g} Hz may as well be an unbalance, which pushes the rotor once a turn: "
        "at another speed that grows with the speed's square, and runout does not"
        for s in sources
        if s.effect == "runout"
    ]


def _near(e: Explained, sources: Sequence[Interference]) -> bool:
    """Whether the best explanation of a part has significant residuals near the interference only."""
    for z, o in zip(e.left, e.ground.observations, strict=True):
        at = (o.points_hz[:, None] * np.array(o.harmonics))[..., None]
        hums = np.array(hums_hz(sources, o.speed_rad_s))
        away = (np.abs(at / hums - 1) > DISTANCE_BINS[-1]).all(axis=(1, 2))
        if away.any() and significance(z[away], replace(o, line=o.line[away], axis=o.axis[away])) > SIGNIFICANT:
            return False
    return True


def with_interference(whole: Composition, effects: Sequence[str], sources: Sequence[Interference]) -> Composition:
    """The twins, first the one that the verdict names with the interference added.

    ``effects`` are the verdict's, interference among them; where it names none, the likeliest twin gets it. The plain
    twin stays in the order.
    """
    if not sources:
        return whole
    own = tuple(name for name in effects if name not in {s.effect for s in sources})
    named = (r for r in whole.order if r.candidate.effects == own)
    best = next(named, whole.order[0]) if effects else whole.order[0]
    c = best.candidate
    together, rig = (*c.effects, *(s.effect for s in sources)), c.fit.rig
    for s in sources:
        rig = CATALOGUE[s.effect].on(rig, **s.parameters)
    values = (*c.fit.values, *(dict(s.parameters) for s in sources))
    deviations = tuple(
        {
            name: s.frequency_std_hz if name == "frequency_hz" else s.std if v else 0.0
            for name, v in s.parameters.items()
        }
        for s in sources
    )
    fit = replace(c.fit, effects=together, values=values, rig=rig)
    with_all = Candidate(together, fit, c.occam, (*c.standard_deviations, *deviations))
    others = [r for r in whole.order if r is not best or not c.effects]
    return Composition((replace(best, candidate=with_all), *others))


def scatter_shrinkage(sweep: Sweep, rig: Rig, sources: Sequence[Interference], name: str) -> Shrinkage | None:
    """Closure of the scatter near the sources to the scatter far from them, once their share is taken off.

    ``sweep`` was not used to find them; None where it comes near none of them.
    """
    sweep = usable(sweep)
    _, of_i, of_y = block_scatter(sweep, rig)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    quiet = quiet_cells(sweep, rig)
    before, after = np.empty(0), np.empty(0)
    for source in at_speed(sources, sweep.speed_rad_s):
        variance, away = (of_i if source.signal == "i" else of_y), np.abs(at / source.frequency_hz - 1)
        far, near, without = quiet & ~near_hum(sweep, (source.frequency_hz,)), quiet & (away < NEAR_HUM), variance
        if source.heard_hz:
            near = quiet & heard_in(sweep, source.frequency_hz)
            _, *rest = block_scatter(without_hum(sweep, source.frequency_hz), rig)
            without = rest[source.signal == "y"]  # a loud source also leaks far
        if not near.any() or not far.any():
            continue
        floor = np.exp(np.log(np.maximum(without[far], 1e-300)).mean(axis=0))
        ratio = (variance / floor)[near].mean(axis=1)
        if source.heard_hz:
            before = np.concatenate([before, ratio])
            after = np.concatenate([after, (without / floor)[near].mean(axis=1)])
            continue
        expected = np.array(source.shape)[np.searchsorted(DISTANCE_BINS, away[near], side="right") - 1]
        before = np.concatenate([before, ratio])
        after = np.concatenate([after, ratio / np.maximum(expected, 1.0)])
    if not len(before):
        return None
    drawn = np.random.default_rng(0).integers(0, len(before), (RESAMPLES, len(before)))
    resampled = [
        closure_of(float(b), float(a)) for b, a in zip(before[drawn].mean(1), after[drawn].mean(1), strict=True)
    ]
    interval = interval_95([c for c in resampled if c is not None], len(resampled))
    J_b, J_a = float(before.mean()), float(after.mean())
    return Shrinkage(J_b, J_a, closure_of(J_b, J_a), interval, name, J_OF_NOISE)
