"""Scores of a blind trial: verdicts against opened truths, by detectability.

They are computed from gap.json documents and sealed truths alone, and do not depend on how a diagnosis decides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.wording import in_words

DETECTABLE = 10.0
"""Whitened norm above which an effect counts as detectable."""
CLASS_SIZE = 3
"""Largest alias class that still counts as an answer."""
DETECTABILITY_BANDS = (0.0, 3.0, 10.0, 30.0, 100.0, math.inf)
"""Edges of the bands of detectability by which scores are stated."""
CALIBRATION_BINS = 10
WORTH_CLOSING = 0.2
"""Least closure of the true effect for a ratio to it to be meaningful."""


@dataclass(frozen=True)
class Outcome:
    """One case: its truth and the report of the diagnosis."""

    case: int
    kind: str
    """"single", "mixture", "clean" or "unlisted"."""
    effects: tuple[str, ...]
    parameters: Mapping[str, Mapping[str, float]]
    """True values by effect."""
    law: str
    detectability: float
    report: Mapping[str, Any]
    """gap.json."""
    seconds: float
    each: Mapping[str, float] = field(default_factory=dict)
    """Detectability of each effect of a mixture, the others being known; where it is missing, that of all together."""

    @property
    def verdict(self) -> Mapping[str, Any]:
        """The report's verdict."""
        return dict(self.report["verdict"])

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that the verdict names, the best first."""
        return tuple(self.verdict["effects"]) if self.verdict["kind"] in ("effect", "effects") else ()

    @property
    def probability(self) -> float:
        """Probability that the verdict states."""
        return float(self.verdict["probability"])

    @property
    def detectable(self) -> bool:
        """Whether the truth stands out enough to be expected of a diagnosis."""
        return self.detectability > DETECTABLE

    def answers(self, effect: str, of: Sequence[str] | None = None) -> bool:
        """Whether the verdict names an effect, or a small alias class of a named one that holds it."""
        named = self.named if of is None else tuple(of)
        if effect in named:
            return True
        groups = (tuple(g) for g in self.verdict["indistinguishable"])
        return any(effect in g and len(g) <= CLASS_SIZE and set(g) & set(named) for g in groups)

    @property
    def right(self) -> bool:
        """Whether the verdict is right: kind and effects, by class. "No gap" is right if the truth is undetectable."""
        kind = self.verdict["kind"]
        if self.kind == "clean":
            return bool(kind == "no_gap")
        if self.kind == "unlisted":
            return bool(kind == "none_of_these" or (kind == "no_gap" and not self.detectable))
        if kind == "no_gap":
            return not self.detectable
        true = all(any(self.answers(e, (name,)) for e in self.effects) for name in self.named)
        return bool(self.named) and true and all(self.answers(e) for e in self.visible)

    @property
    def visible(self) -> tuple[str, ...]:
        """True effects that are detectable, each with the others known."""
        return tuple(e for e in self.effects if self.each.get(e, self.detectability) > DETECTABLE)

    def candidate(self, effects: Iterable[str]) -> Mapping[str, Any] | None:
        """The report's candidate with exactly those effects."""
        wanted = set(effects)
        for c in self.report["candidates"]:
            if set(c.get("effects") or str(c["effect"]).split("+")) == wanted:
                return dict(c)
        return None

    @property
    def closure_share(self) -> float | None:
        """Closure of the verdict's explanation over that of the true effects refitted; None where it is meaningless.

        0 where detectable effects were not named.
        """
        if not self.effects:
            return None
        if not self.named:
            return 0.0 if self.detectable else None
        truth, reached = self.candidate(self.effects), self.report["shrinkage"]["closure"]
        ideal = None if truth is None else truth.get("closure")
        if ideal is None or reached is None:
            # The true effects are not among the reported candidates, or have no closure there. They would close all at
            # most, so that this is the least that the share can be.
            return None if reached is None else float(reached)
        return float(reached) / ideal if ideal > WORTH_CLOSING else None


def outcome_of(truth: Mapping[str, Any], report: Mapping[str, Any], seconds: float = math.nan) -> Outcome:
    """The outcome of a diagnosis, from an opened truth.

    Parameters
    ----------
    truth
        As of `sim.withheld.case.Case.truth`, with "detectability", and "each" of a mixture. Where these are missing, it
        counts as detectable.
    report
        gap.json.
    seconds
        Time of the diagnosis, s.

    Raises
    ------
    KeyError
        The truth lacks a field.
    """
    return Outcome(
        case=truth["case"],
        kind=truth["kind"],
        effects=tuple(truth["effects"]),
        parameters=truth["parameters"],
        law=truth["law"],
        detectability=truth.get("detectability", math.inf),
        report=report,
        seconds=seconds,
        each=truth.get("each", {}),
    )


