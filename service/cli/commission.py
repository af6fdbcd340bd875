"""``ambit commission`` and ``ambit identify``: the main job in this process, whole or in part."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import Json, print_json, stdout
from service.cli.usage import value_of
from service.remarks import say

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from drivers.controller import Controller
    from service.experiment.data import Experiment
    from sim.datasheet import Datasheet
    from sim.rig import Rig


class Excitation(StrEnum):
    """How a rig is excited."""

    STEPPED_SINE = "stepped-sine"
    MULTISINE = "multisine"


Quick = Annotated[bool, typer.Option("--quick", help="A coarse experiment: a third of the time and of the accuracy.")]
How = Annotated[
    Excitation,
    typer.Option(
        help="One tone after the other, or multisines on all axes at once: a tenth of the time on the rig, where the "
        "controller can play them."
    ),
]
Priors = Annotated[
    bool,
    typer.Option(
        "--priors",
        help="Let the datasheet's ki, ks, amplifiers and modes count as priors, as wide as its \\[tolerance] says. "
        "Without it they are not trusted at all.",
    ),
]
STOPPING = "stopping: any excitation ramps to zero, what was measured is kept"


def commission(
    controller: Annotated[
        str, typer.Option(help="URL: modbus://, modbuss://, modbus+rtu://, canopen://, simulated:// or replay://.")
    ],
    rig: Annotated[Path, typer.Option(help="Datasheet of the rig, rig.toml.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    resume: Annotated[
        bool, typer.Option(help="Go on with an interrupted campaign that lies in the folder, or put it aside.")
    ] = True,
    quick: Quick = False,
    excitation: How = Excitation.STEPPED_SINE,
    priors: Priors = False,
    as_json: Json = False,
) -> None:
    """Measure a rig through its controller, identify it, and write result.json and report.html.

    Exit status 0 also for a rig that is not identified: identified in result.json and --json is false then.
    """
    from drivers.errors import AddressError
    from service import bootstrap
    from service.output import results_in
    from sim.rig_file import read

    datasheet = read(rig)
    connection = bootstrap.connected(controller)
    with value_of("--controller", AddressError), results_in(out):
        commission_directly(connection, datasheet, out, resume, quick, as_json, None, excitation, priors)


def identify(
    experiment: Annotated[Path, typer.Argument(help="Experiment file: HDF5 or MATLAB.")],
    rig: Annotated[Path, typer.Option(help="Datasheet of the rig, rig.toml.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    also: Annotated[
        list[Path] | None,
        typer.Option(help="A further experiment of the same rig, at another speed; may be given again."),
    ] = None,
    priors: Priors = False,
    as_json: Json = False,
) -> None:
    """Identify a rig from an experiment file, and write result.json, report.html and the datasheet beside them.

    An experiment at several speeds, in one file or in several, gives the rotating model, too. Exit status 0 also for a
    rig that is not identified: identified in result.json and --json is false then.
    """
    from service import bootstrap
    from service.experiment import file
    from service.experiment.merge import merged
    from service.output import results_in
    from sim.rig_file import read

    datasheet = read(rig)
    paths = [experiment, *(also or [])]
    announce = say if sys.stderr.isatty() else None  # a log wants no word before the result or the error
    with results_in(out):
        measured = merged([file.read(p) for p in paths], [str(p) for p in paths])
        done = bootstrap.identify_into(measured, datasheet, out, str(experiment), announce, priors)
    show(done.document, done.files, done.seconds, measured, as_json)


def commission_directly(
    connection: AbstractContextManager[Controller],
    datasheet: Datasheet,
    out: Path,
    resume: bool,
    quick: bool,
    as_json: bool,
    truth: Rig | None,
    excitation: Excitation = Excitation.STEPPED_SINE,
    priors: bool = False,
) -> None:
    """Campaign with a bar and an orderly Ctrl-C; then the rest, in which nothing moves any more.

    ``truth`` is what a simulated rig's result is compared with.
    """
    from drivers.errors import BusError
    from service import bootstrap
    from service.campaign.journal import entries
    from service.campaign.run import JOURNAL
    from service.cli.interrupt import asked_to_stop, kill_is_ctrl_c
    from service.cli.progress import campaign_progress

    began = time.monotonic()
    profile = bootstrap.profile_for(excitation.value, quick)
    with ExitStack() as stack:
        with kill_is_ctrl_c():  # nothing is excited yet that would have to ramp down: the first signal ends the command
            controller = stack.enter_context(connection)
        cancelled = stack.enter_context(asked_to_stop(STOPPING))
        progress = stack.enter_context(campaign_progress())
        try:
            experiment = bootstrap.measure(controller, datasheet, out, progress, cancelled, resume, profile)
        except BusError as error:
            journal = out / JOURNAL
            if not journal.exists() or len(entries(journal.read_bytes())[0]) < 2:  # its header alone: nothing measured
                raise
            kept = f"what was measured is kept in {out}: run it again to go on where it stopped"
            raise BusError(f"{error}; {kept}") from error
    measured = time.monotonic() - began
    done = bootstrap.identify_into(experiment, datasheet, out, announce=say, priors=priors)
    files = {**done.files, "experiment": out / bootstrap.EXPERIMENT}
    show(done.document, files, {"experiment": measured, **done.seconds}, experiment, as_json, truth)


def show(
    document: dict[str, Any],
    files: dict[str, Path],
    seconds: dict[str, float],
    experiment: Experiment,
    as_json: bool,
    truth: Rig | None = None,
    more: dict[str, Any] | None = None,
) -> None:
    """Print a result: what it says, figures beside the truth or the datasheet, fits, peaks, notes, time and files.

    Parameters
    ----------
    document
        The contents of result.json.
    seconds
        Wall time by step.
    more
        What only the JSON tells.
    """
    from service.cli import summary

    found = list(summary.rows(document, experiment.axes, truth))
    reference = "truth" if truth is not None else "datasheet"
    if as_json:
        told = {"files": {k: str(v) for k, v in files.items()}, "seconds": seconds, **(more or {})}
        print_json(document | told | {"compared_with": reference, "comparison": summary.compared(found)})
        return
    console = stdout()
    console.print(document["sentence"], soft_wrap=True)
    console.print(summary.table(found, reference))
    lines = summary.fits(document) + summary.margins(document) + summary.notes(document)
    for text in [*lines, summary.times(seconds, experiment)]:
        console.print(text, soft_wrap=True)
    for name, path in files.items():
        console.print(f"{name}: {path}", soft_wrap=True)
