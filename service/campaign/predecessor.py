"""What becomes of an experiment or a journal that lies where another shall be: no point of it is lost."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from service.campaign import journal
from service.experiment import file
from service.experiment.data import Experiment, Sweep
from service.experiment.errors import ExperimentFileError, JournalError

PREVIOUS = "previous"


def too_old(path: Path, recent_s: float | None) -> bool:
    """Whether the journal at ``path`` began longer ago than one may go on with, or does not tell when.

    The time is the journal's own, which a copy on another machine has, too. One that lies ahead by as much is of a
    clock that was wrong; seconds between two machines' clocks do not matter. With None, none is too old.
    """
    if recent_s is None:
        return False
    try:
        began = journal.began(path)
    except JournalError:  # there is none, or none that a campaign goes on with: it says so
        return False
    return began is None or abs((datetime.now(UTC) - began).total_seconds()) > recent_s


def make_way(path: Path, successor: Experiment) -> None:
    """Put the experiment at ``path`` aside, unless ``successor``, which shall be there, holds every point of it.

    So the file of an interrupted campaign goes when the campaign is complete, and another campaign's stays.
    """
    if path.exists() and not _within(_read(path), successor):
        put_aside(path)


def holds_all(path: Path, other: Experiment) -> bool:
    """Whether the experiment at ``path`` holds every point of another."""
    return path.exists() and (present := _read(path)) is not None and _within(other, present)


def put_aside(path: Path) -> None:
    """Rename a file that would be lost, to a name that is free."""
    if not path.exists():
        return
    k = 1
    while (target := path.with_name(f"{path.stem}.{PREVIOUS}-{k}{path.suffix}")).exists():
        k += 1
    path.rename(target)


def _read(path: Path) -> Experiment | None:
    try:
        return file.read(path)
    except ExperimentFileError:
        return None


def _within(part: Experiment | None, whole: Experiment) -> bool:
    if part is None or part.axes != whole.axes or part.rig != whole.rig:
        return False
    others = {sweep.comment: sweep for sweep in whole.sweeps}
    return all(s.comment in others and _holds(others[s.comment], s) for s in part.sweeps)


def _holds(whole: Sweep, part: Sweep) -> bool:
    """Whether every point of one sweep is in another, to the last bit."""
    if whole.Y.shape[1:] != part.Y.shape[1:] or whole.harmonics != part.harmonics:
        return False
    rows = {_row(whole, k) for k in range(whole.n_points)}
    return all(_row(part, k) in rows for k in range(part.n_points))


def _row(sweep: Sweep, k: int) -> tuple[float, int, float, bytes]:
    signals = [x[k] for x in (sweep.R, sweep.U, sweep.I, sweep.Y) if x is not None]
    content = b"".join(np.ascontiguousarray(x).tobytes() for x in signals)
    return float(sweep.frequency_hz[k]), int(sweep.axis[k]), float(sweep.amplitude_a[k]), content
