"""The one place that wires: controller, experiment, identification, report and files become one job.

Commands and services call these functions; nothing below this module knows which controller or which folder.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.output import json_text, ready_folder, write_text

if TYPE_CHECKING:
    from drivers.controller import Controller
    from service.campaign.aims import Profile
    from service.campaign.multisine.plan import MultisineProfile
    from service.campaign.progress import ProgressCallback
    from service.experiment.data import Experiment
    from service.identification.result.commissioning import CommissioningResult
    from sim.datasheet import Datasheet

EXPERIMENT = "experiment.h5"
RESULT = "result.json"
REPORT = "report.html"
DATASHEET = "rig.toml"
GAP = "gap.json"
GAP_REPORT = "gap.html"


@dataclass(frozen=True)
class Commissioned:
    """What an identification left behind."""

    result: CommissioningResult
    document: dict[str, Any]
    """The contents of result.json."""
    files: dict[str, Path]
    """"result" and "report"."""
    seconds: dict[str, float]
    """Wall time by step."""


def product_version() -> str:
    """Version of the installed product, or "unknown" where it runs from sources alone."""
    try:
        return version("amb-commissioning")
    except PackageNotFoundError:
        return "unknown"


def connect(url: str) -> Controller:
    """The controller at a URL; see `drivers.url.connect` for the schemes."""
    from drivers import url as controllers

    return controllers.connect(url)


@contextmanager
def connected(url: str) -> Iterator[Controller]:
    """The controller at a URL, closed at the end."""
    controller = connect(url)
    try:
        yield controller
    finally:
        controller.close()


def quick_profile() -> Profile:
    """A coarse experiment for a first look: a third of the time, and of the accuracy."""
    from service.campaign.aims import Profile

    return Profile(
        accuracy=0.005,
        points=60,
        validation_points=16,
        amplifier_points=12,
        coarse_points=16,
        blocks=4,
        rig_seconds=120.0,
    )


def profile_for(excitation: str, quick: bool = False) -> Profile | MultisineProfile | None:
    """What an experiment shall reach with "stepped-sine" or "multisine"; None for the first one's default."""
    from service.campaign.multisine.plan import MultisineProfile

    if excitation == "multisine":
        return MultisineProfile(periods=3) if quick else MultisineProfile()
    return quick_profile() if quick else None


def measure(
    controller: Controller,
    datasheet: Datasheet,
    out_dir: Path,
    progress: ProgressCallback | None = None,
    cancelled: Callable[[], bool] | None = None,
    resume: bool = True,
    profile: Profile | MultisineProfile | None = None,
) -> Experiment:
    """Run the automated experiment into ``out_dir``, the datasheet beside it.

    Raises
    ------
    AmbError
        As the message says; the rig is stopped, and what was measured stays in ``out_dir``.
    """
    from service.campaign.run import run_campaign

    measured = run_campaign(controller, datasheet, out_dir, progress, cancelled, resume, profile)
    write_datasheet(out_dir, datasheet)  # not before: a campaign that is refused leaves the folder as it was
    return measured


def write_datasheet(folder: Path, datasheet: Datasheet) -> Path:
    """The datasheet beside its results, which makes them a baseline; a file that says the same already is left alone.

    Raises
    ------
    AmbError
        The folder cannot be written.
    """
    from sim.errors import AmbError
    from sim.rig_file import read, to_toml

    path = folder / DATASHEET
    with suppress(AmbError):  # what cannot be read is replaced
        if path.exists() and read(path) == datasheet:
            return path
    return write_text(path, to_toml(datasheet))


def identify_into(
    experiment: Experiment,
    datasheet: Datasheet,
    out_dir: Path,
    experiment_name: str = EXPERIMENT,
    announce: Callable[[str], None] | None = None,
    priors: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Commissioned:
    """Identify an experiment, and write result.json, report.html and the datasheet.

    Parameters
    ----------
    experiment_name
        How result.json refers to the experiment.
    announce
        Told what begins, in words.
    priors
        Whether the datasheet's values count as priors, as wide as its tolerances.
    progress
        Told the fraction of the identification that is done.

    Raises
    ------
    AmbError
        The experiment cannot be identified, or the folder not be written.
    """
    from service.identification.fit import identify
    from service.identification.options import Options
    from service.report.commissioning import commissioning_page, verdict

    say = announce or (lambda _: None)
    ready_folder(out_dir)
    say("identifying")
    began = time.monotonic()
    result = identify(experiment, datasheet, Options(priors=priors), progress)
    identified = time.monotonic()
    document = result.document(experiment_name)
    document["tone"], document["sentence"] = verdict(result)
    document["provenance"]["product"] = f"amb-commissioning {product_version()}"
    document["provenance"]["priors"] = priors
    files = {"result": write_text(out_dir / RESULT, json_text(document))}
    say("writing the report")
    page = commissioning_page(result, experiment, datasheet)
    files["report"] = write_text(out_dir / REPORT, page)
    files["datasheet"] = write_datasheet(out_dir, datasheet)
    seconds = {"identification": identified - began, "report": time.monotonic() - identified}
    return Commissioned(result, document, files, seconds)


def diagnose_into(
    experiment: Experiment,
    datasheet: Datasheet,
    out_dir: Path,
    jobs: int = 0,
    tell: Callable[[str, float], None] | None = None,
) -> tuple[dict[str, Any], dict[str, Path]]:
    """Diagnose the gap between an experiment and the twin of a datasheet, and write gap.json and gap.html.

    Parameters
    ----------
    jobs
        Processes that fit candidates; 0 for one per core.
    tell
        Told what begins, and the percent that are done.

    Returns
    -------
    document, files
        The contents of gap.json, and where it and the report are.

    Raises
    ------
    AmbError
        The data do not allow a diagnosis, or the folder cannot be written.
    """
    from service.gap.diagnose import diagnose
    from service.gap.document import gap_document
    from service.report.gap import gap_page

    said = tell or (lambda phase, percent: None)
    ready_folder(out_dir)
    said("gap diagnosis", 2.0)
    jobs = jobs or os.cpu_count() or 1
    diagnosis = diagnose(experiment, datasheet, jobs, lambda percent, words: said(words, 2.0 + 0.94 * percent))
    said("writing the report", 97.0)
    document = gap_document(diagnosis)
    files = {
        "gap": write_text(out_dir / GAP, json_text(document)),
        "report": write_text(out_dir / GAP_REPORT, gap_page(diagnosis)),
    }
    return document, files
