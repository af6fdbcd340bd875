"""A blind trial: measure a rig with something withheld, seal the truth, diagnose, open the seal, score.

The order is the point. The truth is sealed, and its commitment published, before the diagnosis is called; the
diagnosis is called with the experiment and the datasheet alone; its report is published before the seal is opened;
what is opened is checked against the commitment. Whoever holds the published files can check all of it again.
"""

from __future__ import annotations

import copy
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.gap.trial.detectability import Replayed, detectability, duration_s, quiet, replay, settle_s
from service.gap.trial.scoring import Outcome, outcome_of, score
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.errors import LevitationError
from sim.rig import Rig
from sim.stepping import Simulation
from sim.withheld.case import Case
from sim.withheld.seal import SealError, opened, seal
from sim.withheld.unlisted_laws import TamperedSimulation

FORMAT = "amb-gap-trial"


Measure = Callable[[Case], Experiment]
"""Runs the experiment on the case's rig. Unlike the diagnosis, it knows the truth."""
Diagnose = Callable[[Experiment, Datasheet], Mapping[str, Any]]
"""Returns the document gap.json."""
Publish = Callable[[str, Mapping[str, Any]], None]
"""Publishes a document under a name; called in the order in which documents become known."""
Reopen = Callable[[], Mapping[str, Any]]
"""Returns the sealed document as it was published, read again after the diagnosis."""


@dataclass(frozen=True)
class Trial:
    """One case, run and opened."""

    commitment: str
    sealed: Mapping[str, Any]
    report: Mapping[str, Any]
    seconds: float

    def document(self) -> dict[str, Any]:
        """The entry of the case in trial.json."""
        return {
            "commitment": self.commitment,
            "sealed": dict(self.sealed),
            "report_sha256": fingerprint(self.report),
            "report": dict(self.report),
            "seconds": self.seconds,
        }


def fingerprint(document: Mapping[str, Any]) -> str:
    """SHA-256 of a document, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def run_case(case: Case, measure: Measure, diagnose: Diagnose, publish: Publish, reopen: Reopen) -> Trial:
    """Measure, seal, diagnose and open one case.

    Parameters
    ----------
    case
        What is withheld.
    measure
        The experiment on the case's rig.
    diagnose
        Gets the experiment and the datasheet.
    publish
        Called with "commitment" and "sealed" before the diagnosis begins, with "report" before the seal is opened.
    reopen
        Called once the report is out.

    Raises
    ------
    SealError
        The sealed document was changed while the diagnosis ran.
    """
    experiment = measure(case)
    kept = seal(case.truth() | detectability_of(case, experiment))
    publish("commitment", {"case": case.number, "sha256": kept.commitment})
    publish("sealed", kept.document())
    started = time.perf_counter()
    report = json.loads(json.dumps(diagnose(experiment, case.datasheet)))
    seconds = time.perf_counter() - started
    publish("report", report)
    sealed = dict(reopen())
    opened(sealed, kept.commitment)
    return Trial(kept.commitment, sealed, report, seconds)


def plant_sweeps(experiment: Experiment) -> list[Sweep]:
    """Sweeps of the plant, the main one and the one at another amplitude, with their excited points."""
    wanted = [s for s in experiment.sweeps if s.kind != "noise" and s.comment in ("main", "validation")]
    return [s.select((s.amplitude_a > 0) & (np.abs(s.R).max(axis=(1, 2, 3)) > 0)) for s in wanted]


def detectability_of(case: Case, experiment: Experiment) -> dict[str, Any]:
    """Detectability of what is withheld in a case's experiment; "each": of each effect, the others being known."""
    if case.kind == "clean":
        return {"detectability": 0.0, "each": {}}
    sweeps = plant_sweeps(experiment)
    waits = [settle_s([case.plain, case.rig], s) for s in sweeps]
    replay_s = sum(duration_s(*x, 1 / case.rig.controller.sample_time_s) for x in zip(sweeps, waits, strict=True))
    rig = _shortened(case.rig, experiment, replay_s)
    coarse = rig.noise.displacement_step_m != case.plain.noise.displacement_step_m
    changed = TamperedSimulation(quiet(rig, steps=coarse), 0, copy.deepcopy(case.tampering), replay_s)
    pairs = [(s, replay(changed, s, wait)) for s, wait in zip(sweeps, waits, strict=True)]

    def replayed(plain: Rig) -> list[Replayed]:
        simulation = Simulation(quiet(_shortened(plain, experiment, replay_s)))
        return [replay(simulation, s, wait) for s, wait in zip(sweeps, waits, strict=True)]

    tolerance = case.datasheet.tolerance
    each = {}
    if len(case.effects) > 1:
        for hidden, _ in case.effects:
            others = case.plain
            for name, values in case.effects:
                others = CATALOGUE[name].on(others, **dict(values)) if name != hidden else others
            with suppress(LevitationError):  # without it the rig would not be there to be compared with
                each[hidden] = detectability(others, tolerance, pairs, replayed)
    return {"detectability": detectability(case.plain, tolerance, pairs, replayed), "each": each}


def _shortened(rig: Rig, experiment: Experiment, replay_s: float) -> Rig:
    """The rig with its drift sped up to the time that a replay takes, which is less than the campaign took."""
    took = experiment.rig_seconds
    if rig.drift is None or not took:
        return rig
    return replace(rig, drift=replace(rig.drift, duration_s=rig.drift.duration_s * replay_s / took))


@dataclass(frozen=True)
class Published:
    """What was published of a case before its seal was opened."""

    commitment: str
    report_sha256: str
    """`fingerprint` of the report."""


def checked(document: Mapping[str, Any], published: Published | None = None) -> Outcome:
    """Outcome of one case of a trial, its seal and its report checked.

    Parameters
    ----------
    document
        As `Trial.document` gave it.
    published
        As published elsewhere. Without it the case is checked against its own entries, which finds a truth or a report
        that was changed alone, but no case that was forged as a whole.

    Raises
    ------
    SealError
        The sealed truth or the report is not the one that was committed to.
    """
    known = published or Published(document["commitment"], document["report_sha256"])
    truth = opened(document["sealed"], known.commitment)
    if fingerprint(document["report"]) != known.report_sha256:
        raise SealError(f"the report of case {truth.get('case')} is not the one that was published: it was changed")
    return outcome_of(truth, document["report"], document["seconds"])


def summary(cases: Sequence[Mapping[str, Any]], seed: int) -> dict[str, Any]:
    """trial.json: every case as published, and the scores of all that could be opened.

    Raises
    ------
    SealError
        As `checked`.
    """
    return {
        "format": FORMAT,
        "version": 1,
        "seed": seed,
        "scores": score([checked(c) for c in cases]),
        "cases": [dict(c) for c in cases],
    }
