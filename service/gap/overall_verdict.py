"""The overall verdict: from those of the parts, interference, faults of the log, and how the rig settled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from service.gap.compose import excess_of
from service.gap.doubts.amplitude_dependent import changes_with_amplitude
from service.gap.doubts.changing_mode_instead import changing_instead
from service.gap.doubts.curvature_instead import curved_alike, curved_instead
from service.gap.doubts.curved_signal import Seen, curved_signal
from service.gap.doubts.hysteresis_loss import lag_missing
from service.gap.doubts.misstated import misstated
from service.gap.doubts.other_plane import Across, across_alike
from service.gap.fitting.part import STANDSTILL
from service.gap.interference import Interference
from service.gap.lost_loop import LostLoop, named_limit
from service.gap.measured.observation import Observation
from service.gap.measured.settling import UNSETTLED
from service.gap.weighing.another_rig import drawn_by_its_law, far_off, free_body, with_datasheet_off
from service.gap.weighing.significance import alone_hz, overall, significance
from service.gap.weighing.verdict import MAX_SHARE_LEFT, SURE_OF_NONE, HeldOut, Verdict, decide
from service.gap.which.explained import Explained, gap_significance
from service.gap.which.held_out import between_lines, held_out, on_sweep
from service.gap.with_interference import with_sources
from sim.effects import CATALOGUE

NEGLIGIBLE = 0.02
"""Share of all parts' excess that the chi-square of an unexplained part must exceed to be reported."""
TELLS_NOTHING = 0.05
"""Relative drift of points from which "no gap" would be meaningless where most drift; smaller drifts, which low noise
shows, are no reason to withhold it."""
SHOWS_FIRST = {
    "controller": "which stands out there alone, as where the output ends or a log cuts off what is beyond its range",
    "amplifier": "which stands out there alone, as where a limit of voltage or current is met",
    "plant": "where the rotor swings furthest, its currents are steepest, or one plane moves the other as it turns",
}
"""Why one line may show a gap that no band shows, in words."""
NO_MOMENT = 0.2
"""Share of the datasheet's polar inertia below which the stated speed is wrong: inertias are known better, and a speed
in rpm makes it 0.105."""
UNDECIDED = 0.5
"""Probability of a verdict where nothing can be said of the gap."""


def overall_verdict(
    found: Sequence[Explained],
    o: Observation,
    unseen: Observation,
    gap: float,
    sources: Sequence[Interference] = (),
    fault: str | None = None,
    swings: str | None = None,
    lines_only: bool = False,
    lost: LostLoop | None = None,
    tone: str | None = None,
    given: Verdict | None = None,
) -> Verdict:
    """The verdict on all parts ``found``.

    Parameters
    ----------
    gap
        Relative gap of the plain twin on the fitted sweep.
    fault
        What is wrong with the log, in words.
    swings
        That the response is modulated (`modulated_stiffness`), in words.
    lines_only
        Whether the unseen points are other lines of the fitted sweep.
    lost
        Where amplifiers lose their loop.
    tone
        Interference that no effect of the catalogue is (`unlisted_tone`), in words.
    given
        What is known of the gap otherwise, as from the twin's own effects: it is doubted, but does not follow from the
        parts.
    """
    if given is None:
        tests = {e.part.path: held_out(e, unseen) for e in found}
        if lines_only:
            tests = {e.part.path: between_lines(e, unseen, tests[e.part.path]) for e in found}
        verdict = verdict_of(found, tests, unseen)
        verdict = with_across(verdict, [a for e in found for a in across_alike(e)])
        if lost is not None and fault is None:
            verdict = named_limit(verdict, lost)
        verdict = with_sources(verdict, sources, found)
    else:
        verdict = given
    if fault is not None:
        verdict = Verdict("none_of_these", (), (), SURE_OF_NONE, (fault,))
    elif swings and verdict.kind == "no_gap":
        verdict = Verdict("none_of_these", (), (), SURE_OF_NONE, (f"plant: {swings}",), unexplained="plant")
    elif lost and verdict.kind != "none_of_these" and not any(CATALOGUE[name].nonlinear for name in verdict.effects):
        reasons = (f"amplifier: {lost.words}",)
        verdict = Verdict("none_of_these", (), (), SURE_OF_NONE, reasons, unexplained="amplifier")
    if tone is not None and fault is None:
        verdict = with_tone(verdict, tone)
    if (why := not_settled(o, gap)) and (verdict.kind != "no_gap" or drift_of(o) > TELLS_NOTHING):
        verdict = Verdict("none_of_these", (), (), UNDECIDED, (why,), settled=False)
    return verdict


