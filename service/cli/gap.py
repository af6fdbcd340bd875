"""``ambit gap``: where the twin differs from the rig, which effect does it, and a twin that has it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import Json, print_json, stdout
from service.cli.garbage import seldom_collected
from service.remarks import say
from sim.wording import in_words

if TYPE_CHECKING:
    from rich.table import Table

app = typer.Typer(no_args_is_help=True, help="Diagnose the gap between the twin and the rig, and close it.")


@app.command()
def diagnose(
    experiment: Annotated[Path, typer.Argument(help="Experiment file: HDF5 or MATLAB.")],
    rig: Annotated[Path, typer.Option(help="Datasheet or twin file of the rig, rig.toml.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON on stdout.")] = False,
) -> None:
    """Diagnose the gap between a rig's experiment and its twin; write gap.json and gap.html."""
    with seldom_collected():
        from service import bootstrap
        from service.cli.progress import percent_progress
        from service.experiment import file
        from service.output import results_in
        from sim.rig_file import read

        datasheet = read(rig)
        with results_in(out):
            measured = file.read(experiment)
            with percent_progress("reading the experiment") as tell:
                document, files = bootstrap.diagnose_into(measured, datasheet, out, jobs, tell)
    if as_json:
        print_json(document | {"files": {k: str(v) for k, v in files.items()}})
        return
    from service.gap.document import likeliest

    console = stdout()
    console.print(document["verdict"]["sentence"], soft_wrap=True)
    for note in document["notes"]:
        console.print(f"note: {note}", soft_wrap=True)
    if document["candidates"]:
        console.print(_candidates(likeliest(document)[:5], document["verdict"]["kind"]))
    if proposed := document["next_experiment"]:
        console.print(_proposal(proposed), soft_wrap=True, markup=False)
    for name, path in files.items():
        console.print(f"{name}: {path}", soft_wrap=True)


@app.command()
def apply(
    report: Annotated[Path, typer.Argument(help="gap.json of a diagnosis.")],
    rig: Annotated[Path, typer.Option(help="Datasheet that was diagnosed.")],
    out: Annotated[Path, typer.Option(help="Twin file to write: the datasheet with the effects that were found.")],
    as_json: Json = False,
) -> None:
    """Write a twin that has the effects that a diagnosis found.

    Warns where the data do not tell one of them from another, and where the twin does not levitate. Without a gap it is
    the datasheet as it is, and without the effects that it names and the rig does not show. Fails where there is a gap
    that no effect explains.
    """
    from service.errors import OutputError
    from service.gap.apply import applied, cannot_run, not_told_apart, of_another
    from service.gap.document import ends_reached
    from service.gap.shape import Report
    from service.output import read_document, ready_folder, write_text
    from sim.rig_file import read, to_toml

    datasheet = read(rig)
    if out.exists() and out.samefile(rig):
        raise OutputError(f"{out} is the datasheet itself, which later diagnoses begin from; give --out another name")
    ready_folder(out.parent)
    document = read_document(report, "amb-gap-report", Report)
    twin = applied(datasheet, document)
    write_text(out, to_toml(twin))
    gone = [name for name, _ in datasheet.effects if name not in dict(twin.effects)]
    off, ends, warnings = document["datasheet_off"], ends_reached(document), list[str]()
    if of_another(datasheet, document):
        warnings.append(
            f"{report} was made with another datasheet than {rig}; its effects were fitted beside that one's "
            "values: give it, or diagnose again with this one"
        )
    unsure, probability = not_told_apart(document), document["verdict"]["probability"]
    warnings += [_unsure(named, rivals, probability) for named, rivals in unsure.items()]
    if reason := cannot_run(twin):
        warnings.append(
            f"this twin cannot be simulated or served as it stands, {reason}; identify the experiment with "
            "it, ambit identify --rig, and give it the ki, ks and modes that come out"
        )
    if as_json:
        added = [one for one in twin.effects if one not in datasheet.effects]
        print_json(
            {
                "rig": twin.name,
                "files": {"twin": str(out)},
                "added": [{"effect": name, "parameters": dict(values)} for name, values in added],
                "removed": gone,
                "not_told_apart": unsure,
                "probability": probability,
                "datasheet_off": off,
                "ends_reached": ends,
                "warnings": warnings,
            }
        )
        return
    if gone:
        print(f"{out}: {twin.name} without {', '.join(gone)}, which the rig does not show as the twin named it")
    elif twin == datasheet:
        print(f"{out}: {twin.name} as its datasheet has it: the diagnosis found no gap, so there is no effect to add")
    else:
        print(f"{out}: {twin.name} with {', '.join(name for name, _ in twin.effects)}")
    if off:
        print(f"note: the datasheet's own values stay, far off as they are ({', '.join(off)}); identify measures them")
    for note in ends:
        print(f"note: {note}")
    for warning in warnings:
        say(f"warning: {warning}")


@app.command()
def blind_trial(
    out: Annotated[Path, typer.Option(help="Folder of the trial: one folder a case, and trial.json.")],
    cases: Annotated[int, typer.Option(help="How many rigs are drawn.", min=1)] = 20,
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.", min=0)] = 1,
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print trial.json's scores as JSON on stdout.")] = False,
) -> None:
    """Withhold effects on simulated rigs, seal the truth, measure, diagnose, open the seal and score.

    A trial that was stopped, by Ctrl-C or a kill, goes on when it is called again.
    """
    from service.cli.interrupt import kill_is_ctrl_c
    from service.output import ready_folder
    from service.trial import run_blind_trial

    ready_folder(out)
    with kill_is_ctrl_c():
        trial = run_blind_trial(
            cases, seed, out, lambda k, n, text: say(f"{k} of {n}: {text}"), jobs or os.cpu_count() or 1
        )
    scores = trial["scores"]
    if as_json:
        print_json({"format": trial["format"], "version": trial["version"], "seed": seed, "scores": scores})
        return
    console = stdout()
    console.print(_scores(scores))
    console.print(f"trial: {out / 'trial.json'}", soft_wrap=True)


