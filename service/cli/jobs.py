"""``ambit jobs``: the service's jobs as a table."""

from __future__ import annotations

from enum import StrEnum
from itertools import islice
from typing import TYPE_CHECKING, Annotated

import typer

from service.campaign.progress import PHASE_WORDS
from service.cli.client import Ca, Key, Kind, Url, client
from service.cli.console import Json, print_json, stdout

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.client import Job


class State(StrEnum):
    """States of jobs."""

    queued = "queued"
    running = "running"
    done = "done"
    failed = "failed"
    cancelled = "cancelled"


def jobs(
    state: Annotated[State | None, typer.Option(help="Only in this state.")] = None,
    kind: Annotated[Kind | None, typer.Option(help="Only of this kind.")] = None,
    rig: Annotated[str | None, typer.Option(help="Only of this rig, by name or id.")] = None,
    limit: Annotated[int, typer.Option(help="How many at most.", min=1)] = 20,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """List jobs, newest first: what they are, how far, and why they failed or were cancelled."""
    with client(url, key, ca) as ambit:
        rig_id = None if rig is None else ambit.rigs.named(rig, retired=True).id
        wanted = ambit.jobs.list(None if state is None else state.value, None if kind is None else kind.value, rig_id)
        found = list(islice(wanted, limit))
        names = {} if as_json else {known.id: known.name for known in ambit.rigs.list(retired=True)}
    if as_json:
        print_json({"jobs": [job.model_dump(mode="json") for job in found]})
        return
    if found:
        _show(found, names)
    else:
        print("no such jobs" if state or kind or rig else "no jobs: ambit submit makes one")


def _show(found: Sequence[Job], names: dict[str, str]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("id", no_wrap=True, min_width=30)
    for head in ("kind", "rig", "state", "progress", "submitted", "by"):
        table.add_column(head)
    for job in found:
        at = "" if job.created_at is None else f"{job.created_at:%Y-%m-%d %H:%M}"
        cells = (job.id, job.kind, names.get(job.rig, job.rig), job.state, _progress(job), at, job.submitted_by)
        table.add_row(*map(Text, cells))  # names are no markup
    stdout().print(table)


def _progress(job: Job) -> str:
    if job.error is not None:
        return job.error.title
    words = PHASE_WORDS.get(job.progress.phase, job.progress.phase)
    return f"{job.progress.percent:.0f} % {words}".rstrip() if job.state == "running" else job.why_cancelled
