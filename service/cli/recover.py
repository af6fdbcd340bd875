"""``ambit recover``: the experiment that an interrupted campaign left, without its controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.console import print_json, stdout


def recover(
    folder: Annotated[Path, typer.Argument(help="Folder of an interrupted campaign, with its experiment.journal.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print file and points as JSON on stdout.")] = False,
) -> None:
    """Write experiment.h5 from the journal of a campaign that was killed, for when it cannot go on.

    The journal stays: the same ambit commission still goes on from there.
    """
    from service.campaign.run import recover_into_file
    from service.experiment.incomplete import INCOMPLETE

    path, experiment = recover_into_file(folder)
    points = {sweep.comment: sweep.n_points for sweep in experiment.sweeps if sweep.kind != "noise"}
    complete = INCOMPLETE not in experiment.attributes
    if as_json:
        print_json({"experiment": str(path), "points": points, "complete": complete})
        return
    if complete:
        stdout().print(f"the campaign is complete, nothing is left to recover: {path}", soft_wrap=True)
        return
    told = ", ".join(f"{sweep} {count}" for sweep, count in points.items())
    stdout().print(f"{sum(points.values())} points of a campaign that did not end ({told}): {path}", soft_wrap=True)
