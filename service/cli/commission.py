"""``ambit demo``, ``ambit commission``, ``ambit identify``: the main job, whole or in part."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.console import print_json, say, stdout

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from drivers.controller import Controller
    from service.bootstrap import Commissioned
    from service.experiment.data import Experiment
    from sim.datasheet import Datasheet
    from sim.rig import Rig

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
Quick = Annotated[bool, typer.Option("--quick", help="A coarse experiment: a third of the time and of the accuracy.")]
STOPPING = "stopping: the excitation ramps to zero, what was measured is kept"


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(help="Seed of the rig's noise.", min=0)] = 1,
    quick: Quick = False,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="Simulate in this process, and not behind Modbus TCP in another one.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Commission a simulated rig, from nothing to result.json and report.html.

    The rig is a device process that the demo starts, talks to over Modbus TCP, and ends.
    """
    from service import bootstrap
    from service.output import ready_folder
    from sim.reference import reference_datasheet, reference_rig

    ready_folder(out)
    rig = bootstrap.demo_controller(seed, in_process)
    _commission(rig, reference_datasheet(), out, resume=True, quick=quick, as_json=as_json, truth=reference_rig())


def commission(
    controller: Annotated[str, typer.Option(help="Where the controller is: modbus://host:502, canopen://..., ...")],
    rig: Annotated[Path, typer.Option(help="Datasheet of the rig, rig.toml.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    resume: Annotated[
        bool, typer.Option(help="Go on with an interrupted campaign that lies in the folder, or put it aside.")
    ] = True,
    quick: Quick = False,
    as_json: Json = False,
) -> None:
    """Measure a rig through its controller, identify it, and write result.json and report.html."""
    from service import bootstrap
    from service.output import ready_folder
    from sim.datasheet import read

    datasheet = read(rig)
    ready_folder(out)
    _commission(bootstrap.connected(controller), datasheet, out, resume, quick, as_json, None)


def identify(
    experiment: Annotated[Path, typer.Argument(help="Experiment file: HDF5 or MATLAB.")],
    rig: Annotated[Path, typer.Option(help="Datasheet of the rig, rig.toml.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    as_json: Json = False,
) -> None:
    """Identify a rig from an experiment file, and write result.json and report.html."""
    from service import bootstrap
    from service.experiment import file
    from service.output import ready_folder
    from sim.datasheet import read

    datasheet = read(rig)
    ready_folder(out)
    measured = file.read(experiment)
    announce = say if sys.stderr.isatty() else None  # a log wants no word before the result or the error
    _show(bootstrap.identify_into(measured, datasheet, out, str(experiment), announce), measured, as_json, None)


def _commission(
    connection: AbstractContextManager[Controller],
    datasheet: Datasheet,
    out: Path,
    resume: bool,
    quick: bool,
    as_json: bool,
    truth: Rig | None,
) -> None:
    """Campaign with a bar and an orderly Ctrl-C; then the rest, in which nothing moves any more."""
    from service import bootstrap
    from service.cli.interrupt import asked_to_stop
    from service.cli.progress import campaign_progress

    began = time.monotonic()
    profile = bootstrap.quick_profile() if quick else None
    with asked_to_stop(STOPPING) as cancelled, connection as controller, campaign_progress() as progress:
        experiment = bootstrap.measure(controller, datasheet, out, progress, cancelled, resume, profile)
    measured = time.monotonic() - began
    done = bootstrap.identify_into(experiment, datasheet, out, announce=say)
    done = replace(
        done,
        files={**done.files, "experiment": out / bootstrap.EXPERIMENT, "datasheet": out / bootstrap.DATASHEET},
        seconds={"experiment": measured, **done.seconds},
    )
    _show(done, experiment, as_json, truth)


def _show(done: Commissioned, experiment: Experiment, as_json: bool, truth: Rig | None) -> None:
    from service.cli import summary

    found = list(summary.rows(done.result, truth))
    if as_json:
        files = {"files": {k: str(v) for k, v in done.files.items()}, "seconds": done.seconds}
        reference = "truth" if truth is not None else "datasheet"
        print_json(done.document | files | {"compared_with": reference, "comparison": summary.compared(found)})
        return
    console = stdout()
    console.print(summary.table(found, "truth" if truth is not None else "datasheet"))
    for text in summary.fits(done.result) + summary.notes(done.result) + [summary.times(done.seconds, experiment)]:
        console.print(text, soft_wrap=True)
    for name, path in done.files.items():
        console.print(f"{name}: {path}", soft_wrap=True)