def verdict_of(found: Sequence[Explained], there: Mapping[str, HeldOut], unseen: Observation) -> Verdict:
    """One verdict from those of the parts: an unexplained part outweighs what is explained in others.

    ``there`` has each part's test on unseen data, by path.
    """
    of_part = {e.part.path: _verdict_of_part(e, there[e.part.path], unseen) for e in found}
    by_size = sorted(found, key=lambda e: -excess_of(e))
    unknown = [
        e
        for e in by_size
        if of_part[e.part.path].kind == "none_of_these" and (of_part[e.part.path].another_rig or not _dwarfed(e, found))
    ]
    if unknown:
        another_rig = [e for e in unknown if of_part[e.part.path].another_rig]
        unknown = [*another_rig, *(e for e in unknown if e not in another_rig)]  # the others may fail for that reason
        reasons = tuple(f"{e.part.path}: {reason}" for e in unknown for reason in of_part[e.part.path].reasons)
        return replace(of_part[unknown[0].part.path], reasons=reasons, unexplained=unknown[0].part.path)
    named = [of_part[e.part.path] for e in by_size if of_part[e.part.path].effects]
    probability = float(np.prod([v.probability for v in of_part.values() if v.kind != "none_of_these"]))
    if not named:
        return Verdict("no_gap", (), (), probability, ())
    effects = tuple(name for v in named for name in v.effects)
    classes = tuple(group for v in named for group in v.indistinguishable)
    if not any(o.speed_rad_s for e in found for o in e.ground.observations):
        classes = with_exact_aliases(effects, classes)
    kind = "effect" if len(effects) == 1 else "effects"
    also = tuple(name for v in named for name in v.also_alike)
    beside = tuple(_small_gap(e, of_part[e.part.path]) for e in by_size if of_part[e.part.path].kind == "none_of_these")
    return Verdict(kind, effects, (), probability, (), also_alike=also, beside=beside).with_classes(classes)


def _small_gap(e: Explained, verdict: Verdict) -> str:
    """The gap of a part that no effect explains, too small beside the others' to be the verdict, in words."""
    return (
        f"the {e.part.path} has a small gap of its own, {100 * e.relative_gap:.2g} % of its signal: "
        f"{'; '.join(verdict.reasons)}. What is named elsewhere may leak into it: add that to the twin and diagnose "
        "again"
    )


def _verdict_of_part(e: Explained, there: HeldOut, unseen: Observation) -> Verdict:
    """The verdict on one part, doubts included."""
    plain = on_sweep(e, e.null.candidate, unseen)
    significant = max(e.significance, significance(plain[1], plain[0]))
    added_up = (max(map(overall, e.plain)), overall(plain[1]))
    at_few_lines = min(e.significance, gap_significance([plain[1]], [plain[0]]))
    verdict = decide(e.order, e.remaining, there, significant, e.elsewhere, added_up, at_few_lines)
    return _doubted(e, verdict, plain, unseen, there)


def _dwarfed(e: Explained, found: Sequence[Explained]) -> bool:
    """Whether a part's chi-square is negligible beside the excess of all parts: other parts may leak into it.

    The controller has hardly any noise, so that its excess would dwarf any other part: only its own part counts it.
    """
    total = sum(excess_of(other) for other in found if other.part.path != "controller" or other is e)
    return e.null.candidate.fit.chi_square <= NEGLIGIBLE * total


def _doubted(e: Explained, verdict: Verdict, plain: Seen, unseen: Observation, there: HeldOut) -> Verdict:
    """A part's verdict, or none of these where another test contradicts it.

    ``plain`` is the unseen sweep with the plain twin's residuals, ``there`` how the explanation fares on it.
    """
    if wrong := misstated(e, verdict, unseen):
        return Verdict("none_of_these", (), (), SURE_OF_NONE, (wrong,), misstated=True)
    explained = bool(verdict.effects)
    no_hysteresis = lag_missing(e) if explained else None
    reason = _nonlinear_cause(e, verdict, plain, unseen)
    if reason is None and explained:
        reason = changes_with_amplitude(e, unseen, there)
    if reason:
        reasons = (reason,) if no_hysteresis is None else (reason, no_hysteresis)
        verdict = Verdict("none_of_these", (), (), SURE_OF_NONE, reasons, nonlinear=True)
    # Amplifiers without an explanation bias their nuisance values, too, but that says nothing of the rotor.
    check_datasheet = explained or (e.part.path == "plant" and verdict.kind != "no_gap")
    check_datasheet = check_datasheet and not (verdict.effects and drawn_by_its_law(e.order[0], e.remaining))
    if check_datasheet and (away := far_off(e.ground, e.chosen.fit)):
        if not verdict.effects:  # then by the plain twin, whose values no effect biases
            away = far_off(e.ground, e.null.candidate.fit) or away
        return with_datasheet_off(verdict, away, e.relative_gap)
    if explained and verdict.effects and (body := free_body(e.ground, e.chosen.fit)):
        return with_datasheet_off(verdict, body, e.relative_gap)
    if verdict.nonlinear:
        return verdict
    doubt = _unexplained_line(e, plain) if verdict.kind == "no_gap" else no_hysteresis or _wrong_speed(e, verdict)
    if doubt:
        return Verdict("none_of_these", (), (), SURE_OF_NONE, (doubt,))
    if not explained:
        return verdict
    alike = curved_alike(e, plain, on_sweep(e, e.chosen, unseen))
    return replace(verdict, also_alike=(*verdict.also_alike, *alike))


