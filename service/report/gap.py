"""The report of a gap diagnosis: where the twin differs from the rig, which effect does it, how far the gap shrinks."""

from __future__ import annotations

import json
from html import escape
from typing import Any

from service.gap.diagnosis import Diagnosis
from service.gap.document import alike, gap_document, likeliest, parameters_used, path_in_words
from service.gap.measured.observation import MODEL_FLOOR
from service.gap.weighing.significance import SIGNIFICANT
from service.report import gap_figures as draw
from service.report.format import MISSING, count, fixed, number, paragraph, quantity, table
from service.report.gap_discrepancy import discrepancy_figure
from service.report.gap_loop import loop_parts
from service.report.page import Captioned, Page, Section, Tone
from sim.effects import CATALOGUE
from sim.wording import in_words

SHOWN = 3
"""Explanations whose parameters are open; the others are folded away."""
Part = str | Captioned
TONES: dict[str, Tone] = {"no_gap": "good", "effect": "warn", "effects": "warn", "none_of_these": "bad"}


def gap_page(diagnosis: Diagnosis) -> str:
    """The report as one self-contained HTML file."""
    document = gap_document(diagnosis)
    verdict = document["verdict"]
    axes = diagnosis.null.fit.rig.axes
    before, after = diagnosis.null.fit.rig, diagnosis.chosen.fit.rig
    unseen = draw.compared(before, after, diagnosis.held_out)
    fitted = draw.compared(before, after, diagnosis.observation)
    path = document["where"]["path"]
    sections = [
        Section("How far", _how_far(document, unseen)),
        Section("Where", _where(document, fitted, path, axes)),
        Section("Which", _which(diagnosis, document)),
        Section("Amplitude and harmonics", _amplitude(diagnosis, document, fitted, unseen, path)),
        Section("What it means for the loop", loop_parts(document)),
        Section("Next experiment", _next(document)),
    ]
    about = (
        f"{', '.join(axes)}; fitted on {count(len(diagnosis.observation.axis), 'point')}, judged on "
        f"{count(len(diagnosis.held_out.axis), 'point')} of {document['shrinkage']['held_out']} that no fit has seen"
    )
    footer = (
        "The twin is the datasheet's, its uncertain values refitted within their tolerances (before), then with the "
        "effect that the verdict names (after). Residuals are in units of the noise of each value."
    )
    return Page(
        f"Gap between rig {diagnosis.rig} and its twin",
        about,
        verdict["sentence"],
        "warn" if document["datasheet_off"] and verdict["kind"] == "no_gap" else TONES[verdict["kind"]],
        document["notes"],
        sections,
        footer,
    ).html()


def _how_far(document: dict[str, Any], unseen: draw.Compared) -> list[Part]:
    s, gap = document["shrinkage"], document["gap"]
    low, high = s["closure_95"]
    runner = s["runner_up"]
    rows = [
        ["relative gap on unseen data, before", f"{100 * gap['before']:.3g} %"],
        ["the same of what counts as noise", f"{100 * gap['noise_floor']:.3g} %"],
        ["residual over noise, mean square, before", number(s["before"], 4)],
        ["after", number(s["after"], 4)],
        ["of a right twin", number(s["noise_floor"], 4)],
    ]
    if document["verdict"]["effects"]:
        rows.append(["closure", f"{_percent(s['closure'])} (95 %: {_percent(low)} to {_percent(high)})"])
        if runner is not None:
            rows.append(
                [f"closure of the runner-up, {in_words('+'.join(runner['effects']))}", _percent(runner["closure"])]
            )
    caption = "Distance of measured and twin, all axes together, line by line on the sweep that no fit has seen."
    counted = (
        f"What counts as noise is what the blocks of a point scatter, with {100 * MODEL_FLOOR:.2g} % of each value for "
        "what no twin gets right, and with all that one block scatters near a flexible mode: a twin that is right may "
        "come nearer than that."
    )
    parts: list[Part] = [table(["", document["shrinkage"]["held_out"]], rows), paragraph(counted)]
    if document["verdict"]["effects"] and s["paths"]:
        parts.append(_closed_by(s))
    return [*parts, Captioned(draw.gap_figure(unseen), caption)]


