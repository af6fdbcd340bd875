"""``ambit check-controller``: whether a controller would hold the rig that was identified."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import print_json, stdout
from service.cli.usage import value_of

if TYPE_CHECKING:
    from rich.table import Table


def check_controller(
    controller: Annotated[Path, typer.Argument(help="TOML file with a \\[controller] section, as in rig.toml.")],
    baseline: Annotated[Path, typer.Option(help="Folder of the commissioning: result.json and rig.toml.")],
    zones: Annotated[
        str,
        typer.Option(help="Upper limits of the zones, dB, rising, as A=9.5,B=12,C=14,D; the datasheet's without it."),
    ] = "",
    accept: Annotated[str, typer.Option(help="Worst zone that is safe.")] = "B",
    out: Annotated[Path | None, typer.Option(help="File to write the result to, JSON.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")] = False,
) -> None:
    """Judge a controller on the identified model and its uncertainty, before it is loaded.

    The gain, phase and delay margins are of one axis' loop, the others closed; a delay that all of them have, as
    computing_delay_s of the file, is in the verdict. Where the commissioning has a model of the turning rotor, so are
    stability and zone at every speed of its Campbell diagram; where it has none, the verdict is for standstill and says
    so. Where a model does not describe the rig, or an axis has none, the verdict is that it is not known. Exit status 0
    when it is safe, 1 when it is not or not known.
    """
    import numpy as np

    from service.checkup import read_baseline
    from service.identification.controller.check import check_controller as checked
    from service.identification.loop.margins import zone_table
    from service.identification.result.saved import saved_planes, saved_rotor
    from service.output import json_text, write_text

    then, datasheet = read_baseline(baseline)
    law, sample_time_s, computing_delay_s = read_law(controller)
    with value_of("--zones"):
        table = zone_table(zones) if zones else datasheet.sensitivity_zones_db
    if accept not in dict(table):
        raise typer.BadParameter(f"{accept!r} is none of the zones {', '.join(dict(table))}", param_hint="--accept")
    found = checked(
        datasheet.name,
        saved_planes(then.document, datasheet),
        (np.array(law[0]), np.array(law[1])),
        sample_time_s,
        table,
        accept,
        computing_delay_s=computing_delay_s,
        rotor=saved_rotor(then.document, datasheet),
    )
    document = found.document()
    if out is not None:
        write_text(out, json_text(document))
    if as_json:
        print_json(document)
    else:
        _show(document)
    if not found.safe:
        from service.errors import ControllerRefusedError

        raise ControllerRefusedError(
            f"the controller is not safe on {datasheet.name}: {found.reasons[0]}"
            if found.reasons
            else f"whether the controller is safe on {datasheet.name} is not known: {found.not_known[0]}"
        )


def read_law(path: Path) -> tuple[tuple[list[float], list[float]], float | None, float | None]:
    """Numerator and denominator of a file's [controller] section, its sample time and delay where it states them.

    Raises
    ------
    DocumentError
        The file cannot be read, or has no such section.
    """
    from service.errors import DocumentError

    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))["controller"]
        law = [float(v) for v in found["numerator"]], [float(v) for v in found["denominator"]]
        period, delay = (
            None if (v := found.get(k)) is None else float(v) for k in ("sample_time_s", "computing_delay_s")
        )
        return law, period, delay
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DocumentError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DocumentError(
            f"{path} has no [controller] section with numerator and denominator as lists of numbers ({error}); "
            "write it as in rig.toml"
        ) from error


def _show(document: dict[str, Any]) -> None:
    console = stdout()
    turning = document["at_speed"]
    where = " at standstill; at speed it is not known" if document["verdict"] == "safe" and turning is None else ""
    console.print(f"verdict: {document['verdict']}{where}")
    for kind, head in (("reasons", "reason"), ("not_known", "not known"), ("warnings", "warning")):
        for text in document[kind]:
            console.print(f"{head}: {text}", soft_wrap=True)
    if document["axes"]:
        console.print(_margins(document["axes"]))
    if turning is not None and turning["axes"]:
        slowest, fastest = (turning["speeds_rad_s"][k] for k in (0, -1))
        console.print(f"at speed, the worst from {slowest:.4g} to {fastest:.4g} rad/s")
        console.print(_margins(turning["axes"]))
    if document["axes"]:
        console.print("gain, phase and delay: of one axis' loop, the others closed", style="dim")
    for plane, later in document["delay_of_both_axes_s"].items():
        most = "a sample or more" if later is None else f"{_number(1e6 * later, 1)} us"
        console.print(f"{plane}-plane: both axes may be later by {most} at once, as by longer computing")


def _margins(axes: dict[str, Any]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("axis")
    for head in ("peak of S", "95 %", "zone", "gain, dB", "phase, deg", "delay, us"):
        table.add_column(head, justify="right")
    for name, a in axes.items():
        p, g = a["sensitivity_peak"], a["gain_margin_db"]
        table.add_row(
            name,
            _number(p["value"], 3),
            f"{_number(p['low'], 3)} to {_number(p['high'], 3)}",
            a["iso_14839_3_zone"],
            f"{_number(g['down']['value'], 1)} / {_number(g['up']['value'], 1)}",
            _number(a["phase_margin_deg"]["value"], 1),
            _number(None if a["delay_margin_s"]["value"] is None else 1e6 * a["delay_margin_s"]["value"], 1),
        )
    return table


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