def _wrong_speed(e: Explained, verdict: Verdict) -> str | None:
    """That the rotor shows hardly any of its datasheet's gyroscopic moment at the stated speed, in words; or None."""
    stated = e.ground.nuisance.rig.rotor.whole_polar_inertia_kgm2
    if "gyroscopic_coupling" not in verdict.effects or not stated:
        return None
    share = e.chosen.fit.rig.rotor.whole_polar_inertia_kgm2 / stated
    speed = max((o.speed_rad_s for o in e.ground.observations), key=abs)
    if share > NO_MOMENT:
        return None
    return (
        f"the rotor shows {share:.2g} times the gyroscopic moment of its datasheet at the stated {speed:.4g} rad/s, "
        "which no rotor has: does it turn, and is speed_rad_s in rad/s, not in rpm, and positive from x to y?"
    )


def _nonlinear_cause(e: Explained, verdict: Verdict, plain: Seen, unseen: Observation) -> str | None:
    """A nonlinear cause of a part's gap that is no effect of the catalogue, in words; or None."""
    best = on_sweep(e, e.chosen, unseen)
    if verdict.kind != "no_gap":
        for instead in (curved_instead, changing_instead):
            if reason := instead(e, plain, best):
                return reason
    # Where nothing was found, or an effect leaves much, a matched filter on the residuals shows more.
    look_closer = verdict.kind == "no_gap" or (verdict.effects and e.order[0].unexplained > MAX_SHARE_LEFT)
    return curved_signal(e, best) if look_closer else None


def _unexplained_line(e: Explained, plain: Seen) -> str | None:
    """That a part without an effect shows a gap in one line, where a limit would show first, in words; or None."""
    sweeps = [plain, *zip(e.ground.observations, e.plain, strict=True)]
    at_hz = next((hz for o, z in sweeps if (hz := alone_hz(e.part, z, o)) is not None), None)
    return None if at_hz is None else f"no effect explains the gap at {at_hz:.3g} Hz, {SHOWS_FIRST[e.part.path]}"


def with_exact_aliases(effects: Sequence[str], classes: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Alias classes with the exact aliases at standstill of the named effects.

    >>> with_exact_aliases(["modal_damping"], [])
    (('modal_damping', 'internal_damping'),)
    """
    out = []
    for name in effects:
        group = next((g for g in classes if name in g), (name,))
        group = tuple(alias for n in group for alias in (n, STANDSTILL.get(n)) if alias is not None)
        out += [group] if len(group) > 1 else []
    return tuple(out)


def with_tone(verdict: Verdict, tone: str) -> Verdict:
    """The verdict with interference that no effect of the catalogue is, in words.

    It is none of these where nothing else is wrong. Effects stand beside it: it has been taken off what they explain.
    """
    if verdict.effects:
        return verdict
    reasons = (*verdict.reasons, f"signals: {tone}")
    if verdict.kind == "none_of_these":
        return replace(verdict, reasons=reasons)
    return Verdict("none_of_these", (), (), SURE_OF_NONE, reasons, unexplained="additive")


def with_across(verdict: Verdict, alike: Sequence[Across]) -> Verdict:
    """The verdict with couplings of x and y that data of one plane cannot distinguish from its effects."""
    if not alike:
        return verdict
    if verdict.kind == "none_of_these":
        also = (f"with two axes, {a.words} would look like it" for a in alike)
        return replace(verdict, reasons=(*verdict.reasons, *also))
    of_plant = [name for name in verdict.effects if CATALOGUE[name].path == "plant"]
    if len(of_plant) != 1:
        return verdict
    group = next((g for g in verdict.indistinguishable if of_plant[0] in g), (of_plant[0],))
    others = tuple(g for g in verdict.indistinguishable if of_plant[0] not in g)
    wider = (of_plant[0], *(a.effect for a in alike), *(name for name in group if name != of_plant[0]))
    return verdict.with_classes((wider, *others))


def drift_of(o: Observation) -> float:
    """Relative change from first block to last, rms over the drifting points."""
    change = o.drift[o.drifting]
    return float(np.sqrt(np.mean(change**2))) if len(change) else 0.0


def not_settled(o: Observation, gap: float) -> str | None:
    """Why nothing can be said of a gap: most points drift, by more than an effect may leave of it; or None."""
    if o.unsettled <= UNSETTLED:
        return None
    change = o.drift[o.drifting]
    if drift_of(o) < MAX_SHARE_LEFT * gap:
        return None
    return (  # the median, as points of small amplitude have large relative drifts
        f"the rig did not settle: {100 * o.unsettled:.0f} % of the points still drift from block to block, half of "
        f"them by more than {100 * np.median(change):.2g} %; let it settle longer before each point and measure again"
    )
