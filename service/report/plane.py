"""The part of a report that tells about one plane, from its frequency responses to its state space."""

from __future__ import annotations

import numpy as np

from service.distributions import chi2_above
from service.experiment.data import Experiment
from service.identification.result.commissioning import PlaneResult
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import nrmse_matrix
from service.report import bode, residuals
from service.report.figure import Real
from service.report.format import figures, fixed, number, paragraph, table
from service.report.page import Captioned, Section
from sim.datasheet import Datasheet

SMALL_SIGNAL = "gain of all sensors, at small signal"


def plane_section(plane: PlaneResult, experiment: Experiment, datasheet: Datasheet) -> Section:
    """Fits, frequency responses, poles, tests and figures of one plane."""
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
            "Sensitivity of the running loop; dashed: upper limits of the zones, by default those of ISO 14839-3.",
        )
    )
    parts.append(
        Captioned(
            residuals.pole_figure(plane),
            "Poles and transmission zeros of the levitated plant without controller, all of them and each "
            "flexible pole and the zeros near it with 99 % regions. Real poles come in pairs, one of each unstable.",
        )
    )
    parts.append(f"<details><summary>Poles and zeros in figures</summary>{residuals.pole_table(plane)}</details>")
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
    parts.append(
        Captioned(
            residuals.correlation_figure(plane),
            "Correlations of the figures' errors: what stands at plus or minus one is known together only.",
        )
    )
    parts.append(_more(plane))
    return Section(f"{plane.plane}-plane", parts)


def _fits(plane: PlaneResult) -> str:
    """NRMSE of every step, as in Tables 5-2 and 5-6 of the thesis."""
    black_box = f"subspace (McKelvey), order {plane.subspace.order}"
    steps = [
        ("rigid rotor, below the split", plane.staged.rigid_fit_percent),
        ("flexible modes, above the split", plane.staged.flexible_fit_percent),
        ("both stacked (the thesis's procedure)", plane.staged.complete_fit_percent),
        ("joint refinement, fitted sweep", plane.fit_percent),
        ("joint refinement, unseen sweep", plane.cross_validation_fit_percent),
        (f"{black_box}, fitted sweep", plane.subspace.fit_percent),
        (f"{black_box}, unseen sweep", _subspace_unseen(plane)),
    ]
    if plane.closed_loop is not None:
        steps += [
            ("closed loop, predicted: r to u", plane.closed_loop.u_percent),
            ("closed loop, predicted: r to y", plane.closed_loop.y_percent),
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


def _subspace_unseen(plane: PlaneResult) -> Real | None:
    """NRMSE of the black box on the unseen sweep, the refined amplifiers before it."""
    unseen = plane.curves.validation
    if unseen is None:
        return None
    gain = plane.model.amplifier_response(unseen.omega)
    return nrmse_matrix(unseen.value, plane.subspace.response(unseen.omega) * gain[:, None, :])


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
    delay = f"{value} ± {std} µs" if np.isfinite(plane.delay_s.std) else "not to be seen without currents"
    computing_us = 1e6 * plane.model.known.computing_delay_s
    stated = f" and the {number(computing_us)} µs of computing that the datasheet states" if computing_us else ""
    return table(
        ["amplifier", "order", "gain, A/A", "ω, rad/s", "ζ", "fit, %", "first-order fit, %"], rows
    ) + paragraph(f"Delay between control signal and coil beside the hold{stated}: {delay}.", "small")


def _more(plane: PlaneResult) -> str:
    """Model order, identifiability and the state space, folded away."""
    evidence = table(
        [
            "candidate",
            "parameters",
            "residual / noise",
            "MDL",
            "AIC",
            "FPE",
            "each left out",
            "unseen sweep",
            "",
        ],
        [
            [
                name,
                str(e.n_parameters),
                fixed(e.rms, 3),
                fixed(e.mdl, 0),
                fixed(e.aic, 0),
                number(e.fpe, 4),
                fixed(e.leave_one_out_rms, 3),
                fixed(e.unseen_rms, 3),
                "chosen" if e.chosen else "",
            ]
            for name, e in _candidates(plane)
        ],
    )
    evidence += paragraph(
        "Lower is better in every column. AIC, FPE and MDL charge for parameters; cross-validation does so by itself: "
        "residual over noise of each value by a fit without it, and of a sweep that no fit has seen. The simplest "
        "candidate is chosen that none beats clearly by MDL.",
        "small",
    )
    return (
        f"<details><summary>Number of modes, split of the steps, order of the amplifiers</summary>{evidence}</details>"
        f"<details><summary>Inertia and centre of gravity</summary>{_extended(plane)}</details>"
        f"<details><summary>State space of the plant, modal form</summary>{_state_space(plane)}</details>"
    )


def _candidates(plane: PlaneResult) -> list[tuple[str, Evidence]]:
    """Every alternative that was tried, with its name."""
    found = [(e.name, e) for e in (*plane.mode_evidence, *plane.staged.split_evidence)]
    for axis, a in plane.amplifiers.items():
        found += [(f"amplifier {plane.plane}{axis}, {e.name}", e) for e in a.evidence]
    return found


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
    profile = plane.extended.get("profile", {})
    grown = [
        [
            label,
            ", ".join(number(float(v), 6) for v in profile[key]["held_at"]),
            ", ".join(number(float(v), 3) for v in profile[key]["cost_growth"]),
            "flat: cannot be told" if profile[key]["flat"] else "identifiable",
        ]
        for key, label in {**names, "mass_kg": "mass, kg", "common_sensor_gain": SMALL_SIGNAL}.items()
        if key in profile
    ]
    amplitude = profile.get("common_sensor_gain", {}).get("cost_growth_at_amplitude", ())
    if amplitude:
        shown = ", ".join(number(float(v), 3) for v in amplitude)
        told = "identifiable" if min(amplitude) > chi2_above(0.05, 1) else "flat: cannot be told"
        at = ", ".join(number(float(v), 6) for v in profile["common_sensor_gain"]["held_at"])
        likelihood_rows = [*grown, ["gain of all sensors, at the measured amplitude", at, shown, told]]
    else:
        likelihood_rows = grown
    likelihood = table(["held, everything else refitted", "at", "−2 log likelihood grows by", ""], likelihood_rows)
    # what was held within tolerances is not known for sure, and the deviations allow for that
    given = "within the datasheet's tolerances" if "mass_kg" in plane.parameter_names else "with the mass given"
    return (
        table([given, "estimate", "std. dev.", "datasheet", "better than the datasheet"], rows)
        + likelihood
        + _blind(plane)
    )


def _blind(plane: PlaneResult) -> str:
    """What of the extended set the data tell: rank and conditioning of the information, and the blind combinations."""
    e = plane.extended
    rows = [
        [", ".join(f"{size:+z.2f} {name}" for name, size in found["combination"].items())]
        for found in e["blind_directions"]
    ]
    free, condition = ", ".join(e["extended_set"]), f"{e['condition_number']:.1e}"
    text = paragraph(
        f"With {free} free besides, the data tell {e['rank']} of {e['parameters']} combinations of relative parameters "
        f"to better than themselves; condition number of the information {condition}. "
        f"Exact aliases: {'; '.join(str(a) for a in e['aliases'])}.",
        "small",
    )
    return text + (table(["combination that they do not tell, by relative change"], rows, left=1) if rows else "")


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
