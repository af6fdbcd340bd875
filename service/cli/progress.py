"""Progress of a campaign or a calculation: a bar on a terminal, a line now and then of a campaign in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from service.campaign.progress import PHASE_WORDS
from service.cli.console import stderr
from service.remarks import say
from service.report.format import duration

if TYPE_CHECKING:
    from service.campaign.progress import Progress

LOG_EVERY_S = 5.0
FIRST_POINTS = 20
"""So many points before a rate is believed: the first ones wait for compilers and caches."""


@contextmanager
def campaign_progress() -> Iterator[Callable[[Progress], None]]:
    """A callback for `run_campaign` that shows where it is, with rate and time left, on stderr."""
    if sys.stderr.isatty():
        with _bar() as show:
            yield show
    else:
        yield _log()


@contextmanager
def percent_progress(first: str) -> Iterator[Callable[[str, float], None] | None]:
    """A callback for calculations, told words and percent: a bar on a terminal, nothing in a log."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(bar_width=None), TaskProgressColumn(), TimeElapsedColumn())
    with Bar(*columns, console=stderr(), transient=True, expand=True) as bar:
        task = bar.add_task(first, total=100.0)

        def show(words: str, percent: float) -> None:
            bar.update(task, description=words, completed=percent)

        yield show


def line(p: Progress) -> str:
    """One report as a line of text."""
    known = p.points_per_s > 0 and p.done >= FIRST_POINTS
    rate = f", {p.points_per_s:.1f} points/s, {duration(p.seconds_left)} left" if known else ""
    return f"{PHASE_WORDS.get(p.phase, p.phase)}: {p.done} of {p.total} points{rate}{_wait(p)}"


def _wait(p: Progress) -> str:
    """What is told of a record for which one waits."""
    return f", the next one comes over a slow line in some {duration(p.wait_s)}" if p.wait_s else ""


def _log() -> Callable[[Progress], None]:
    shown_at, shown = time.monotonic(), ""

    def show(p: Progress) -> None:
        nonlocal shown_at, shown
        now = time.monotonic()
        part = "done" if p.done == p.total else p.phase
        if now - shown_at >= LOG_EVERY_S or part != shown or p.wait_s:
            shown_at, shown = now, part
            say(line(p))

    return show


@contextmanager
def _bar() -> Iterator[Callable[[Progress], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description:<15}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[left]}"),
    )
    with Bar(*columns, console=stderr(), transient=True, expand=True) as bar:
        task = bar.add_task("starting", total=None, rate="", left="")

        def show(p: Progress) -> None:
            known = p.points_per_s > 0 and p.done >= FIRST_POINTS
            bar.update(
                task,
                description=PHASE_WORDS.get(p.phase, p.phase),
                completed=p.done,
                total=p.total,
                rate=f"{p.points_per_s:.1f} points/s" if known else "",
                left=f"{duration(p.seconds_left)} left" if known else _wait(p).removeprefix(", "),
            )

        yield show
