"""``ambit health``: short checks of a commissioned rig, with or without the service."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import Json, print_json, stdout
from service.cli.usage import value_of
from service.health import budget

if TYPE_CHECKING:
    from rich.table import Table

app = typer.Typer(no_args_is_help=True, help="Short checks of a commissioned rig: what drifted, and how sure that is.")

BaselineFolder = Annotated[Path, typer.Option(help="Folder of the commissioning: result.json and rig.toml.")]
STOPPING = "stopping: any excitation ramps to zero, what was measured is kept"
Budget = Annotated[float, typer.Option(help="Rig time of the check, s.", min=budget.SMALLEST_S, max=budget.LARGEST_S)]
PerYear = Annotated[
    float, typer.Option(help="False alarms a year that are accepted, over all figures.", min=1e-6, max=1.0)
]
ALLOWANCE = 0.2
History = Annotated[
    Path | None, typer.Option(help="Earlier checks, JSON lines; history.jsonl in the baseline's folder without it.")
]


@app.command()
def check(
    controller: Annotated[
        str, typer.Option(help="URL: modbus://, modbuss://, modbus+rtu://, canopen://, simulated:// or replay://.")
    ],
    baseline: BaselineFolder,
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    budget_s: Budget = budget.USUAL_S,
    false_alarms_per_year: PerYear = ALLOWANCE,
    history: History = None,
    as_json: Json = False,
) -> None:
    """Measure a few tones, compare with the commissioning; write health.json and health.html."""
    from drivers.errors import AddressError
    from service import bootstrap, checkup
    from service.cli.interrupt import asked_to_stop, kill_is_ctrl_c
    from service.cli.progress import campaign_progress
    from service.errors import JobError
    from service.health.sequential import Policy
    from service.output import results_in

    then, datasheet = checkup.read_baseline(baseline)
    file = checkup.ready_history(history or baseline / checkup.HISTORY)
    with results_in(out):
        with value_of("--budget-s", JobError):
            plan = checkup.plan_for(then, datasheet, budget_s)
        with value_of("--controller", AddressError), kill_is_ctrl_c():
            rig = bootstrap.connect(controller)
        try:
            with asked_to_stop(STOPPING) as cancelled, campaign_progress() as progress:
                experiment = checkup.measure_check(rig, datasheet, plan, out, progress, cancelled)
        finally:
            rig.close()
    done = checkup.compare_into(then, datasheet, experiment, out, file, Policy(false_alarms_per_year))
    _show(done.document, done.files, as_json)


@app.command()
def compare(
    experiment: Annotated[Path, typer.Argument(help="Experiment file of a check, HDF5 or MATLAB.")],
    baseline: BaselineFolder,
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    false_alarms_per_year: PerYear = ALLOWANCE,
    history: History = None,
    as_json: Json = False,
) -> None:
    """Compare an experiment that was measured before with the commissioning, and add it to the history of checks."""
    from service import checkup
    from service.experiment import file
    from service.health.sequential import Policy

    then, datasheet = checkup.read_baseline(baseline)
    measured = file.read(experiment)
    past = checkup.ready_history(history or baseline / checkup.HISTORY)
    done = checkup.compare_into(then, datasheet, measured, out, past, Policy(false_alarms_per_year))
    _show(done.document, done.files, as_json)


@app.command()
def plan(baseline: BaselineFolder, budget_s: Budget = budget.USUAL_S, as_json: Json = False) -> None:
    """Show which tones a check would take, and how well it would tell each figure."""
    from service import checkup
    from service.errors import JobError

    then, datasheet = checkup.read_baseline(baseline)
    with value_of("--budget-s", JobError):
        found = checkup.plan_for(then, datasheet, budget_s)
    if as_json:
        print_json(found.document())
        return
    console = stdout()
    tones = ", ".join(f"{f:.4g}" for f in found.profile.frequencies_hz)
    console.print(f"tones: {tones} Hz, every axis; about {found.expected_s:.0f} s of rig time", soft_wrap=True)
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("figure")
    table.add_column("expected std, %", justify="right")
    for name, value in found.std_percent.items():
        table.add_row(name, f"{value:.3g}")
    console.print(table)


@app.command()
def trend(
    of: Annotated[
        Path | None, typer.Argument(help="Folder of the commissioning, or the history.jsonl in it.", metavar="[PATH]")
    ] = None,
    baseline: Annotated[Path | None, typer.Option(help="The same folder, as for ambit health check.")] = None,
    history: Annotated[Path | None, typer.Option(help="Earlier checks, JSON lines, as for ambit health check.")] = None,
    false_alarms_per_year: Annotated[
        float | None,
        typer.Option(
            help="Steady changes a year that may be chance, over all figures; as the newest check's alarms without it.",
            min=1e-6,
            max=1.0,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Show how every figure went over the checks so far: of a commissioning's folder, or of a history elsewhere."""
    from service import checkup
    from service.errors import DocumentError
    from service.health.sequential import Policy
    from service.health.trend import allowance
    from service.health.trend import trend as series_of
    from service.report.format import change

    named = [path for path in (of, baseline, history) if path is not None]
    if len(named) != 1:
        raise typer.BadParameter(
            "give the commissioning's folder or its history.jsonl, once: PATH, --baseline or --history"
        )
    file = named[0] / checkup.HISTORY if baseline is not None or named[0].is_dir() else named[0]
    checks = checkup.read_history(file)
    if not checks:
        raise DocumentError(f"{file} holds no check; run ambit health check first")
    rule = allowance(checks) if false_alarms_per_year is None else Policy(false_alarms_per_year)
    found = series_of(checks, rule)
    if as_json:
        series = {k: s.document() for k, s in found.items()}
        print_json({"checks": len(checks), "false_alarms_per_year": rule.per_year, "series": series})
        return
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("figure")
    for head in ("last change, %", "slope, % a year", "in std. dev.", ""):
        table.add_column(head, justify="right")
    for name, s in found.items():
        last = change(s.change_percent[-1], math.hypot(s.std_percent[-1], s.baseline_std_percent))
        slope = "" if s.slope_percent_per_year is None else change(s.slope_percent_per_year, s.slope_std or 0.0)
        sigma = "" if s.significance is None else f"{s.significance:+z.1f}"
        table.add_row(name, last, slope, sigma, "steady" if s.drifting else "")
    stdout().print(table)
    told = f"steady: beyond chance, but for {rule.per_year:g} false alarms a year over all figures"
    stdout().print(told, style="dim")


