"""``ambit effects``: the catalogue of effects that a twin can lack."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.console import print_json, stdout
from service.cli.usage import value_of

if TYPE_CHECKING:
    from sim.effect import Effect


def effects(
    effect: Annotated[str | None, typer.Argument(help="Id of one effect; all in short without it.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the catalogue as JSON.")] = False,
) -> None:
    """List the effects that a diagnosis knows and a simulated rig can be given."""
    from sim.effects import CATALOGUE
    from sim.effects import effect as one

    with value_of("effect"):
        chosen = list(CATALOGUE.values()) if effect is None else [one(effect)]
    if as_json:
        print_json({"format": "amb-effects", "version": 1, "effects": [document(e) for e in chosen]})
    elif effect is None:
        _list(chosen)
    else:
        _describe(chosen[0])


def document(e: Effect) -> dict[str, Any]:
    """One effect as JSON."""
    return {
        "id": e.id,
        "path": e.path,
        "law": e.law,
        "signature": e.signature,
        "aliases": list(e.aliases),
        "separated_by": e.separated_by,
        "source": e.source,
        "needs_axes": e.needs_axes,
        "needs_speed": e.needs_speed,
        "nonlinear": e.nonlinear,
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "low": p.low,
                "high": p.high,
                "typical": p.typical,
                "null": p.null,
                "scale": p.scale,
                "goes_with": str(p.goes_with) if p.goes_with else None,
                "description": p.description,
            }
            for p in e.parameters
        ],
    }


def _list(chosen: list[Effect]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("path", "effect", "law"):
        table.add_column(head)
    order = ("controller", "amplifier", "plant", "additive")
    for e in sorted(chosen, key=lambda e: (order.index(e.path), e.id)):
        table.add_row(e.path, e.id, Text(e.law))  # brackets of a law are no markup
    stdout().print(table)


def _describe(e: Effect) -> None:
    console = stdout()
    console.print(f"[bold]{e.id}[/bold] acts in the {e.path} path")
    for name, text in (
        ("law", e.law),
        ("signature", e.signature),
        ("looks like", ", ".join(e.aliases) or "nothing else"),
        ("separated by", e.separated_by),
        ("source", e.source),
    ):
        console.print(f"{name}: {text}", markup=False, soft_wrap=True)
    for p in e.parameters:
        unit = f" {p.unit}" if p.unit else ""
        text = f"{p.name}: {p.low:g} to {p.high:g}{unit}, typically {p.typical:g}{unit}"
        text += f", with {p.goes_with}" if p.goes_with else ""
        text += f"; {p.description}"
        console.print(text, markup=False, soft_wrap=True)
