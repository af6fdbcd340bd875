"""What is calculated in a process of its own: paths and values in, values and files out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from service import bootstrap
from service.experiment import file
from service.output import json_text, write_text
from sim import rig_file

Tell = Callable[[str, float], None]
"""Told the phase and the percent that are done."""

RESULT, REPORT, PLOTS, GAP = "result.json", "report.html", "plots.json", "gap.json"
GAP_REPORT, HEALTH_REPORT = "gap.html", "health.html"


def silent(phase: str, percent: float) -> None:
    """Tell nobody."""


def identification(
    experiment: str, rig: str, out: str, name: str, priors: bool = False, tell: Tell = silent
) -> dict[str, Any]:
    """Identify an experiment; result.json, report.html and plots.json are in ``out``.

    Parameters
    ----------
    experiment, rig, out
        Paths of the experiment file, the datasheet and the folder.
    name
        How the result refers to the experiment.
    priors
        Whether the datasheet's values count as priors.
    tell
        Told how far it is.

    Returns
    -------
    summary
        What lists and histories show.
    """
    from service.report.curves import curves

    percents = {"identifying": ("identification", 2.0), "writing the report": ("report", 90.0)}
    sheet = rig_file.read(Path(rig))
    measured = file.read(Path(experiment))
    done = bootstrap.identify_into(
        measured,
        sheet,
        Path(out),
        name,
        lambda begins: tell(*percents[begins]),
        priors,
        lambda fraction: tell("identification", 2.0 + 88.0 * fraction),
    )
    tell("report", 97.0)
    write_text(Path(out) / PLOTS, json_text(curves(done.result, sheet), indent=None))
    return model_summary(done.document)


def gap(experiment: str, rig: str, out: str, processes: int, tell: Tell = silent) -> dict[str, Any]:
    """Diagnose the gap of an experiment; gap.json and gap.html are in ``out``; the summary."""
    sheet = rig_file.read(Path(rig))
    document, _ = bootstrap.diagnose_into(file.read(Path(experiment)), sheet, Path(out), processes, tell)
    verdict = document["verdict"]
    return {
        "verdict": verdict["kind"],
        "effects": verdict["effects"],
        "indistinguishable": verdict["indistinguishable"],
        "probability": verdict["probability"],
        "gap_before": document["gap"]["before"],
        "noise_floor": document["gap"]["noise_floor"],
        "closure": (document.get("shrinkage") or {}).get("closure"),
    }


def health_plan(baseline: str, rig: str, budget_s: float, tell: Tell = silent) -> dict[str, Any]:
    """Profile of a short experiment, as JSON."""
    from service import checkup

    plan = checkup.plan_for(checkup.baseline_of(Path(baseline)), rig_file.read(Path(rig)), budget_s)
    return asdict(plan.profile)


def health_compare(
    baseline: str,
    rig: str,
    experiment: str,
    out: str,
    history: str,
    at: str,
    false_alarms_per_year: float | None = None,
    tell: Tell = silent,
) -> dict[str, Any]:
    """Compare a short experiment with a baseline; health.html is in ``out``; the document."""
    from service import checkup
    from service.health.sequential import Policy

    then = checkup.baseline_of(Path(baseline))
    measured = file.read(Path(experiment))
    when = datetime.fromisoformat(at)
    tell("comparison", 2.0)
    done = checkup.compare_into(
        then,
        rig_file.read(Path(rig)),
        measured,
        Path(out),
        Path(history),
        None if false_alarms_per_year is None else Policy(false_alarms_per_year),
        at=when,
        compared=lambda: tell("report", 80.0),
    )
    return done.document


def model_summary(document: dict[str, Any]) -> dict[str, Any]:
    """What a result.json says in a sentence; stiffness, modes, fits and margins, plane by plane."""
    return {
        "rig": document["rig"],
        **{name: document[name] for name in ("sentence", "tone", "identified") if name in document},
        "planes": {name: _plane(plane) for name, plane in document["planes"].items()},
        "warnings": document.get("warnings", []),
    }


def _plane(plane: dict[str, Any]) -> dict[str, Any]:
    return {
        "stiffness": {
            name: {k: entry[k] for k in ("value", "std", "unit", "nominal")}
            for name, entry in plane["stiffness"].items()
        },
        "modes": [{k: mode[k] for k in ("natural_frequency_rad_s", "damping_ratio")} for mode in plane["rotor_modes"]],
        "fit_percent": plane["fit_percent"],
        "cross_validation_fit_percent": plane["cross_validation_fit_percent"],
        "residuals_passed": plane["residuals"]["passed"],
        "model_adequate": plane["residuals"]["model_adequate"],
        "warnings": [text for text in plane.get("warnings", []) if " Hz: " not in text],
        "sensitivity_peak": plane["margins"]["sensitivity_peak"],
        "iso_14839_3_zone": plane["margins"]["iso_14839_3_zone"],
    }


BY_NAME: dict[str, Callable[..., dict[str, Any]]] = {
    "identification": identification,
    "gap": gap,
    "health_plan": health_plan,
    "health_compare": health_compare,
}
WORDS = {
    "identification": "identification",
    "gap": "diagnosis",
    "health_plan": "planning the check",
    "health_compare": "comparing the check",
}
"""What each of them is to whoever is told that it failed."""
