"""The report of a commissioning: one page that says what the rig is, how well that is known, and how it was found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape

import numpy as np

from service.experiment.data import Experiment
from service.experiment.speeds import at_standstill
from service.identification.loop.margins import Margin
from service.identification.priors.tolerances import STRAINED
from service.identification.result.commissioning import UNKNOWN, CommissioningResult, PlaneResult
from service.identification.result.parts import ModeResult
from service.report import measurement
from service.report.format import MISSING, count, decibel, figures, fixed, number, paragraph, signed, span, table
from service.report.page import Captioned, Page, Section, Tone
from service.report.plane import plane_section
from service.report.rotating import rotating_section
from sim.datasheet import Datasheet, calm_zones, source_of
from sim.folded import folded
from sim.wording import in_words, times

GOOD_PERCENT = 90.0
"""NRMSE above which a model is called good."""
POOR_PERCENT = 50.0
"""NRMSE below which it is not to be believed: a model that says nothing but the mean has 0."""
MARGINS = [
    "loop",
    "peak |S|, dB",
    "at, Hz",
    "measured, dB",
    "gain margin, dB",
    "phase margin, deg",
    "delay margin, µs",
    "zone",
]


def commissioning_page(result: CommissioningResult, experiment: Experiment, datasheet: Datasheet) -> str:
    """The report as one self-contained HTML file.

    Parameters
    ----------
    result
        What was identified.
    experiment
        What it was identified from.
    datasheet
        What was known before.
    """
    datasheet = folded(datasheet).datasheet
    sections = [_figures_of_merit(result)]
    sections += [plane_section(plane, experiment, datasheet) for plane in result.planes.values()]
    if result.rotating is not None:
        sections.append(rotating_section(result.rotating))
    sections.append(_measurement(experiment, datasheet))
    tone, sentence = verdict(result)
    notes = [*result.warnings]
    for name, plane in result.planes.items():
        own = [w for w in plane.warnings if " Hz: " not in w]
        notes += [f"{name}-plane: {w}" for w in own]
    n = sum(s.n_points for s in experiment.sweeps)
    rig_s = experiment.rig_seconds
    about = f"{', '.join(result.axes)}; {count(n, 'point')}" + (f" in {rig_s / 60:.0f} min on the rig" if rig_s else "")
    footer = (
        f"Fitted: {result.main_sweep}. Unseen by every fit: {result.validation_sweep or 'none'}. "
        "Regions and tests are at 99 %; std. dev. is one sigma."
    )
    return Page(f"Commissioning of rig {result.rig}", about, sentence, tone, notes, sections, footer).html()


def verdict(result: CommissioningResult) -> tuple[Tone, str]:
    """The sentence that says the result, and how good the news are."""
    tone, text = _of_the_planes(result)
    turned = result.rotating
    if turned is None:
        return tone, text
    if turned.uncertainty.adequate:
        if not at_standstill(result.speed_rad_s) and not all(p.adequate for p in result.planes.values()):
            text += " The model of the turning rotor has what the planes lack, and describes every speed to the noise."
        return tone, text
    return "warn" if tone == "good" else tone, (
        f"{text} The turning rotor does not behave as its model: over all speeds the residuals are "
        f"{times(turned.uncertainty.scale)} times the noise."
    )


def _of_the_planes(result: CommissioningResult) -> tuple[Tone, str]:
    """The same without what is known of the rotor at speed."""
    planes = list(result.planes.values())
    worst, relative = result.worst_fit_percent, result.stiffness_uncertainty
    where = "a sweep that no fit has seen" if result.unseen else "the data that it was fitted to"
    ki = [p.stiffness[k].value for p in planes for k in ("kiA", "kiB")]
    ks = [p.stiffness[k].value / 1e6 for p in planes for k in ("ksA", "ksB")]
    loudest = max(planes, key=lambda p: p.worst_peak)
    peak, zone = loudest.worst_peak, loudest.zone(loudest.worst_peak)
    worst_percent = f"{math.floor(100 * worst) / 100:.2f} % NRMSE"
    unclear = next((p for p in planes if p.beyond_measured), None)
    in_zone = (
        f"zone {zone}{_standard(loudest)}"
        if unclear is None
        else f"its zone not known: in the {unclear.plane}-plane {unclear.beyond_measured}"
    )
    given = "" if result.adjusted else " with the datasheet's mass, geometry and sensor gains"
    figures_found = (
        f"ki is {span(ki)} N/A and ks {span(ks)} MN/m, each known to {number(100 * relative, 2)} % (one sigma){given}; "
        f"the loop's sensitivity peaks at {decibel(peak):.1f} dB, {in_zone}."
    )
    if not result.identified:
        known = "" if relative < UNKNOWN else "; some stiffness is known to no more than its own size"
        return "bad", (
            f"The rig {result.rig!r} is not identified: the model agrees with {where} by {worst_percent} in its worst "
            f"entry, where 0 % is no model at all{known}. Its figures say nothing: check that the datasheet is of this "
            "rig and its units, and the signs and units of the logged signals, by the notes."
        )
    if wrong := [p for p in planes if not p.adequate]:
        names = " and ".join(f"{p.plane}-plane" for p in wrong)
        size = max(p.residual_rms_total for p in wrong)
        told = (
            f"the residuals are {times(size)} times the noise"
            if size > 1  # otherwise in units of noise and that error together
            else "there is an error of the model that had to be allowed for beside the noise"
        )
        return ("warn" if worst > GOOD_PERCENT else "bad"), (
            f"The rig {result.rig!r} does not behave as its model: in the {names} {told}, so something acts that the "
            f"model does not have. It agrees with {where} by {worst_percent} in its worst entry; with that reserve, "
            f"{figures_found}"
        )
    if worst < POOR_PERCENT:
        return "bad", (
            f"The rig {result.rig!r} is not identified well enough to be believed: the model agrees with {where} by "
            f"{worst_percent} only in its worst entry; with that reserve, {figures_found}"
        )
    text = (
        f"The rig {result.rig!r} is identified: the model agrees with {where} by {worst_percent} or better in every "
        f"entry; {figures_found}"
    )
    if strained := [a for a in result.adjusted if abs(a.off) > STRAINED]:
        farthest = max(strained, key=lambda a: abs(a.off))
        text += (
            f" The {farthest.in_words} is {abs(farthest.off):.1f} tolerances from the datasheet's value: where that is "
            "wrong rather than loose, ki and ks may be off by as much, and their deviations do not allow for it."
        )
    if result.controller_differs:
        text += (
            " The log does not hold the control law of the datasheet, though, of which the loop's peak and its zone "
            "are: another controller ran, or a signal is not logged as it had it."
        )
    if off := max(p.off_unseen for p in planes):
        return "warn", (
            f"{text} On the unseen sweep the residuals are up to {times(off)} times the noise, though: the model does "
            "not hold there, and its deviations do not allow for it."
        )
    if not all(p.tests_passed for p in planes):
        return "warn", f"{text} The residuals are of the size of the noise, but not white: see the residual tests."
    calm = unclear is None and zone in calm_zones(loudest.zones_db)
    doubtful = strained or result.controller_differs
    return ("good" if calm and worst > GOOD_PERCENT and not doubtful else "warn"), text


def _standard(plane: PlaneResult) -> str:
    return f" of {source_of(plane.zones_db)}"


def _figures_of_merit(result: CommissioningResult) -> Section:
    """The tables that everyone looks for first."""
    stiffness, modes, margins = [], [], []
    for name, plane in result.planes.items():
        for key in ("kiA", "kiB", "ksA", "ksB"):
            e = plane.stiffness[key]
            value, std = figures(e.value, e.std)
            quantity = f"{key[:2]} {name}{key[2]}, {e.unit}"
            stiffness.append([quantity, value, std, number(e.nominal), signed(e.error_percent, 1)])
        modes += [_mode(name, m) for m in plane.modes if m.kind == "rotor"]
        margins += list(_margins(name, plane))
    parts = [
        '<div class="side">',
        table(
            ["stiffness", "identified", "std. dev.", "datasheet", "datasheet off by, %"],
            stiffness,
        ),
        table(["flexible mode", "ωn, rad/s", "std. dev.", "Hz", "ζ", "std. dev."], modes)
        if modes
        else paragraph("No flexible mode shows in the measured band."),
        table(
            MARGINS,
            margins,
        ),
        "</div>",
        paragraph(
            "ki: force-current factor; ks: position stiffness, positive destabilises; ωn and ζ: of the free rotor, "
            "without bearings. The zone is that of ISO 14839-3, or of the datasheet's own limits, by the "
            "model's peak, or by a measured one that is larger beyond its noise; a measured peak is at a measured line "
            "that had settled, and so at most the true one. Margins are of one axis' loop with the others closed: of "
            "what comes to all axes at once, as by a controller that computes longer, the loop may bear less (ambit "
            "check-controller tells). They are the model's; those of the measured sensitivity itself, straight between "
            "its lines, in brackets. Zone and margins are of the rotor at the speed at which it was measured, without "
            "gyroscopic coupling: at another speed they are not known, unless it was measured there, too (ambit "
            "check-controller).",
            "small",
        ),
        *_adjusted(result),
        *_known_effects(result),
    ]
    return Section("Result", parts)


def _adjusted(result: CommissioningResult) -> Iterator[str]:
    """What is held in place of the datasheet's values."""
    if result.adjusted:
        rows = [
            [
                ", ".join(filter(None, (a.in_words, a.unit))),
                *figures(a.value, a.std),
                number(a.datasheet, 6),
                number(a.tolerance, 2),
                f"{a.off:+.1f}",
            ]
            for a in result.adjusted
        ]
        head = [
            "held within the datasheet's tolerances",
            "value",
            "std. dev.",
            "datasheet",
            "tolerance",
            "tolerances off",
        ]
        yield table(head, rows)
        yield paragraph(
            "Mass, geometry and sensor gains are the datasheet's where these explain the data. Here they do not, and "
            "these, each as likely as its tolerance says, do. Positions are changes: the centre of gravity towards A, "
            "sensors away from it. "
            "A standard deviation close to the tolerance says that the data tell nothing of the value.",
            "small",
        )
    else:
        yield paragraph(
            "Mass, geometry and sensor gains are the datasheet's, and standard deviations are those with these given. "
            "No sweep tells a mass from ki and ks, nor a gain of all sensors from ki: by as much as these are off, so "
            "are those.",
            "small",
        )


