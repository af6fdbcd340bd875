"""A diagnosis as the document gap.json (contract "amb-gap-report", version 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.gap.diagnosis import Diagnosis, listed, runner_up
from service.gap.fitting.candidates import Candidate
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.shrinkage import Closed
from service.gap.weighing.significance import OUTLIER
from sim.effects import CATALOGUE
from sim.wording import in_words

FEW_POINTS = 10.0
"""Ratio of gap and noise from which the gap is in a few points, where no band and no channel shows it."""

WORSE = 0.005
"""Share by which a gap grows on unseen data from which it is not said to close by 0 %."""


def verdict_path(d: Diagnosis) -> str:
    """Path of the block that the verdict blames: the effect's own where there is one, else where the gap is."""
    if d.verdict.effects:
        return CATALOGUE[d.verdict.effects[0]].path
    return d.where.path


def _blamed(d: Diagnosis) -> str:
    """All blocks of the loop that hold an effect of the verdict, in words."""
    paths = dict.fromkeys(CATALOGUE[effect].path for effect in d.verdict.effects)
    return " and the ".join(map(path_in_words, paths))


def path_in_words(path: str) -> str:
    """Where in the loop something acts."""
    return "signals" if path == "additive" else path


def stated(c: Candidate) -> dict[str, dict[str, Any]]:
    """Value, deviation and reached bound of an explanation's parameters; "given" where it was not fitted."""
    out: dict[str, dict[str, Any]] = {}
    for effect, values, sds in zip(c.effects, c.fit.values, c.standard_deviations, strict=True):
        prefix = f"{effect}." if len(c.effects) > 1 else ""
        for name, value in values.items():
            # a parameter without a deviation was not fitted
            end = c.fit.ends.get((effect, name)) if sds.get(name) else None
            given = {"given": True} if (effect, name) in c.given else {}
            std = sds[name] if sds[name] or given else None  # held where the law is simplest, and not known exactly
            out[prefix + name] = {"value": value, "std": std, "at_bound": end, **given}
    return out


def _candidate(d: Diagnosis, r: Ranked) -> dict[str, Any]:
    c = r.candidate
    return {
        "effect": "+".join(c.effects),
        "effects": list(c.effects),
        "probability": r.probability,
        "parameters": stated(c),
        "gap_after": d.gaps_after.get(c.effects),
        "closure": d.closures.get(c.effects),
        "log_evidence": r.log_evidence,
        "unexplained": r.unexplained,
        "open_strength": list(r.open_strength),
        "status": c.fit.status,
    }


