"""Opening of the seal of a rig that was served with something withheld, and the score of its diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from service.experiment.data import Experiment
from service.gap.origin import datasheet_digest, experiment_digest
from service.gap.trial.blind_trial import detectability_of, plant_sweeps
from service.gap.trial.scoring import Outcome, case_in_words, outcome_of, parameters
from sim.errors import AmbError
from sim.withheld.case import redrawn
from sim.withheld.given import given_in
from sim.withheld.rigs import NAME
from sim.withheld.seal import named_after, names_a_seal, opened

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
        What was diagnosed: its detectability decides whether "no gap" is right. Without it, and without a detectability
        in the truth, the truth counts as detectable.

    A report without digests of its inputs, as of other programs, is scored, and "notes" say that only the rig's name
    could be checked.

    Raises
    ------
    SealError
        The sealed file is not the one of the commitment.
    AmbError
        The report is of another rig, of other data or no whole one, the truth is of another version, or the experiment
        is no stepped sine.
    """
    truth = opened(sealed, commitment)
    try:
        rig = given_in(truth["given"]).datasheet.name if truth.get("given") else NAME
        if report["rig"] != rig:
            raise AmbError(f"the gap report is of rig {report['rig']!r}, and something was withheld in {rig!r}")
        notes = _must_be_of(truth, commitment, report, experiment)
        shows = {} if experiment is None else _shows(truth, experiment)
        return _document(truth, outcome_of(truth | shows, report), notes)
    except (KeyError, TypeError) as error:
        raise AmbError(f"the sealed truth or the gap report lacks {error}: this version of ambit wrote none") from error


def _must_be_of(
    truth: Mapping[str, Any], commitment: str, report: Mapping[str, Any], experiment: Experiment | None
) -> list[str]:
    """Refuse a report or an experiment of another case; return notes on what could not be checked.

    Every drawn rig has the same name. The digest of its datasheet distinguishes one from the other; the device's name
    distinguishes cases that were withheld in the same given rig.
    """
    of = report["of"] if isinstance(report.get("of"), Mapping) else {}
    measured_by = "" if experiment is None else experiment.attributes.get("controller", "")
    sealed_devices = [d for d in (str(of.get("controller", "")), measured_by) if names_a_seal(d)]
    for device in sealed_devices:
        if not device.startswith(named_after(commitment)):
            raise AmbError(
                f"what was diagnosed was measured on another case, {device.partition(',')[0]}, and the sealed file is "
                f"that of {named_after(commitment)}; give the report and the sealed file of one case"
            )
    if experiment is not None and of.get("experiment_sha256") not in (None, experiment_digest(experiment)):
        raise AmbError("the gap report is of another experiment than the one given; give the one that was diagnosed")
    if "datasheet_sha256" not in of:
        return ["the gap report does not say what it was made from: that it is of this case is taken on trust"]
    if of["datasheet_sha256"] != datasheet_digest(redrawn(truth).datasheet):
        raise AmbError(
            "the gap report is of another case: it was diagnosed with another datasheet than the one that was served; "
            "give the report of a diagnosis with that one"
        )
    if truth["given"] is not None and not sealed_devices:
        return ["the controller did not say which case it was: that it was not another one in this rig is not checked"]
    return []


def _shows(truth: Mapping[str, Any], experiment: Experiment) -> dict[str, Any]:
    """Detectability of an opened truth in the experiment."""
    case, sweeps = redrawn(truth), plant_sweeps(experiment)
    if not sweeps or any(s.kind != "stepped-sine" for s in sweeps) or experiment.axes != case.plain.axes:
        raise AmbError(
            "only a stepped sine, as ambit commission measures it on all axes of the rig, tells how plainly the truth "
            "shows; leave the experiment out"
        )
    return detectability_of(case, experiment)


def _document(truth: Mapping[str, Any], o: Outcome, notes: list[str]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": 1,
        "sentence": case_in_words(o),
        "right": o.right,
        "truth": dict(truth),
        "detectability": o.detectability if math.isfinite(o.detectability) else None,
        "each": dict(o.each),
        "verdict": {k: o.verdict[k] for k in ("kind", "effects", "indistinguishable", "probability")},
        "parameters": parameters([o] if o.right else []),
        "notes": notes,
    }