@app.command("open")
def open_sealed(
    sealed: Annotated[Path, typer.Argument(help="Sealed file of ambit rig serve --withheld, or of a blind trial.")],
    commitment: Annotated[str, typer.Option(help="As it was shown when the rig was served.")],
    gap: Annotated[Path, typer.Option(help="gap.json of the diagnosis.")],
    experiment: Annotated[
        Path | None,
        typer.Option(
            help="Experiment that was diagnosed: tells how plainly the truth shows in it. Without it, not to find "
            "what is hardly there counts as wrong."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print truth and score as JSON on stdout.")] = False,
) -> None:
    """Open what was withheld and score its diagnosis; fails when the sealed file is not what was committed to.

    Fails, too, when the diagnosis is of another case.
    """
    from service.experiment import file
    from service.gap.shape import ScoredReport
    from service.gap.trial.opening import opened_document
    from service.output import read_document
    from sim.withheld.seal import FORMAT

    report = read_document(gap, "amb-gap-report", ScoredReport)
    measured = None if experiment is None else file.read(experiment)
    document = opened_document(read_document(sealed, FORMAT), commitment, report, measured)
    if as_json:
        print_json(document)
        return
    print(document["sentence"])
    for note in document["notes"]:
        say(f"note: {note}")


def _scores(scores: dict[str, Any]) -> Table:
    """The figures that a trial is judged by; a dash where no case tells."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("score")
    table.add_column("value", justify="right")
    for name, value in _told(scores):
        table.add_row(name, value)
    return table


def _told(scores: dict[str, Any]) -> Iterator[tuple[str, str]]:
    single, unlisted = scores["single"], scores["unlisted"]
    yield "cases: single, mixed, clean, outside the catalogue", ", ".join(str(n) for n in scores["cases"].values())
    yield "of these detectable", ", ".join(str(n) for n in scores["detectable"].values())
    for name, share in (
        ("first answer is the effect", single["top1"]),
        ("first answer by alias class", single["top1_by_class"]),
        ("both effects of a mixture", scores["mixture"]["both_found"]),
        ("laws outside the catalogue recognised", unlisted["recall"]),
        ("effects of the catalogue taken for one outside", unlisted["false_abstention"]),
        ("false alarms on clean rigs", scores["clean"]["false_alarms"]),
        ("closure over that of the true effect, median", scores["closure"]["of_true_effect_median"]),
    ):
        yield name, "–" if share is None else f"{100 * share:z.0f} %"
    found = scores["parameters"]
    for name, share in (
        ("error of a strength, median", found["relative_error_median"]),
        ("strengths within 15 %", found["within_15_percent"]),
        ("95 % intervals that hold the true value", found["coverage_95"]),
    ):
        yield name, "–" if share is None else f"{100 * share:.1f} %"
    for name, value in (("expected calibration error", "ece"), ("Brier score", "brier")):
        error = scores["calibration"][value]
        yield name, "–" if error is None else f"{error:.3f}"


def _end(parameter: dict[str, Any]) -> str:
    return f" ({parameter['at_bound']} end of its range)" if parameter.get("at_bound") else ""


def _unsure(named: str, rivals: list[str], probability: float | None) -> str:
    """That the data leave open which effect it is; the ``probability`` is that it is one of them."""
    sure = "" if probability is None else f" (probability that it is one of these {100 * probability:.0f} %)"
    return (
        f"the data do not tell {in_words(named)} from {', '.join(map(in_words, rivals))}{sure}: the twin has "
        f"{in_words(named)}, the rig may have another one; the diagnosis tells what separates them"
    )


def _proposal(proposed: dict[str, Any]) -> str:
    """The next experiment in words: how long it takes, what it promises, what is done by hand, and what asks for it."""
    odds, minutes = 100 * proposed["odds_of_telling_apart"], proposed["rig_seconds"] / 60
    one, other = (in_words(name) for name in proposed["separates"])
    words = (
        f"next: {proposed['description']}; {minutes:.0f} min on the rig, {odds:.0f} % likely to tell {one} from {other}"
    )
    if steps := proposed.get("by_hand"):
        # the command does none of them, and would measure the rotor as it stands
        return "\n".join([words, *(f"by hand: {step}" for step in steps), f"then: {proposed['command']}"])
    return f"{words}: {proposed['command']}"


def _candidates(found: list[dict[str, Any]], kind: str) -> Table:
    """The likeliest explanations of a verdict of that ``kind``; where none of them is named, their heading says so."""
    from rich import box
    from rich.table import Table

    from service.gap.document import parameters_used

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("rejected explanation" if kind == "none_of_these" else "explanation")
    likely = "among those tried" if kind == "none_of_these" else "probability"
    for head in (likely, "closure", "parameters"):
        table.add_column(head, justify="left" if head == "parameters" else "right")
    for c in found:
        values = ", ".join(f"{name} {e['value']:.4g}{_end(e)}" for name, e in parameters_used(c).items())
        closure = (
            ("not shown" if c.get("open_strength") else "") if c["closure"] is None else f"{100 * c['closure']:z.0f} %"
        )
        table.add_row(c["effect"], f"{100 * c['probability']:.1f} %", closure, values)
    return table
