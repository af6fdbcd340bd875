"""``ambit submit``, ``watch``, ``cancel``, ``retry``, ``fetch``: jobs of the service from a terminal."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable
from enum import StrEnum
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.api.identifiers import is_id
from service.campaign.progress import PHASE_WORDS
from service.cli.commission import Excitation
from service.cli.console import Json, print_json, stderr
from service.cli.usage import job_id
from service.remarks import one_line, say

if TYPE_CHECKING:
    from service.client import Client, Job, Rig

Url = Annotated[
    str | None, typer.Option(help="Address of the service.", envvar="AMBIT_URL", show_default="http://127.0.0.1:8311")
]
Key = Annotated[str | None, typer.Option(help="API key.", envvar="AMBIT_KEY", show_envvar=True)]
Ca = Annotated[Path | None, typer.Option(help="Authority of the service's certificate, PEM.", envvar="AMBIT_CA")]
LOG_EVERY_S = 5.0
AGAIN = "{}; trying again"
STILL = "the job goes on; stop it with: ambit cancel {}"


class Kind(StrEnum):
    """Kinds of jobs."""

    experiment = "experiment"
    identification = "identification"
    gap = "gap"
    health = "health"


def submit(
    kind: Annotated[Kind, typer.Argument(help="What shall be done; experiment and health move the rotor.")],
    rig: Annotated[str, typer.Option(help="Name or id of the rig, or rig.toml: made known unless for health.")],
    controller: Annotated[
        str | None, typer.Option(help="Where the controller is; with rig.toml. A rig whose rotor is to move needs one.")
    ] = None,
    change: Annotated[
        bool, typer.Option("--change", help="Give a known rig this controller and datasheet in place of its own.")
    ] = False,
    experiment: Annotated[
        str | None, typer.Option(help="Id of an experiment, or a file that is uploaded: identification, gap.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="experiment: coarse, a third of the time.")] = False,
    excitation: Annotated[
        Excitation | None, typer.Option(help="experiment: tone by tone, or multisines on all axes at once.")
    ] = None,
    option: Annotated[list[str] | None, typer.Option(help="Option of the job, name=value; may be repeated.")] = None,
    priority: Annotated[int, typer.Option(help="1 first, 9 last.", min=1, max=9)] = 5,
    follow: Annotated[bool, typer.Option("--watch", help="Watch it until it has ended.")] = False,
    out: Annotated[Path | None, typer.Option(help="Watch it, then fetch its files into this folder.")] = None,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Submit a job to the service; prints its id."""
    from service.client import RefusedError

    options = _options(option or [], quick, excitation, kind)
    _must_have_or_not(experiment, kind)
    with client(url, key, ca) as ambit:
        known = _rig(ambit, rig, controller, change, kind)
        experiment_id = experiment
        if experiment is not None and not is_id("exp", experiment):
            experiment_id = ambit.experiments.upload(known.id, Path(experiment)).id
        try:
            job = ambit.jobs.submit(kind.value, known.id, experiment_id, options, priority)
        except RefusedError as error:
            if not error.detail.startswith("options."):
                raise
            raise typer.BadParameter(error.detail.removeprefix("options."), param_hint="--option") from error
        if not (follow or out):
            _print(job, as_json)
            return
        say(f"{job.id} on {known.name}")
        _finish(ambit, job, out, as_json)


