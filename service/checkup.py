"""A health check from the rig to its files: baseline folder, short experiment, comparison, report. The wiring of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.bootstrap import DATASHEET, RESULT
from service.output import json_text, read_document, ready_folder, whole, write_text
from sim.errors import reason

if TYPE_CHECKING:
    from drivers.controller import Controller
    from service.campaign.progress import ProgressCallback
    from service.experiment.data import Experiment
    from service.health.compare import Baseline
    from service.health.sequential import Policy
    from service.health.tones import ShortPlan
    from service.health.trend import Checked
    from sim.datasheet import Datasheet

HEALTH = "health.json"
PAGE = "health.html"
HISTORY = "history.jsonl"
YEAR_S = 365 * 86_400.0


@dataclass(frozen=True)
class CheckedUp:
    """What a check left behind."""

    document: dict[str, Any]
    """The contents of health.json."""
    files: dict[str, Path]


def read_baseline(folder: Path) -> tuple[Baseline, Datasheet]:
    """Result and datasheet of a commissioning's folder.

    Raises
    ------
    AmbError
        One of them is missing or cannot be read.
    """
    from sim.rig_file import read

    return baseline_of(folder / RESULT), read(folder / DATASHEET)


def baseline_of(path: Path) -> Baseline:
    """A baseline from its result.json.

    Raises
    ------
    DocumentError
        It cannot be read, or is no whole result.
    """
    from service.health.compare import Baseline
    from service.identification.result.shape import ResultModel

    return Baseline(read_document(path, "amb-commissioning-result", ResultModel))


def baseline_from(document: Any, name: str) -> Baseline:
    """A baseline from the contents of its result.json.

    Raises
    ------
    DocumentError
        It is no whole result; the message calls it by ``name``.
    """
    from service.health.compare import Baseline
    from service.identification.result.shape import ResultModel

    return Baseline(whole(document, ResultModel, name))


def must_suffice(baseline: Baseline, datasheet: Datasheet, budget_s: float) -> None:
    """Refuse a budget in which no check of a rig fits, at once.

    Raises
    ------
    JobError
        It is too small; names the least that will do.
    """
    from service.health.tones import must_suffice

    must_suffice(datasheet, baseline.document, budget_s)


def plan_for(baseline: Baseline, datasheet: Datasheet, budget_s: float) -> ShortPlan:
    """The short experiment of a rig."""
    from service.health.tones import short_plan

    return short_plan(datasheet, baseline.document, budget_s)


def measure_check(
    controller: Controller,
    datasheet: Datasheet,
    plan: ShortPlan,
    out_dir: Path,
    progress: ProgressCallback | None = None,
    cancelled: Callable[[], bool] | None = None,
    holder: str = "",
) -> Experiment:
    """Run the short experiment into a folder; it resumes like any campaign, but with recent points only."""
    from service.campaign.leased import alone
    from service.campaign.run import run_campaign
    from service.health.budget import RECENT_S

    name = holder or alone("ambit health")
    anew = "choose another folder"
    return run_campaign(controller, datasheet, out_dir, progress, cancelled, True, plan.profile, name, RECENT_S, anew)


def compare_into(
    baseline: Baseline,
    datasheet: Datasheet,
    experiment: Experiment,
    out_dir: Path,
    history_file: Path | None = None,
    policy: Policy | None = None,
    at: datetime | None = None,
    compared: Callable[[], None] = lambda: None,
) -> CheckedUp:
    """Compare, write health.json and health.html, and add the check to the history.

    Parameters
    ----------
    history_file
        JSON lines of earlier checks; those of the year before ``at`` share the allowance of false alarms.
    at
        When the check was made; now without it.
    compared
        Told when only the report is left to be written.
    """
    from service.health.compare import compare
    from service.health.trend import Checked
    from service.report.health import health_page

    ready_folder(out_dir)
    when = (at or datetime.now(UTC)).astimezone(UTC)
    history = [] if history_file is None else read_history(history_file)
    made = sum(0 <= (when - c.at).total_seconds() < YEAR_S for c in history)
    document = compare(baseline, experiment, datasheet, made, policy).document()
    document["checked_at"] = when.isoformat().replace("+00:00", "Z")
    files = {"health": write_text(out_dir / HEALTH, json_text(document))}
    compared()
    everything = [*history, Checked(when, document)]
    files["report"] = write_text(out_dir / PAGE, health_page(document, everything))
    if history_file is not None:
        _append(history_file, document)
        files["history"] = history_file
    return CheckedUp(document, files)


def read_history(path: Path) -> list[Checked]:
    """Earlier checks, one JSON document a line; none where there is no file.

    A last line without an end is read where it is whole, as a copy or an editor leaves it; where it is not, a crash cut
    it short, and it is left out.

    Raises
    ------
    DocumentError
        The file cannot be read, or another line is no health check; names the line.
    """
    from service.errors import DocumentError
    from service.health.shape import CheckRead
    from service.health.trend import Checked

    try:
        *lines, last = path.read_bytes().split(b"\n") if path.exists() else [b""]
    except OSError as error:
        raise DocumentError(
            f"cannot read the history {path}: {reason(error)}; give the file that ambit health wrote"
        ) from error
    if _is_document(last):
        lines.append(last)
    found = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            document = _document(line)
        except ValueError as error:
            raise DocumentError(f"line {number} of {path} is no health check; mend or move the file") from error
        check = whole(document, CheckRead, f"line {number} of {path}")
        found.append(Checked(check["checked_at"], check))
    return found


def _document(line: bytes) -> Any:
    """The JSON document of one line. Bytes are split into lines first: a cut may go through the bytes of a letter."""
    return json.loads(line.decode("utf-8"))


def _is_document(line: bytes) -> bool:
    try:
        _document(line)
    except ValueError:
        return False
    return True


def ready_history(path: Path) -> Path:
    """The history, proven to be such that a check can be added; nothing is made or changed.

    Raises
    ------
    OutputError
        It cannot be written: a check that could not be added would bound no false alarms.
    DocumentError
        It cannot be read.
    """
    from tempfile import TemporaryFile

    from service.errors import OutputError

    try:
        with path.open("ab") if path.exists() else TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(
            f"cannot add to the history {path}: {reason(error)}; nothing was started: name another one by --history"
        ) from error
    read_history(path)
    return path


def _append(path: Path, document: dict[str, Any]) -> None:
    from service.errors import OutputError

    text = json.dumps(document, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    try:
        with path.open("ab+") as file:
            file.seek(0)
            content = file.read()
            begin = content.rfind(b"\n") + 1
            if _is_document(content[begin:]):  # a check that has been read and counted, and lost its end
                file.write(b"\n")
            else:  # nothing, or what a crash left
                file.truncate(begin)
            file.write(text.encode("utf-8") + b"\n")
    except OSError as error:
        raise OutputError(f"cannot add to the history {path}: {error.strerror or error}") from error