def described(effects: Mapping[str, Mapping[str, float]]) -> str:
    """Effects and their values in one line.

    >>> described({"loop_delay": {"delay_s": 3.5e-05}})
    'loop delay (delay_s 3.5e-05)'
    """
    listed = {name: ", ".join(f"{k} {v:.3g}" for k, v in values.items()) for name, values in effects.items()}
    return " and ".join(f"{in_words(name)} ({values})" for name, values in listed.items()) or "nothing"


def case_in_words(o: Outcome) -> str:
    """One case in one line: what was withheld, its detectability, what was found, and whether that is right."""
    found = in_words(" and ".join(o.named) or str(o.verdict["kind"]))
    shows = f", detectability {o.detectability:.0f}" if math.isfinite(o.detectability) else ""
    mark = "right" if o.right else "wrong"
    withheld = in_words(o.law) if o.law else described(o.parameters)
    return f"{o.kind}: {withheld}{shows} -> {found} ({o.probability:.2f}): {mark}"


def score(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Every score of a trial, as plain values; a share without cases is None."""
    by_kind = {k: [o for o in outcomes if o.kind == k] for k in ("single", "mixture", "clean", "unlisted")}
    known = by_kind["single"] + by_kind["mixture"]
    seen = [o for o in by_kind["single"] if o.detectable]
    mixed = [o for o in by_kind["mixture"] if o.detectable]
    both = [o for o in mixed if len(o.visible) == len(o.effects)]
    by_verdict = {o.verdict["kind"]: [p for p in outcomes if p.verdict["kind"] == o.verdict["kind"]] for o in outcomes}
    return {
        "cases": {k: len(v) for k, v in by_kind.items()},
        "detectable": {k: sum(o.detectable for o in v) for k, v in by_kind.items()},
        "single": {
            "top1": _share(o.named[:1] == o.effects for o in seen),
            "top1_by_class": _share(any(o.answers(e, o.named[:1]) for e in o.effects) for o in seen),
            "verdict_right": _share(o.right for o in seen),
            "path_right": _share(_path_right(o) for o in seen),
            "by_effect": _by_effect(by_kind["single"]),
        },
        "mixture": {
            "all_visible": len(both),
            "both_found": _share(all(o.answers(e) for e in o.effects) for o in both),
            "both_found_of_all": _share(all(o.answers(e) for e in o.effects) for o in mixed),
            "one_found": _share(any(o.answers(e) for e in o.effects) for o in mixed),
        },
        "unlisted": _unlisted(by_kind["unlisted"], [o for o in known if o.detectable]),
        "clean": {"false_alarms": _share(o.verdict["kind"] != "no_gap" for o in by_kind["clean"])},
        "missed": _share(o.verdict["kind"] == "no_gap" for o in known if o.detectable),
        "calibration": calibration([(o.probability, o.right) for o in outcomes]),
        "calibration_by_verdict": {k: stated_and_came_true(v) for k, v in sorted(by_verdict.items())},
        "closure": _closure(outcomes),
        "parameters": parameters([o for o in known if o.right]),
        "by_detectability": _by_detectability(outcomes),
        "seconds": {
            "median": _median(o.seconds for o in outcomes),
            "largest": max((o.seconds for o in outcomes), default=None),
        },
    }


def _share(hits: Iterable[bool]) -> float | None:
    values = [bool(h) for h in hits]
    return sum(values) / len(values) if values else None


def _median(values: Iterable[float]) -> float | None:
    found = list(values)
    return float(np.median(found)) if found else None


def _path_right(o: Outcome) -> bool:
    from sim.effects import CATALOGUE

    return bool(o.report["where"]["path"] in {CATALOGUE[e].path for e in o.effects})


def _by_effect(singles: Sequence[Outcome]) -> dict[str, dict[str, Any]]:
    names = sorted({e for o in singles for e in o.effects})
    found = {}
    for name in names:
        here = [o for o in singles if name in o.effects and o.detectable]
        wrong = [" + ".join(o.named) or o.verdict["kind"] for o in here if not o.right]
        found[name] = {"detectable": len(here), "right": _share(o.right for o in here), "taken_for": wrong}
    return found


def _unlisted(unlisted: Sequence[Outcome], known: Sequence[Outcome]) -> dict[str, Any]:
    seen = [o for o in unlisted if o.detectable]
    laws = sorted({o.law for o in unlisted})
    return {
        "recall": _share(o.verdict["kind"] == "none_of_these" for o in seen),
        "false_abstention": _share(o.verdict["kind"] == "none_of_these" for o in known),
        "by_law": {
            law: {
                "detectable": sum(o.detectable for o in unlisted if o.law == law),
                "verdicts": [" + ".join(o.named) or o.verdict["kind"] for o in seen if o.law == law],
            }
            for law in laws
        },
    }


def _closure(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    shares = [s for o in outcomes if o.detectable and (s := o.closure_share) is not None]
    closures = [o.report["shrinkage"]["closure"] for o in outcomes if o.detectable and o.named and o.right]
    reached = [float(closure) for closure in closures if closure is not None]
    return {
        "of_true_effect_median": _median(shares),
        "of_true_effect_tenth": float(np.quantile(shares, 0.1)) if shares else None,
        "cases": len(shares),
        "median_where_right": _median(reached),
    }


def stated_and_came_true(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Mean stated probability of verdicts of one kind, and the share of them that were right."""
    return {
        "cases": len(outcomes),
        "stated": float(np.mean([o.probability for o in outcomes])),
        "came_true": _share(o.right for o in outcomes),
    }


def calibration(forecasts: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """Brier score and expected calibration error of (probability, came true).

    The error is the mean over equally wide bins, weighted with their cases, of |mean probability - share that came
    true| (Naeini, Cooper and Hauskrecht, AAAI 2015).

    >>> calibration([(1.0, True), (0.0, False)])["brier"]
    0.0
    """
    if not forecasts:
        return {"brier": None, "ece": None, "bins": []}
    p, came = np.array([f for f, _ in forecasts]), np.array([float(c) for _, c in forecasts])
    place = np.minimum((p * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    bins, error = [], 0.0
    for k in range(CALIBRATION_BINS):
        here = place == k
        if here.any():
            stated, true = float(p[here].mean()), float(came[here].mean())
            error += here.mean() * abs(stated - true)
            bins.append({"stated": stated, "came_true": true, "cases": int(here.sum())})
    return {"brier": float(((p - came) ** 2).mean()), "ece": float(error), "bins": bins}


def parameters(right: Sequence[Outcome]) -> dict[str, Any]:
    """Errors of the strengths of true effects that were named, and the coverage of their 95 % intervals."""
    from sim.effects import CATALOGUE

    errors, covered, within = [], [], []
    for o in right:
        found = o.candidate(o.effects)
        if found is None or not set(o.effects) <= set(o.named):
            continue
        for name, values in o.parameters.items():
            effect, prefix = CATALOGUE[name], "" if len(o.effects) == 1 else f"{name}."
            found_values = {p.name: found["parameters"].get(f"{prefix}{p.name}") for p in effect.parameters}
            true = {p.name: values.get(p.name, p.null) for p in effect.parameters}
            true = dict(effect.restated(true, true | {k: float(t["value"]) for k, t in found_values.items() if t}))
            for p in effect.parameters:
                here = found_values[p.name]
                if not here or not p.strength or true[p.name] == p.null:
                    continue
                error = abs(float(here["value"]) - true[p.name])
                errors.append(error / abs(true[p.name] - p.null))
                within.append(errors[-1] <= 0.15)
                if here.get("std") is not None:
                    covered.append(error <= 1.96 * float(here["std"]))
    return {
        "values": len(errors),
        "relative_error_median": _median(errors),
        "within_15_percent": _share(within),
        "coverage_95": _share(covered),
    }


def _by_detectability(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Every score of cases with an effect of the catalogue, by detectability."""
    rows = []
    for low, high in itertools.pairwise(DETECTABILITY_BANDS):
        everything = [o for o in outcomes if o.kind != "clean" and low <= o.detectability < high]
        here = [o for o in everything if o.kind != "unlisted"]
        shares = [share for o in here if (share := o.closure_share) is not None]
        forecasts = calibration([(o.probability, o.right) for o in everything])
        rows.append(
            {
                "from": low,
                "to": high if math.isfinite(high) else None,
                "cases": len(here),
                "found": _share(all(o.answers(e) for e in o.effects) for o in here),
                "single": _share(any(o.answers(e, o.named[:1]) for e in o.effects) for o in here if o.kind == "single"),
                "mixture": _share(all(o.answers(e) for e in o.effects) for o in here if o.kind == "mixture"),
                "unlisted": _share(o.verdict["kind"] == "none_of_these" for o in everything if o.kind == "unlisted"),
                "no_gap": _share(o.verdict["kind"] == "no_gap" for o in here),
                "closure_of_true_effect_median": _median(shares),
                "brier": forecasts["brier"],
                "ece": forecasts["ece"],
                "parameters": parameters([o for o in here if o.right]),
            }
        )
    return rows
