"""The catalogue of effects as a page: ``python -m sim.effect_page > docs/effects.md``."""

from __future__ import annotations

from typing import get_args

from sim.effect import Effect, Parameter, Path
from sim.effects import CATALOGUE

_INTRODUCTION = """\
# Effects that a twin can lack

Written from `sim/effects/` by `python -m sim.effect_page > docs/effects.md`; a test keeps the two equal. Each effect
is one small function from rig to rig, so the time simulation, the linear model and the harmonic balance have it from
one description. A strength makes the effect vanish at its null value; a shape says what it looks like and stays
typical there. A range that goes with a size of the rig is stated for the reference rig, whose size stands beside it:
on a rig of twice the mass, one with mass^-1 is half as far.
"""


def _row(p: Parameter) -> str:
    role = f"strength, null {p.null:g}" if p.strength else "shape"
    scale = ", by decades" if p.scale == "log" else ""
    scale += f", with {p.goes_with}" if p.goes_with else ""
    words = p.description.replace("|", "\\|")
    return f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g}{scale} | {p.typical:.4g} | {role} | {words} |"


def _section(one: Effect) -> str:
    conditions = [
        *([f"needs {one.needs_axes} axes"] if one.needs_axes > 2 else []),
        *(["shows at speed only"] if one.needs_speed else []),
        *(["nonlinear: harmonics and a gain that depends on amplitude"] if one.nonlinear else []),
    ]
    aliases = ", ".join(f"[{a}](#{a})" for a in one.aliases) or "none known"
    lines = [
        f"### {one.id}",
        "",
        f"Law: {one.law}.",
        "",
        *([f"Conditions: {'; '.join(conditions)}.", ""] if conditions else []),
        "| parameter | unit | range | typical | role | |",
        "|---|---|---|---|---|---|",
        *(_row(p) for p in one.parameters),
        "",
        f"- Signature: {one.signature}.",
        f"- Looks like: {aliases}.",
        f"- Told apart by: {one.separated_by}.",
        f"- Source: {one.source}.",
    ]
    return "\n".join(lines)


def effect_page() -> str:
    """Markdown of the whole catalogue, by the path of the loop where each effect acts.

    >>> "### loop_delay" in effect_page()
    True
    """
    parts = [_INTRODUCTION]
    for path in get_args(Path):
        parts += [f"## Path: {path}\n", *(_section(e) + "\n" for e in CATALOGUE.values() if e.path == path)]
    return "\n".join(parts)


if __name__ == "__main__":
    print(effect_page(), end="")
