"""``ambit demo``: the main job through the service, against a simulated rig that is a process of its own."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import urlsplit

import typer

from service.cli.commission import Quick, commission_directly, show
from service.cli.console import Json
from service.remarks import say

if TYPE_CHECKING:
    from service.campaign.progress import Progress
    from service.client import Client, Job, Rig
    from service.device_process import DeviceProcess

HOME = "service"
"""Folder of the service in that of the results."""
DEVICE_URL = "device.url"
"""Where the device was, so that an interrupted demo finds its rig again."""
WORKER = "demo"
STOPPING = "stopping: the excitation ramps to zero, what was measured is kept"


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the results, and of the service's files.")] = Path("out/demo"),
    seed: Annotated[int, typer.Option(help="Seed of the rig's noise.", min=0)] = 1,
    quick: Quick = False,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="Without service and device process: all of it in this one.")
    ] = False,
    keep_serving: Annotated[
        bool, typer.Option("--keep-serving", help="Leave service and rig on afterwards, until Ctrl-C.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Commission a simulated rig, from nothing to result.json and report.html.

    Starts a rig as a device process on Modbus TCP and the service beside, submits the job to the API, watches it,
    fetches its files, and ends both.
    """
    from service import bootstrap
    from service.exclusive import sole_use
    from service.output import ready_folder
    from sim.reference import reference_datasheet, reference_rig

    if in_process and keep_serving:
        raise typer.BadParameter("goes with the service, and not with --in-process", param_hint="--keep-serving")
    with sole_use(ready_folder(out), "another ambit demo", "give this one another folder with --out, or end that one"):
        if in_process:
            rig = bootstrap.connected(f"simulated://?seed={seed}")
            commission_directly(rig, reference_datasheet(), out, True, quick, as_json, reference_rig())
            return
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # both end the demo in good order
        _through_the_service(out, seed, quick, keep_serving, as_json)


def _through_the_service(out: Path, seed: int, quick: bool, keep_serving: bool, as_json: bool) -> None:
    from service.client import Client
    from service.experiment import file
    from service.local import local_service
    from service.output import read_document, ready_folder
    from sim.reference import reference_rig

    began = time.monotonic()
    home = ready_folder(out / HOME)
    with ExitStack() as stack:
        device = stack.enter_context(_device(home / DEVICE_URL, seed))  # outlives the service, which stops it
        url = stack.enter_context(local_service(home, WORKER))
        ambit = stack.enter_context(Client(url, key="", ca=""))
        started = time.monotonic()
        options = {"profile": "quick" if quick else "standard"}
        job, measured = _watched(ambit, _submitted(ambit, device.url, options))
        identified = time.monotonic()
        files = ambit.save(job, out)
        report = ambit.address(f"/models/{job.result['model']}/report.html")
        seconds = {"start": started - began, "experiment": measured - started, "identification": identified - measured}
        more = {"report_url": report, "service_home": str(home)}
        document = read_document(files["result"], "amb-commissioning-result")
        show(document, files, seconds, file.read(files["experiment"]), as_json, reference_rig(), more)
        if not as_json:
            _tell(report, home, keep_serving)
        if keep_serving:
            _serve_on(url)


@contextmanager
def _device(remembered: Path, seed: int) -> Iterator[DeviceProcess]:
    """The rig where it was the last time, if that place is free, else anywhere."""
    from drivers.errors import ControllerError
    from service.device_process import device_process
    from service.output import write_text

    options = ("--protocol", "modbus", "--seed", str(seed))
    with ExitStack() as stack:
        device = None
        with suppress(OSError, ValueError, ControllerError):
            port = urlsplit(remembered.read_text(encoding="utf-8").strip()).port
            device = stack.enter_context(device_process(*options, "--port", str(port or 0)))
        if device is None:
            device = stack.enter_context(device_process(*options))
        write_text(remembered, device.url + "\n")
        yield device


def _submitted(ambit: Client, controller: str, options: dict[str, Any]) -> Job:
    """The job: that of an interrupted demo, which goes on where it stopped, or a new one."""
    rig = _rig(ambit, controller)
    for state in ("running", "queued"):
        for job in ambit.jobs.list(state=state, kind="experiment", rig=rig.id):
            if job.options == options and job.rig_version == rig.version:
                say(f"going on with {job.id}, which was interrupted")
                return job
            ambit.jobs.cancel(job.id)
    return ambit.jobs.submit("experiment", rig.id, options=options)


def _rig(ambit: Client, controller: str) -> Rig:
    from service.client import MissingError
    from sim.reference import reference_datasheet
    from sim.rig_file import to_toml

    sheet = reference_datasheet()
    text = to_toml(sheet)
    try:
        rig = ambit.rigs.named(sheet.name)
    except MissingError:
        return ambit.rigs.create(text, controller)
    if (rig.datasheet, rig.controller_url) == (text, controller):
        return rig
    return ambit.rigs.change(rig, text, controller)


def _watched(ambit: Client, job: Job) -> tuple[Job, float]:
    """The job when it is done, and when its experiment was, monotonic."""
    from service.campaign.progress import PHASE_WORDS
    from service.cli.progress import campaign_progress
    from service.client.jobs import must_be_done

    try:
        changes = ambit.jobs.watch(job.id)
        with campaign_progress() as shown:
            for seen in changes:
                job = seen
                if job.progress.phase in PHASE_WORDS and job.state == "running":
                    shown(_progress(job))
                elif job.progress.phase in ("identification", "report") or job.ended:
                    break
        measured = time.monotonic()
        if not job.ended:
            say("identifying")
        for seen in changes:
            job = seen
    except KeyboardInterrupt:
        say(STOPPING)
        raise
    return must_be_done(job), measured


def _progress(job: Job) -> Progress:
    from service.campaign.progress import Progress

    p = job.progress
    left = p.time_left_s or 0.0
    return Progress(p.phase, p.point, p.points, (p.points - p.point) / left if left else 0.0, left, 0.0, "")


def _tell(report: str, home: Path, keep_serving: bool) -> None:
    print(f"report in the service: {report}", flush=True)
    if not keep_serving:
        print(f"  (serve it again: ambit serve --home {home} --port {urlsplit(report).port})")


def _serve_on(url: str) -> None:
    say(f"serving on {url}, the rig beside; Ctrl-C ends both")
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(3600)