def likeliest(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The candidates of a gap.json as they are shown: the one that the verdict names, then by falling probability.

    Probabilities are rounded to per cent, so that rivals of none stay before those that contain the named one.
    """
    named = "+".join(document["verdict"]["effects"])
    return sorted(document["candidates"], key=lambda c: (c["effect"] != named, -round(c["probability"], 2)))


def parameters_used(candidate: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The fitted parameters of a gap.json's candidate, without those of wider laws that it does without."""

    def used(name: str, value: float) -> bool:
        effect, _, parameter = name.rpartition(".")
        p = next(p for p in CATALOGUE[effect or candidate["effect"]].parameters if p.name == parameter)
        return value != p.null or not (p.dormant or p.optional)

    return {name: e for name, e in candidate["parameters"].items() if used(name, e["value"])}


def ends_reached(document: Mapping[str, Any]) -> list[str]:
    """Strengths of the verdict's effects that are at an end of their range, in words; ``document`` is a gap.json.

    Shape parameters do not count, as their law may be the simplest there, nor does a strength at its null.
    """
    named = document["verdict"]["effects"]
    listed_effects = ((c.get("effects") or c["effect"].split("+"), c["parameters"]) for c in document["candidates"])
    sentences = []
    for name, e in next((found for effects, found in listed_effects if effects == named), {}).items():
        effect, _, parameter = name.rpartition(".")
        effect = effect or named[0]
        # a report of another version may know parameters that this one does not
        known = CATALOGUE[effect].parameters if effect in CATALOGUE else ()
        p = next((p for p in known if p.name == parameter), None)
        if p is not None and e.get("at_bound") and p.strength and e["value"] != p.null:
            where = f"{p.words} of {in_words(effect)} is at the {e['at_bound']} end of its range"
            sentences.append(f"{where}, where the fit had to stop: not measured")
    return sentences


def _closed(c: Closed) -> dict[str, Any]:
    return {"before": c.before, "after": c.after, "closure": c.closure, "closure_95": list(c.closure_95)}


def gap_document(d: Diagnosis) -> dict[str, Any]:
    """gap.json as plain values; numbers are finite or None."""
    w, s, v, axes = d.where, d.shrinkage, d.verdict, d.null.fit.rig.axes
    rival = runner_up(d.order, v.effects)
    second = None if rival is None else rival.candidate.effects
    document: dict[str, Any] = {
        "format": "amb-gap-report",
        "version": 1,
        "rig": d.rig,
        "of": d.of,
        "gap": {"before": d.gap_before, "noise_floor": d.noise_floor},
        "where": {
            "path": verdict_path(d),
            "paths": [
                {"path": p.path, "gap": p.gap, "significance": p.significance, "logged": p.logged} for p in w.paths
            ],
            "bands": [{"from_hz": a, "to_hz": b, "gap": g, "significance": z} for a, b, g, z in w.bands],
            "channels": [{"output": a, "input": b, "gap": g, "significance": z} for a, b, g, z in w.channels],
            "bands_and_channels_of": w.blamed,
            "harmonics": [{"signal": a, "harmonic": h, "significance": g} for a, h, g in w.harmonics],
            "amplitude_dependent": w.depends.amplitude,
            "speed_dependent": w.depends.speed,
            "dependence_significance": w.depends.significance,
        },
        "verdict": {
            "kind": v.kind,
            "effects": list(v.effects),
            "indistinguishable": [list(group) for group in v.indistinguishable],
            "probability": v.probability,
            "reasons": list(v.reasons),
            "outdated": list(v.outdated),
            "sentence": sentence(d),
        },
        "candidates": [_candidate(d, r) for r in listed(d.order, v.effects)],
        "shrinkage": {
            "held_out": s.held_out,
            "before": s.before,
            "after": s.after,
            "noise_floor": s.noise_floor,
            "closure": s.closure,
            "closure_95": list(s.closure_95),
            "by_path": {path: c.closure for path, c in s.paths.items() if c.closure is not None},
            "runner_up": None if second is None else {"effects": list(second), "closure": d.closures.get(second)},
            "paths": [{"path": path, "noise_floor": s.noise_floor} | _closed(c) for path, c in s.paths.items()],
            "channels": [
                {"signal": signal, "output": axes[a], "input": axes[b], "noise_floor": s.noise_floor} | _closed(c)
                for (signal, a, b), c in s.channels.items()
            ],
        },
        "discrepancy": d.discrepancy,
        "loop": d.loop,
        "next_experiment": d.next_experiment,
        "datasheet_off": list(d.datasheet_off),
        "notes": list(d.notes),
    }
    document["notes"] += ends_reached(document)
    return dict(_finite(document))


def _finite(value: Any) -> Any:
    """The value with plain numbers, None in the place of those that are not finite."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    return value


def alike(d: Diagnosis) -> tuple[list[str], list[str]]:
    """Effects of the verdict's classes that it does not name: those about as likely, and those that only fit as well.

    A law with more parameters or a slightly larger residual may fit as well as two laws of one effect agree, and still
    be far less likely.
    """
    v, rivals, unlikely = d.verdict, list[str](), list[str]()
    evidence = {frozenset(r.candidate.effects): r.log_evidence for r in d.order}
    best = evidence.get(frozenset(v.effects), -np.inf)
    for group in v.indistinguishable:
        named = next(e for e in group if e in v.effects)
        for other in (e for e in group if e not in v.effects):
            own = evidence.get(frozenset({*v.effects, other} - {named}))
            behind = own is not None and own < best - ALIKE_LOG_EVIDENCE
            (unlikely if behind else rivals).append(other)
    return rivals, unlikely


def _and_more(words: Sequence[str]) -> str:
    """The first of some words, and how many more there are."""
    return words[0] + (f" and {len(words) - 1} more" if len(words) > 1 else "")


def sentence(d: Diagnosis) -> str:
    """The diagnosis in one sentence: where, which, how far, how sure."""
    v, s = d.verdict, d.shrinkage
    gap, sure = f"{100 * d.gap_before:.2g} %", f"probability {100 * v.probability:.0f} %"
    if v.kind == "no_gap":
        if v.reasons:
            return f"No gap ({sure}): the twin explains the rig to {gap}, and {v.reasons[0]}."
        few = d.gap_before > FEW_POINTS * d.noise_floor
        but = f" but for a few points, which make {gap} where noise makes {100 * d.noise_floor:.2g} %"
        if d.datasheet_off:
            to = f" to {gap}, which is noise"
            return (
                f"No effect is missing ({sure}), but the datasheet is off beyond its tolerances "
                f"({_and_more(d.datasheet_off)}): with those values the twin explains the rig{but if few else to}."
            )
        to = f" to {gap}, which is noise and the datasheet's tolerances"
        if d.beyond_tolerance:
            to += f", stretched ({_and_more(d.beyond_tolerance)})"
        return f"No gap ({sure}): the twin explains the rig{but if few else to}."
    if not v.settled:
        return f"Nothing can be said of the gap: {v.reasons[0]}."
    if v.another_rig:
        cause = v.reasons[0].removeprefix(f"{v.unexplained}: ")
        return f"Nothing can be said of effects: the rig differs from its twin by {gap}, and {cause} ({sure})."
    if v.misstated:
        cause = v.reasons[0].removeprefix(f"{v.unexplained}: ")
        return f"The datasheet seems to be wrong: the rig differs from its twin by {gap}, and {cause} ({sure})."
    if v.outdated:
        closes = "" if s.closure is None else f"; that closes {100 * s.closure:z.0f} % of the gap on unseen data"
        return f"The twin is out of date: the rig differs from it by {gap}, and {v.reasons[0]} ({sure}){closes}."
    if v.kind == "none_of_these":
        why = f" ({v.reasons[0]})" if v.reasons else ""
        where = path_in_words(verdict_path(d))
        return (
            f"The rig differs from its twin by {gap}, and what is wrong in the {where} no known effect explains{why}, "
            f"{sure}."
        )
    words = " and ".join(map(in_words, v.effects))
    rivals, unlikely = (", ".join(map(in_words, names)) for names in alike(d))
    unsure = f", not told apart from {rivals}" if rivals else ""
    if d.within_the_datasheet:
        return (
            f"The twin explains the rig to {gap}, which is noise, but only with its datasheet off by more than its "
            f"tolerances let one believe: {words}{unsure} ({sure})."
        )
    if s.closure is not None and s.closure < -WORSE:
        far = f", which closes nothing of the gap on unseen data: it is {-100 * s.closure:.0f} % larger there"
    elif s.closure is not None:
        far = f", which closes {100 * s.closure:z.0f} % of the gap on unseen data"
    elif s.before > OUTLIER * s.noise_floor:
        far = "; a few lines alone show this gap on unseen data, too few to tell how much of it closes"
    else:
        far = "; the unseen sweep does not show this gap, so how much of it closes is not known"
    behind = f"; far less likely, though about as good a fit: {unlikely}" if unlikely else ""
    return f"The rig differs from its twin by {gap} in the {_blamed(d)}: {words}{unsure} ({sure}){far}{behind}."
