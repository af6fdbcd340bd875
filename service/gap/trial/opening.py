"""What was diagnosed of a rig that was served with something withheld: its seal opened, its verdict scored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from service.experiment.data import Experiment
from service.gap.trial.blind_trial import detectability_of, plant_sweeps
from service.gap.trial.scoring import Outcome, outcome_of, parameters, told
from sim.errors import AmbError
from sim.withheld.case import redrawn
from sim.withheld.given import given_in
from sim.withheld.rigs import NAME
from sim.withheld.seal import opened

FORMAT = "amb-gap-opened"


def opened_document(
    sealed: Mapping[str, Any], commitment: str, report: Mapping[str, Any], experiment: Experiment | None = None
) -> dict[str, Any]:
    """An opened truth and the score of the verdict by the rules of the blind trial, as plain values.

    Parameters
    ----------
    sealed
        The sealed file's content.
    commitment
        As it was shown when the rig was served.
    report
        gap.json.
    experiment
        What was diagnosed: it tells how plainly the truth shows, and whether not to find it is right. Without it, and
        without the truth's own word, the truth is held to show plainly.

    Raises
    ------
    SealError
        The sealed file is not the one of the commitment.
    AmbError
        The report is of another rig or no whole one, the truth is of another version, or the experiment is no stepped
        sine.
    """
    truth = opened(sealed, commitment)
    try:
        rig = given_in(truth["given"]).datasheet.name if truth.get("given") else NAME
        if report["rig"] != rig:
            raise AmbError(f"the gap report is of rig {report['rig']!r}, and something was withheld in {rig!r}")
        shows = {} if experiment is None else _shows(truth, experiment)
        return _document(truth, outcome_of(truth | shows, report))
    except (KeyError, TypeError) as error:
        raise AmbError(f"the sealed truth or the gap report lacks {error}: this version of ambit wrote none") from error


def _shows(truth: Mapping[str, Any], experiment: Experiment) -> dict[str, Any]:
    case, sweeps = redrawn(truth), plant_sweeps(experiment)
    if not sweeps or any(s.kind != "stepped-sine" for s in sweeps) or experiment.axes != case.plain.axes:
        raise AmbError(
            "only a stepped sine, as ambit commission measures it on all axes of the rig, tells how plainly the truth "
            "shows; leave the experiment out"
        )
    return detectability_of(case, experiment)


def _document(truth: Mapping[str, Any], o: Outcome) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": 1,
        "sentence": told(o),
        "right": o.right,
        "truth": dict(truth),
        "detectability": o.detectability if math.isfinite(o.detectability) else None,
        "each": dict(o.each),
        "verdict": {k: o.verdict[k] for k in ("kind", "effects", "indistinguishable", "probability")},
        "parameters": parameters([o] if o.right else []),
    }
