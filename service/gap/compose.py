"""What was found in the parts of the loop, put together: whole twins, their probabilities, and one verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved import Seen, curved, curved_instead
from service.gap.doubts.loss import lag_missing
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.part import STANDSTILL
from service.gap.interference import Interference
from service.gap.measured.observation import Observation
from service.gap.weighing.another_rig import other_rig
from service.gap.weighing.significance import significance
from service.gap.weighing.verdict import UNEXPLAINED, HeldOut, Ranked, Verdict, decide
from service.gap.which.held_out import on_sweep
from service.gap.which.search import Explained
from sim.effects import CATALOGUE
from sim.rig import Rig

Complex = NDArray[np.complex128]

LISTED = 12
"""Explanations of a part that are put together with those of the others."""
NEGLIGIBLE = 0.02
"""Share of all parts' excess up to which a part that nothing explains does not change the verdict."""


@dataclass(frozen=True)
class Composition:
    """Whole twins by falling evidence, the plain one among them."""

    order: tuple[Ranked, ...]

    @property
    def null(self) -> Ranked:
        """The plain twin, its datasheet's values refitted."""
        return next(r for r in self.order if not r.candidate.effects)


def composed(nuisance: Nuisance, found: Sequence[Explained]) -> Composition:
    """Twins of the chosen explanations, of every alternative in one part, and of none."""
    chosen = [next(r for r in e.order if r.candidate is e.chosen) for e in found]
    by_size = sorted(range(len(found)), key=lambda k: -_excess(found[k]))
    picks = [list(chosen), [e.null for e in found]]
    for k, e in enumerate(found):
        picks += [[r if j == k else c for j, c in enumerate(chosen)] for r in e.order[:LISTED]]
        picks.append([c if j == k else found[j].null for j, c in enumerate(chosen)])
    whole: dict[tuple[str, ...], Ranked] = {}
    before = max(sum(_excess(e) for e in found), 1e-9)
    for pick in picks:
        combined = _combined(nuisance, found, pick, by_size)
        left = sum(r.unexplained * _excess(e) for r, e in zip(pick, found, strict=True)) / before
        evidence = sum(r.log_evidence for r in pick)
        probability = float(np.prod([r.probability for r in pick]))
        whole.setdefault(combined.effects, Ranked(combined, evidence, probability, left))
    return Composition(tuple(sorted(whole.values(), key=lambda r: -r.log_evidence)))


def _excess(e: Explained) -> float:
    """What the plain twin leaves of a part beyond the best explanation."""
    best = min(r.candidate.fit.chi_square + r.candidate.fit.penalty for r in e.order)
    return max(e.null.candidate.fit.chi_square + e.null.candidate.fit.penalty - best, 0.0)


def _combined(
    nuisance: Nuisance, found: Sequence[Explained], pick: Sequence[Ranked], by_size: Sequence[int]
) -> Candidate:
    """One candidate of the parts' own, effects of the largest gap first."""
    theta, k = np.zeros(len(nuisance)), len(nuisance)
    curvature = np.zeros((k, k))
    moved: dict[str, Mapping[str, float]] = {}
    for e, r in zip(found, pick, strict=True):  # as they were fitted: what one inherits of another it has moved
        fit, other = r.candidate.fit, e.ground.inherited
        active = fit.active
        if other is not None and other.of in (p.candidate.effects for p in pick):
            moved |= {name: values for (name, _), values in zip(other.effects, fit.inherited, strict=True)}
        else:
            active = e.ground.part.active
        theta[active] = fit.theta[active]
        curvature[np.ix_(active, active)] += fit.curvature[: len(active), : len(active)]
    named = [
        (name, moved.get(name, values), sds)
        for r in (pick[n] for n in by_size)
        for name, values, sds in zip(
            r.candidate.effects, r.candidate.fit.values, r.candidate.standard_deviations, strict=True
        )
    ]
    rig = nuisance.at(theta)
    for name, values, _ in named:
        rig = CATALOGUE[name].on(rig, **values)
    fit = Fit(
        tuple(name for name, _, _ in named),
        theta,
        tuple(dict(values) for _, values, _ in named),
        rig,
        tuple(g for r in pick for g in r.candidate.fit.groups),
        float(theta @ theta),
        np.arange(k),
        curvature,
        "; ".join(sorted({r.candidate.fit.status for r in pick})),
    )
    return Candidate(fit.effects, fit, sum(r.candidate.occam for r in pick), tuple(sds for _, _, sds in named))


def _bent(e: Explained, explained: bool, plain: Seen, unseen: Observation) -> str | None:
    """What curved signal stands behind a part's gap, in words; ``plain`` is the unseen sweep by the plain twin."""
    best = on_sweep(e, e.chosen, unseen)
    if explained and (reason := curved_instead(e, plain, best)):
        return reason
    # What the whole of the residuals is too blunt to show: nothing found, or an effect that leaves much.
    return curved(e, best) if not explained or e.order[0].unexplained > UNEXPLAINED else None