def _known_effects(result: CommissioningResult) -> Iterator[str]:
    """What the twin names beside the datasheet's values, and where the model has it."""
    if result.known_effects:
        rows = [
            [
                in_words(e.effect),
                ", ".join(f"{name} {number(value, 4)}" for name, value in e.parameters),
                "; ".join(e.in_model) or MISSING,
                "; ".join(e.not_in_model) or MISSING,
            ]
            for e in result.known_effects
        ]
        yield table(["effect that the twin names", "parameters", "in the model", "not in the model"], rows, left=4)


def _mode(plane: str, m: ModeResult) -> list[str]:
    w, w_std = figures(m.natural_frequency_rad_s.value, m.natural_frequency_rad_s.std)
    zeta, zeta_std = figures(m.damping_ratio.value, m.damping_ratio.std)
    return [f"{plane}-plane", w, w_std, f"{m.natural_frequency_rad_s.value / (2 * np.pi):.3f}", zeta, zeta_std]


def _margins(name: str, plane: PlaneResult) -> Iterator[list[str]]:
    for axis, m in plane.margins.items():
        gain = " / ".join(_with_std(g, 1.0, 1) for g in (m.gain_down_db, m.gain_up_db))
        std_db = 20 / np.log(10) * m.peak_std / m.sensitivity_peak
        yield [
            f"{name}{axis}",
            " ± ".join(figures(20 * float(np.log10(m.sensitivity_peak)), float(std_db))),
            fixed(m.peak_hz, 1),
            fixed(decibel(m.measured_peak), 2),
            gain,
            _with_std(m.phase_deg, 1.0, 1),
            _with_std(m.delay_s, 1e6, 0),
            plane.zone(m.worst),
        ]


def _with_std(margin: Margin, unit: float, digits: int) -> str:
    """The model's margin with its deviation, and the measured one in brackets."""
    if margin.value is None or margin.std is None:
        return MISSING
    value, std = figures(unit * margin.value, unit * margin.std)
    seen = "" if margin.measured is None else f" ({fixed(unit * margin.measured, digits)})"
    return f"{value} ± {std}{seen}"


def _measurement(experiment: Experiment, datasheet: Datasheet) -> Section:
    parts: list[str | Captioned] = [
        measurement.sweep_table(experiment),
        measurement.flag_table(experiment),
        Captioned(
            measurement.amplitude_figure(experiment, datasheet),
            "Amplitude of the excitation, and the largest displacement and current of any axis at that frequency.",
        ),
    ]
    noise = measurement.noise_figure(experiment)
    if noise is not None:
        parts.append(Captioned(noise, "Amplitude density without excitation, with the loop closed."))
    controller = experiment.attributes.get("controller")
    if controller:
        parts.append(f'<p class="small">Controller: {escape(controller)}</p>')
    return Section("Measurement", parts)