@app.command()
def secret(as_json: Json = False) -> None:
    """Make a secret for signing webhooks; it is shown once."""
    from service.health.webhook import new_secret

    made = new_secret()
    if as_json:
        print_json({"secret": made})
        return
    print(made)


def _show(document: dict[str, Any], files: dict[str, Path], as_json: bool) -> None:
    if as_json:
        print_json(document | {"files": {k: str(v) for k, v in files.items()}})
        return
    from service.report.health import headline

    console = stdout()
    console.print(headline(document), soft_wrap=True)
    for note in document.get("notes", []):
        console.print(f"note: {note}", soft_wrap=True)
    console.print(_table(document))
    for name, path in files.items():
        console.print(f"{name}: {path}", soft_wrap=True)


def _table(document: dict[str, Any]) -> Table:
    from rich import box
    from rich.table import Table

    from service.report.format import change, figures, in_unit

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("figure")
    for head in ("commissioned", "now", "change, %", "in std. dev.", ""):
        table.add_column(head, justify="right")
    for name, p in document["parameters"].items():
        was, _ = figures(p["baseline"]["value"], p["baseline"]["std"])
        now, _ = figures(p["now"]["value"], p["now"]["std"])
        by = change(p["change_percent"], p["change_std_percent"])
        sigma, mark = f"{p['significance']:+z.1f}", "drifted" if p["drifted"] else ""
        table.add_row(in_unit(name, p["unit"]), was, now, by, sigma, mark)
    return table