def _closed_by(s: dict[str, Any]) -> str:
    """Closure of every path, then of the channels that show a gap."""
    shown = [c for c in s["channels"] if c["closure"] is not None]

    def row(name: str, c: dict[str, Any]) -> list[str]:
        low, high = c["closure_95"]
        told = MISSING if c["closure"] is None else f"{_percent(low)} to {_percent(high)}"
        return [name, number(c["before"], 4), number(c["after"], 4), _percent(c["closure"]), told]

    head = ["residual over noise, mean square", "before", "after", "closure", "95 %"]
    found = [table(head, [row(p["path"], p) for p in s["paths"]])]
    if shown:
        rows = [row(f"{c['signal']} {c['output']} from {c['input']}", c) for c in shown]
        channels = table(["channel", *head[1:]], rows)
        found.append(f"<details><summary>{count(len(shown), 'channel')} that show a gap</summary>{channels}</details>")
    return "".join(found)


def _where(document: dict[str, Any], fitted: draw.Compared, path: str, axes: tuple[str, ...]) -> list[Part]:
    where = document["where"]
    rows = [
        [
            p["path"] + ("" if p.get("logged", True) else " (amplifier included)"),
            _percent(p["gap"], 3),
            _deviations(p["significance"]),
        ]
        for p in where["paths"]
    ]
    words = [_depends(where[f"{condition}_dependent"], condition) for condition in ("amplitude", "speed")]
    if (change := where["dependence_significance"]) is not None:
        words.append(f"Between the two sweeps the relative error changes by {_deviations(change)} standard deviations.")
        if where["amplitude_dependent"] and change <= SIGNIFICANT:
            words.append("That it depends on the amplitude is told by harmonics of the excitation.")
    return [
        table(["block of the loop", "gap by itself", "significance, standard deviations"], rows),
        paragraph(" ".join(words)),
        Captioned(
            draw.ratio_figure(fitted, path, axes),
            f"The excited axis's own signal in the {path_in_words(path)}, measured over the twin before; bars are "
            "99 %. " + ("The blue line is what the verdict's effect makes of it." if fitted.changed else ""),
        ),
        Captioned(
            draw.heat_figure(fitted, axes),
            "Residual over noise (rms) by signal and band, on the fitted sweep. One is noise.",
        ),
        Captioned(
            draw.channel_figure(fitted, path, axes),
            f"The same in the {path_in_words(path)} by output and excited axis.",
        ),
    ]


def _depends(found: bool | None, condition: str) -> str:
    if found is None:
        return f"Whether it depends on the {condition} was not tested."
    return f"It {'depends' if found else 'does not depend'} on the {condition}, as far as these data tell."


def _which(d: Diagnosis, document: dict[str, Any]) -> list[Part]:
    verdict = document["verdict"]
    parts: list[Part] = []
    for name in verdict["effects"]:
        effect = CATALOGUE[name]
        acts = f"{in_words(name)} acts in the {path_in_words(effect.path)}: {effect.law}."
        parts.append(paragraph(f"{acts} Its signature: {effect.signature}."))
    _, unlikely = alike(d)
    for group in verdict["indistinguishable"]:
        left = [g for g in group if g not in unlikely]
        if len(left) > 1:
            names = ", ".join(in_words(g) for g in left)
            parts.append(paragraph(f"These data cannot tell apart: {names}. {_separated(left)}", "note"))
        for other in (g for g in group if g in unlikely):
            told = f"{in_words(other)} fits about as well as {in_words(left[0])} but is far less likely."
            parts.append(paragraph(f"{told} What separates them: {_separated([left[0], other])}"))
    parts += [paragraph(f"Why: {r}.") for r in verdict.get("reasons", ())]
    if document["discrepancy"]:
        parts.append(
            Captioned(
                discrepancy_figure(document["discrepancy"]),
                "What is missing, without a law: error of the twin over the measured signal of the excited axis, of "
                "the most significant channels. Where both amplitudes have the same, it is in proportion to them.",
            )
        )
    bars = draw.candidate_figure(d, document)
    if bars is None:
        return [*parts, paragraph("No effect of the catalogue could be fitted.")]
    parts.append(
        Captioned(
            bars,
            "The likeliest explanations: probability among those of the part, where the first sentence counts a "
            "whole alias class and all parts, and share of the gap that each closes. "
            "Of one that grows with amplitude, and that the fitted data do not show, nothing tells what it closes.",
        )
    )
    candidates = likeliest(document)
    parts.append(_parameters(candidates[:SHOWN]))
    if rest := candidates[SHOWN:]:
        parts.append(f"<details><summary>The other explanations</summary>{_parameters(rest)}</details>")
    return parts


def _separated(group: list[str]) -> str:
    return "; ".join(f"{in_words(g)} by {CATALOGUE[g].separated_by}" for g in group if g in CATALOGUE) + "."


def _gap_after(candidate: dict[str, Any]) -> float | None:
    """The gap that an explanation leaves of the unseen sweep; None where its strength there is anybody's guess."""
    told = not candidate["open_strength"] or candidate["closure"] is not None
    return candidate["gap_after"] if told else None


