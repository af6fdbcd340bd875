"""The report of a commissioning: one page that says what the rig is, how well that is known, and how it was found."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from service.experiment.data import Experiment
from service.identification.margins import zone
from service.identification.result import CommissioningResult, ModeResult, PlaneResult
from service.report import bode, measurement, residuals
from service.report.format import count, decibel, figures, fixed, number, paragraph, signed, span, table
from service.report.page import Captioned, Page, Section, Tone
from sim.datasheet import Datasheet

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
    sections = [_figures_of_merit(result)]
    sections += [_plane(plane, experiment, datasheet) for plane in result.planes.values()]
    sections.append(_measurement(experiment, datasheet))
    tone, sentence = verdict(result)
    notes = [*result.warnings]
    for name, plane in result.planes.items():
        own = [w for w in plane.warnings if " Hz: " not in w]
        notes += [f"{name}-plane: {w}" for w in own]
    n = sum(s.n_points for s in experiment.sweeps)
    rig_s = experiment.attributes.get("rig_seconds")
    about = f"{', '.join(result.axes)}; {count(n, 'point')}" + (
        f" in {float(rig_s) / 60:.0f} min on the rig" if rig_s else ""
    )
    footer = (
        f"Fitted: {result.main_sweep}. Unseen: {result.validation_sweep or 'none'}. "
        "Regions and tests are at 99 %; std. dev. is one sigma."
    )
    return Page(f"Commissioning of rig {result.rig}", about, sentence, tone, notes, sections, footer).html()


def verdict(result: CommissioningResult) -> tuple[Tone, str]:
    """The sentence that says the result, and how good the news are."""
    planes = list(result.planes.values())
    unseen = [p.cross_validation_fit_percent for p in planes if p.cross_validation_fit_percent is not None]
    fits = unseen if len(unseen) == len(planes) else [p.fit_percent for p in planes]
    worst = min(float(np.min(f)) for f in fits)
    where = "a sweep that no fit has seen" if fits is unseen else "the data that it was fitted to"
    ki = [p.stiffness[k].value for p in planes for k in ("kiA", "kiB")]
    ks = [p.stiffness[k].value / 1e6 for p in planes for k in ("ksA", "ksB")]
    relative = max(p.stiffness[k].std / abs(p.stiffness[k].value) for p in planes for k in p.stiffness)
    peak = max(_worst_peak(p) for p in planes)
    text = (
        f"The rig {result.rig!r} is identified: the model agrees with {where} by {worst:.1f} % NRMSE or better in "
        f"every entry; ki is {span(ki)} N/A and ks {span(ks)} MN/m, each known to "
        f"{number(100 * relative, 2)} % (one sigma); "
        f"the loop's sensitivity peaks at {decibel(peak):.1f} dB, zone {zone(peak)} of ISO 14839-3."
    )
    if not all(p.adequate for p in planes):
        names = " and ".join(f"{p.plane}-plane" for p in planes if not p.adequate)
        rms = max(p.residual_rms_total for p in planes if not p.adequate)
        text += (
            f" But the residuals of the {names} are {number(rms, 2)} times the noise: something acts on this rig that "
            "the model does not have. Uncertainties are widened accordingly."
        )
        return ("warn" if worst > 80 else "bad"), text
    if not all(p.tests_passed for p in planes):
        text += " The residuals are of the size of the noise, but not white: see the residual tests."
        return "warn", text
    return ("good" if peak < 10 ** (12 / 20) and worst > 90 else "warn"), text


def _worst_peak(plane: PlaneResult) -> float:
    return max(max(m.sensitivity_peak, m.measured_peak or 0.0) for m in plane.margins.values())


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
            "without bearings. The zone is that of ISO 14839-3 by the larger of the model's and the measured peak; a "
            "measured peak is at a measured line and so at most the true one.",
            "small",
        ),
    ]
    return Section("Result", parts)


def _mode(plane: str, m: ModeResult) -> list[str]:
    w, w_std = figures(m.natural_frequency_rad_s.value, m.natural_frequency_rad_s.std)
    zeta, zeta_std = figures(m.damping_ratio.value, m.damping_ratio.std)
    return [f"{plane}-plane", w, w_std, f"{m.natural_frequency_rad_s.value / (2 * np.pi):.3f}", zeta, zeta_std]


def _margins(name: str, plane: PlaneResult) -> Iterator[list[str]]:
    for axis, m in plane.margins.items():
        peak = max(m.sensitivity_peak, m.measured_peak or 0.0)
        gain = " / ".join(signed(g, 1) for g in m.gain_margin_db)
        delay = None if m.delay_margin_s is None else 1e6 * m.delay_margin_s
        std_db = 20 / np.log(10) * m.peak_std / m.sensitivity_peak
        yield [
            f"{name}{axis}",
            " ± ".join(figures(20 * float(np.log10(m.sensitivity_peak)), float(std_db))),
            fixed(m.peak_hz, 1),
            fixed(decibel(m.measured_peak), 2),
            gain,
            fixed(m.phase_margin_deg, 1),
            fixed(delay, 0),
            zone(peak),
        ]


def _plane(plane: PlaneResult, experiment: Experiment, datasheet: Datasheet) -> Section:
    parts: list[str | Captioned] = [_fits(plane)]
    inside = bode.inside_99_percent(plane)
    parts += [
        Captioned(
            bode.plant_figure(plane, output),
            f"Plant from control current to displacement {plane.axes[output]}. Below: distance between measured points "
            f"and model, relative to the model, at the amplitude of each point; {inside:.1f} % of all points of the "
            "plane lie within the 99 % radius of their own noise.",
        )
        for output in range(2)
    ]
    amplifiers = bode.amplifier_figure(plane, datasheet.sample_time_s, datasheet.computing_delay_s)
    if amplifiers is not None:
        parts.append(Captioned(amplifiers, "Amplifiers: coil current over control current, as sampled."))
    parts.append(_amplifiers(plane))
    parts.append(
        Captioned(
            bode.staged_figure(plane),
            "The thesis's steps, which only give the joint fit its start: rigid rotor below "
            f"{plane.staged.split_hz:.0f} Hz, flexible modes for what it leaves, both stacked.",
        )
    )
    parts.append(
        Captioned(
            bode.sensitivity_figure(plane, experiment, datasheet),
            "Sensitivity of the running loop; dashed: upper limits of the zones A, B and C of ISO 14839-3.",
        )
    )
    parts.append(
        Captioned(
            residuals.pole_figure(plane),
            "Poles and transmission zeros of the levitated plant without controller, all of them and each "
            "flexible pole with its 99 % region. Real poles come in pairs, one of each unstable.",
        )
    )
    parts.append(f"<details><summary>Poles in figures</summary>{residuals.pole_table(plane)}</details>")
    passed = (
        "All stay within what white noise does" if plane.tests_passed else "Not all stay within what white noise does"
    )
    parts.append(
        Captioned(
            residuals.residual_figure(plane),
            "Correlation of the displacement's residuals along frequency, whiteness above and independence of the "
            f"model below. {passed} at a joint level of 99 %; one bar in a hundred may stand out by chance.",
        )
    )
    parts.append(residuals.tests_table(plane))
    parts.append(_more(plane))
    return Section(f"{plane.plane}-plane", parts)


def _fits(plane: PlaneResult) -> str:
    """NRMSE of every step, as in Tables 5-2 and 5-6 of the thesis."""
    steps = [
        ("rigid rotor, below the split", plane.staged.rigid_fit_percent),
        ("flexible modes, above the split", plane.staged.flexible_fit_percent),
        ("both stacked (the thesis's procedure)", plane.staged.complete_fit_percent),
        ("joint refinement, fitted sweep", plane.fit_percent),
        ("joint refinement, unseen sweep", plane.cross_validation_fit_percent),
    ]
    pairs = [f"{a} from {b}" for a in plane.axes for b in plane.axes]
    rows = [[name, *(fixed(float(v), 2) for v in np.ravel(m))] for name, m in steps if m is not None]
    if plane.cross_validation_rms is not None:
        rows.append(
            [
                "residual over noise, unseen sweep, rms",
                *(fixed(float(v), 2) for v in np.ravel(plane.cross_validation_rms)),
            ]
        )
    return table(["NRMSE fit, %", *pairs], rows)


def _amplifiers(plane: PlaneResult) -> str:
    rows = []
    for axis, a in plane.amplifiers.items():
        cells = []
        for name in ("gain", "natural_frequency_rad_s", "damping_ratio"):
            e = a.parameters.get(name)
            cells.append("–" if e is None else " ± ".join(figures(e.value, e.std)))
        rows.append(
            [f"{plane.plane}{axis}", str(a.order), *cells, fixed(a.fit_percent, 2), fixed(a.first_order_fit_percent, 2)]
        )
    value, std = figures(1e6 * plane.delay_s.value, 1e6 * plane.delay_s.std)
    return table(
        ["amplifier", "order", "gain, A/A", "ω, rad/s", "ζ", "fit, %", "first-order fit, %"], rows
    ) + paragraph(f"Delay between control signal and coil beside the hold: {value} ± {std} µs.", "small")


def _more(plane: PlaneResult) -> str:
    """Model order, identifiability and the state space, folded away."""
    evidence = table(
        ["flexible modes", "parameters", "residual over noise, rms", "MDL", "AIC", ""],
        [
            [
                e.name,
                str(e.n_parameters),
                fixed(e.rms, 3),
                fixed(e.mdl, 0),
                fixed(e.aic, 0),
                "chosen" if e.chosen else "",
            ]
            for e in plane.mode_evidence
        ],
    )
    return (
        f"<details><summary>How many modes</summary>{evidence}</details>"
        f"<details><summary>Inertia and centre of gravity</summary>{_extended(plane)}</details>"
        f"<details><summary>State space of the plant, modal form</summary>{_state_space(plane)}</details>"
    )


def _extended(plane: PlaneResult) -> str:
    names = {
        "transverse_inertia_kgm2": "transverse inertia, kg m²",
        "centre_of_gravity_m": "centre of gravity off by, m",
    }
    rows = []
    for key, label in names.items():
        e = plane.extended.get(key)
        if isinstance(e, dict):
            value, std = figures(float(e["value"]), float(e["std"]))
            rows.append([label, value, std, number(float(e["nominal"])), "yes" if e["identifiable"] else "no"])
    text = "; ".join(str(a) for a in plane.extended.get("aliases", ()))
    return table(
        ["with the mass given", "estimate", "std. dev.", "datasheet", "better than the datasheet"], rows
    ) + paragraph(f"Cannot be told apart by these data: {text}.", "small")


def _state_space(plane: PlaneResult) -> str:
    ss = plane.state_space
    head = ["state", *ss.inputs, *ss.outputs]
    rows = [
        [name, *(number(float(v), 4) for v in ss.B[k]), *(number(float(v), 4) for v in ss.C[:, k])]
        for k, name in enumerate(ss.states)
    ]
    return paragraph("A is block diagonal with the poles of its states; rows of B and columns of C:", "small") + table(
        head, rows
    )


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