def verdict_of(found: Sequence[Explained], there: Mapping[str, HeldOut], unseen: Observation) -> Verdict:
    """One verdict from the parts': what nothing explains in one part outweighs what is explained in others."""
    own = {}
    for e in found:
        seen, z = on_sweep(e, e.null.candidate, unseen)
        significant = max(e.significance, significance(z, seen))
        own[e.part.path] = decide(e.order, e.remaining, there[e.part.path], significant, e.elsewhere)
        explained = own[e.part.path].kind in ("effect", "effects")
        # An amplifier that nothing explains draws its values off too, and says nothing of the rotor.
        if (explained or (e.part.path == "plant" and own["plant"].kind != "no_gap")) and (
            reason := other_rig(e.ground, e.chosen.fit)
        ):
            own[e.part.path] = Verdict("none_of_these", (), (), 0.95, (reason,), another_rig=True)
        elif explained and (reason := lag_missing(e)):
            own[e.part.path] = Verdict("none_of_these", (), (), 0.9, (reason,))
        elif (explained or own[e.part.path].kind == "no_gap") and (reason := _bent(e, explained, (seen, z), unseen)):
            own[e.part.path] = Verdict("none_of_these", (), (), 0.9, (reason,), bent=True)
    by_size = sorted(found, key=lambda e: -_excess(e))
    total = sum(_excess(e) for e in found)
    unknown = [
        e
        for e in by_size
        if own[e.part.path].kind == "none_of_these"
        # a controller, which has hardly any noise, dwarfs what the rotor of another datasheet leaves
        and (
            (e.part.path == "plant" and own["plant"].another_rig)
            or e.null.candidate.fit.chi_square > NEGLIGIBLE * total
        )
    ]
    if unknown:
        strange = [e for e in unknown if own[e.part.path].another_rig]
        unknown = [*strange, *(e for e in unknown if e not in strange)]  # what else fails there fails for that reason
        reasons = tuple(f"{e.part.path}: {reason}" for e in unknown for reason in own[e.part.path].reasons)
        return replace(own[unknown[0].part.path], reasons=reasons, unexplained=unknown[0].part.path)
    named = [own[e.part.path] for e in by_size if own[e.part.path].effects]
    probability = float(np.prod([v.probability for v in own.values() if v.kind != "none_of_these"]))
    if not named:
        return Verdict("no_gap", (), (), probability, ())
    effects = tuple(name for v in named for name in v.effects)
    classes = tuple(group for v in named for group in v.indistinguishable)
    if not any(o.speed_rad_s for e in found for o in e.ground.observations):
        classes = with_exact_aliases(effects, classes)
    return Verdict(
        "effect" if len(effects) == 1 else "effects",
        effects,
        classes,
        probability,
        (),
    )


def with_exact_aliases(effects: Sequence[str], classes: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Alias classes with the effects that a rotor at rest cannot show apart from those named.

    >>> with_exact_aliases(["modal_damping"], [])
    (('modal_damping', 'internal_damping'),)
    """
    out = []
    for name in effects:
        group = next((g for g in classes if name in g), (name,))
        group += tuple(STANDSTILL[n] for n in group if n in STANDSTILL)
        out += [group] if len(group) > 1 else []
    return tuple(out)


def with_interference(whole: Composition, sources: Sequence[Interference]) -> Composition:
    """The likeliest twin with the interference that was heard, before the others; the plain one stays among them."""
    if not sources:
        return whole
    best = whole.order[0]
    c = best.candidate
    effects, rig = (*c.effects, *(s.effect for s in sources)), c.fit.rig
    for s in sources:
        rig = CATALOGUE[s.effect].on(rig, **s.parameters)
    values = (*c.fit.values, *(dict(s.parameters) for s in sources))
    spread = tuple(
        {name: s.std if v and name.startswith("amplitude") else 0.0 for name, v in s.parameters.items()}
        for s in sources
    )
    heard = Candidate(
        effects, replace(c.fit, effects=effects, values=values, rig=rig), c.occam, (*c.standard_deviations, *spread)
    )
    return Composition((replace(best, candidate=heard), *(whole.order[1:] if c.effects else whole.order)))


def dated(whole: Composition, datasheet: Rig, campaign_s: float | None) -> Composition:
    """The same twins, a drift that was found stated over the time that the experiment took, s.

    A fit knows a point's share of the campaign only. Where the file does not tell the time, or the datasheet has a
    drift already, the time stays as it is.
    """
    if campaign_s is None or datasheet.drift is not None:
        return whole
    effect = CATALOGUE["thermal_drift"]
    duration = next(p for p in effect.parameters if p.name == "duration_s")
    stated_s = float(np.clip(campaign_s, duration.low, duration.high))

    def restated(r: Ranked) -> Ranked:
        c = r.candidate
        if "thermal_drift" not in c.effects:
            return r
        at = c.effects.index("thermal_drift")
        values, spread = ([dict(v) for v in of] for of in (c.fit.values, c.standard_deviations))
        values[at]["duration_s"], spread[at]["duration_s"] = campaign_s, 0.0
        if stated_s != campaign_s:  # a campaign of days, stated over the longest time that the effect may take
            values[at] = dict(effect.restated(values[at], {**values[at], "duration_s": stated_s}))
        drift = None if c.fit.rig.drift is None else replace(c.fit.rig.drift, duration_s=campaign_s)
        fit = replace(c.fit, values=tuple(values), rig=replace(c.fit.rig, drift=drift))
        return replace(r, candidate=replace(c, fit=fit, standard_deviations=tuple(spread)))

    return Composition(tuple(restated(r) for r in whole.order))


def heard_too(verdict: Verdict, sources: Sequence[Interference]) -> Verdict:
    """The verdict with the interference that was heard beside it.

    What else nothing explains is then laid to the interference: it disturbs the means too, where it could not be
    taken off.
    """
    if not sources:
        return verdict
    if verdict.kind == "none_of_these" and all(s.heard_hz for s in sources):
        told = tuple(f"{s.effect} at {s.frequency_hz:.4g} Hz is heard beside it" for s in sources)
        return replace(verdict, reasons=(*verdict.reasons, *told))
    effects = (*verdict.effects, *(s.effect for s in sources))
    kind = "effect" if len(effects) == 1 else "effects"
    classes = (*verdict.indistinguishable, *((s.effect, *s.aliases) for s in sources if s.aliases))
    return replace(verdict, kind=kind, effects=effects, indistinguishable=classes, reasons=())