def _parameters(candidates: list[dict[str, Any]]) -> str:
    """Fitted parameters, one row each; the first row of a candidate names it."""
    rows = []
    for c in candidates:
        head, tail = in_words(c["effect"]), [_percent(_gap_after(c), 3), number(c["log_evidence"], 6)]
        for name, e in parameters_used(c).items():
            effect, _, parameter = name.rpartition(".")
            p = next(p for p in CATALOGUE[effect or c["effects"][0]].parameters if p.name == parameter)
            value, std = quantity(e["value"], e["std"] or float("inf"), p.unit)
            if e["at_bound"]:
                std = f"{e['at_bound']} end of range"
            if e.get("given"):
                std = "given"
            rows.append([head, f"{in_words(effect)}: {p.words}" if effect else p.words, value, std, *tail])
            head, tail = "", ["", ""]
    found = table(["explanation", "parameter", "value", "std. dev.", "gap after", "log evidence"], rows, left=2)
    if any(e["at_bound"] for c in candidates for e in parameters_used(c).values()):
        found += paragraph("At an end of its range a value is where the fit had to stop, and not measured.", "small")
    return found


def _amplitude(
    d: Diagnosis, document: dict[str, Any], fitted: draw.Compared, unseen: draw.Compared, path: str
) -> list[Part]:
    cases = [("fitted sweep", fitted), (f"unseen, {document['shrinkage']['held_out']}", unseen)]
    parts: list[Part] = [
        Captioned(
            draw.amplitude_figure(cases, path),
            f"Difference from the twin in the {path_in_words(path)} against the current of the excited axis. A gap "
            "that grows with the current at a given frequency is a nonlinear one.",
        )
    ]
    harmonics = draw.harmonic_figure(d)
    if harmonics is not None:
        parts.append(
            Captioned(
                harmonics,
                "Harmonics beyond those of the twin's own magnets: in i they point to the amplifier, in y with a "
                "clean i to magnet, contact or sensor. The dashed line is the threshold of "
                f"{SIGNIFICANT:g} standard deviations, above which a harmonic counts; bars end at "
                f"{draw.LONGEST_BAR:g}.",
            )
        )
    return parts


def _next(document: dict[str, Any]) -> list[Part]:
    found = document["next_experiment"]
    if not found:
        left = document["verdict"]["indistinguishable"]
        if left:
            text = "No affordable experiment is likely to tell apart what is left together."
        elif document["verdict"]["kind"] == "none_of_these":
            text = (
                "None is proposed, as no effects of the catalogue are left to be told apart. Put right what the first "
                "sentence names, or look at the residuals above, then diagnose again."
            )
        else:
            text = "Nothing is left that an experiment would have to tell apart."
        return [paragraph(text)]
    a, b = (in_words(x) for x in found["separates"])
    parts: list[Part] = [
        paragraph(
            f"To tell {a} from {b}: {found['description']}. Predicted distance {number(found['distance_sd'], 3)} "
            f"standard deviations, odds of telling them apart {_percent(found['odds_of_telling_apart'])}."
        )
    ]
    if "rig_seconds" in found:
        parts.append(paragraph(f"It takes about {number(found['rig_seconds'], 3)} s of the rig."))
    parts += [paragraph(f"Before, by hand: {step}.") for step in found.get("by_hand", ())]
    if "command" in found:
        command = escape(found["command"])
        job = escape(json.dumps(found["job"]))
        parts.append(f"<p>Submit it: <code>{command}</code></p><p>or POST /api/v1/jobs: <code>{job}</code></p>")
    others = [
        [in_words(x["experiment"]), number(x["distance_sd"], 3), number(x.get("rig_seconds", float("nan")), 3)]
        for x in found.get("alternatives", ())
    ]
    if others:
        parts.append(table(["alternatives", "distance, standard deviations", "rig time, s"], others))
    tones = [
        [t.get("sweep", "main"), t["axis"], number(t["frequency_hz"], 5), number(t["amplitude_a"], 3)]
        for t in found["tones"]
    ]
    submit = table(["sweep", "axis", "Hz", "r, A"], tones)
    parts.append(f"<details><summary>{count(len(tones), 'tone')}</summary>{submit}</details>")
    return parts


def _deviations(significance: float | None) -> str:
    """Standard deviations; beyond a thousand of them, that they are more."""
    return "over 1000" if significance is not None and significance >= 1000 else fixed(significance, 1)


def _percent(share: float | None, digits: int = 3) -> str:
    return MISSING if share is None else f"{100 * share:z.{digits}g} %"