def watch(
    job: Annotated[str, typer.Argument(help="Id of the job.", callback=job_id)],
    out: Annotated[Path | None, typer.Option(help="Fetch its files into this folder when it is done.")] = None,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Watch a job until it has ended and tell what it found; Ctrl-C ends the watching, not the job.

    Exit status 1 where the job failed or was cancelled, with the reason.
    """
    with client(url, key, ca) as ambit:
        _finish(ambit, ambit.jobs.get(job), out, as_json)


def cancel(
    job: Annotated[str, typer.Argument(help="Id of the job.", callback=job_id)],
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Cancel a job: an excitation ends within a second, what was measured is kept."""
    with client(url, key, ca) as ambit:
        _print(ambit.jobs.cancel(job), as_json)


def retry(
    job: Annotated[str, typer.Argument(help="Id of the job.", callback=job_id)],
    follow: Annotated[bool, typer.Option("--watch", help="Watch it until it has ended.")] = False,
    out: Annotated[Path | None, typer.Option(help="Watch it, then fetch its files into this folder.")] = None,
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Try a job again that failed or was cancelled; an experiment goes on with what it has measured."""
    with client(url, key, ca) as ambit:
        again = ambit.jobs.retry(job)
        if follow or out:
            _finish(ambit, again, out, as_json)
        else:
            _print(again, as_json)


def fetch(
    job: Annotated[str, typer.Argument(help="Id of the job.", callback=job_id)],
    out: Annotated[Path, typer.Option(help="Folder of the files.")],
    url: Url = None,
    key: Key = None,
    ca: Ca = None,
    as_json: Json = False,
) -> None:
    """Fetch all files that a job made: experiment, datasheet, result, report, diagnosis.

    Exit status 1 where the job is not done, with the reason: its files are then what it made so far.
    """
    from service.client.jobs import must_be_done

    with client(url, key, ca) as ambit:
        found = ambit.jobs.get(job)
        _files(ambit.save(found, out), as_json)
        must_be_done(found)  # a script must not take what is there for a result


def client(url: str | None, key: str | None, ca: Path | None, waiting: str = AGAIN) -> Client:
    """The service that the options, or the environment, name.

    Parameters
    ----------
    waiting
        What is said, once for each request, of a service that is away or busy, with the reason.
    """
    from service.client import Client

    if url is not None and not url.startswith(("http://", "https://")):
        raise typer.BadParameter(f"{url!r} is no address of a service, as http://127.0.0.1:8311", param_hint="--url")
    return Client(url, key, ca, waiting=lambda why: say(waiting.format(one_line(why))))


def _must_have_or_not(experiment: str | None, kind: Kind) -> None:
    """A calculation works on an experiment; what measures makes its own."""
    works_on_one = kind in (Kind.identification, Kind.gap)
    if works_on_one and experiment is None:
        raise typer.BadParameter(f"{kind.value} needs a file, or the id of an experiment", param_hint="--experiment")
    if experiment is not None and not works_on_one:
        raise typer.BadParameter(f"{kind.value} measures by itself; leave it out", param_hint="--experiment")


def _options(given: Iterable[str], quick: bool, excitation: Excitation | None, kind: Kind) -> dict[str, Any]:
    options: dict[str, Any] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise typer.BadParameter(f"{text!r} is no name=value", param_hint="--option")
        try:
            options[name] = json.loads(value)
        except ValueError:
            options[name] = value
    for hint, wanted in (("--quick", quick), ("--excitation", excitation)):
        if wanted and kind is not Kind.experiment:
            raise typer.BadParameter("is for an experiment", param_hint=hint)
    for name, hint, wanted in (("profile", "--quick", quick), ("excitation", "--excitation", excitation)):
        if wanted and name in options:
            raise typer.BadParameter(f"{hint} says it already; leave one of the two out", param_hint=f"--option {name}")
    if quick:
        options["profile"] = "quick"
    if excitation is not None:
        options["excitation"] = excitation.value
    return options


def _rig(ambit: Client, given: str, controller: str | None, change: bool, kind: Kind) -> Rig:
    """The rig that is meant; a datasheet makes it known, or with ``change`` gives it a new version.

    Two rigs of one make have datasheets of one name: the controller of one is not the other's by mistake. Nothing is
    made or changed for a job that could not move its rotor then.

    Raises
    ------
    ConflictError
        The service knows the rig by another controller or datasheet, and ``change`` is not given.
    NotFoundError
        It does not know the rig whose health is to be checked.
    """
    from service.client import MissingError
    from service.errors import NotFoundError
    from sim.rig_file import read

    path = Path(given)
    if path.suffix != ".toml":
        for hint, wanted in (("--controller", controller is not None), ("--change", change)):
            if wanted:
                raise typer.BadParameter("goes with --rig rig.toml", param_hint=hint)
        return ambit.rigs.named(given)
    name, text = read(path).name, path.read_text(encoding="utf-8")
    try:
        rig = ambit.rigs.named(name)
    except MissingError:
        if kind is Kind.health:
            raise NotFoundError(
                f"the service knows no rig {name!r}, so there is nothing to compare its health with; "
                f"commission it first: ambit submit experiment --rig {given} --controller URL"
            ) from None
        _must_be_reached(name, controller or "", kind)
        return ambit.rigs.create(text, controller or "")
    url = rig.controller_url if controller is None else controller
    same = (rig.datasheet, rig.controller_url) == (text, url)
    if not same and not change:
        _must_be_the_same(rig, given, text, url)
    _must_be_reached(name, url, kind)
    return rig if same else ambit.rigs.change(rig, text, url)


def _must_be_reached(name: str, url: str, kind: Kind) -> None:
    """A rotor is moved by its controller; a calculation needs none."""
    if not url and kind in (Kind.experiment, Kind.health):
        raise typer.BadParameter(
            f"the rig {name!r} has no controller yet, and {kind.value} moves its rotor; "
            "give the controller's URL, as modbus://10.0.0.7:502?unit=1",
            param_hint="--controller",
        )


def _must_be_the_same(rig: Rig, given: str, text: str, url: str) -> None:
    from service.errors import ConflictError

    other = []
    if rig.controller_url not in ("", url):
        other.append(f"the controller {rig.controller_url!r}, not {url!r}")
    for old, new in zip_longest(rig.datasheet.splitlines(), text.splitlines(), fillvalue=""):
        if old != new:
            other.append(f"a datasheet with {old.strip()!r}, not {new.strip()!r}")
            break
    if not other:
        return
    raise ConflictError(
        f"the rig {rig.name!r} ({rig.id}) has {' and '.join(other)}; "
        f"give --change to change it, or another name in {given}"
    )


def _finish(ambit: Client, job: Job, out: Path | None, as_json: bool) -> None:
    """Watch a job to its end, fetch what it made, and fail where it failed."""
    from service.cli.verdict import verdict
    from service.client.jobs import must_be_done

    try:
        ended = _watched(ambit, job)
    except KeyboardInterrupt:
        say(STILL.format(job.id))
        raise
    if out is not None and ended.result:
        files = ambit.save(ended, out)
        if not as_json:
            _files(files, as_json=False)
    if as_json:
        print_json(ended.model_dump(mode="json"))
    must_be_done(ended)
    if not as_json:
        for kind, made in ended.result.items():
            print(f"{kind}: {made}")
        if "model" in ended.result:
            print(f"report: {ambit.report_address(ended)}")
        if found := verdict(ambit, ended):
            print(found)


def _watched(ambit: Client, job: Job) -> Job:
    """The job at its end; a bar on a terminal, a line now and then in a log."""
    show = _bar if sys.stderr.isatty() else _log
    return show(ambit, job)


def _log(ambit: Client, job: Job) -> Job:
    shown_at, state, seen = 0.0, "", job
    for seen in ambit.jobs.watch(job.id):
        if seen.state != state or time.monotonic() - shown_at > LOG_EVERY_S:
            shown_at, state = time.monotonic(), seen.state
            say(_line(seen))
    return seen


def _bar(ambit: Client, job: Job) -> Job:
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (
        TextColumn("{task.description:<15}"),
        BarColumn(bar_width=None),
        TaskProgressColumn(),
        TextColumn("{task.fields[points]}"),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=stderr(), transient=True, expand=True) as bar:
        task = bar.add_task(job.state, total=100.0, points="", left="")
        seen = job
        for seen in ambit.jobs.watch(job.id):
            p = seen.progress
            bar.update(
                task,
                description=PHASE_WORDS.get(p.phase, p.phase) if seen.state == "running" and p.phase else seen.state,
                completed=p.percent,
                points=f"{p.point} of {p.points}" if p.points else "",
                left=_left(seen),
            )
    return seen


def _line(job: Job) -> str:
    p = job.progress
    points = f", point {p.point} of {p.points}" if p.points else ""
    left = _left(job)
    ended = p.phase.startswith(job.state)  # the phase of a job that has ended is its state, and why
    words = p.phase if ended else f"{job.state} {PHASE_WORDS.get(p.phase, p.phase)}".rstrip()
    return f"{words}: {p.percent:.0f} %{points}" + (f", {left}" if left else "")


def _left(job: Job) -> str:
    from service.report.format import duration

    left = job.progress.time_left_s
    return f"{duration(left)} left" if left is not None and job.state == "running" else ""


def _print(job: Job, as_json: bool) -> None:
    if as_json:
        print_json(job.model_dump(mode="json"))
    else:
        print(job.id)


def _files(files: dict[str, Path], as_json: bool) -> None:
    if as_json:
        print_json({"files": {name: str(path) for name, path in files.items()}})
        return
    for name, path in files.items():
        print(f"{name}: {path}")
