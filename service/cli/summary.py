"""What a commissioning found, in a table that fits a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service.report.format import figures, number

if TYPE_CHECKING:
    from rich.table import Table

    from service.experiment.data import Experiment
    from sim.rig import Rig


@dataclass(frozen=True)
class Row:
    """One identified figure beside what it is compared with."""

    plane: str
    name: str
    unit: str
    value: float
    std: float
    reference: float | None
    """The truth of a simulated rig, or the datasheet's value."""

    @property
    def error_percent(self) -> float | None:
        """Deviation from the reference, percent of the reference."""
        return None if not self.reference else 100 * (self.value / self.reference - 1)


def rows(document: dict[str, Any], axes: tuple[str, ...], truth: Rig | None = None) -> Iterator[Row]:
    """Stiffness and modes of every plane; compared with the rig's truth where there is one, else with the datasheet.

    Parameters
    ----------
    document
        The contents of result.json.
    axes
        Names of the axes, in the order of the rig's.
    """
    for k, (name, plane) in enumerate(document["planes"].items()):
        yield from _stiffness(name, plane, axes, truth)
        yield from _modes(name, plane, k, truth)


def _stiffness(plane: str, found: dict[str, Any], axes: tuple[str, ...], truth: Rig | None) -> Iterator[Row]:
    for name in ("kiA", "kiB", "ksA", "ksB"):
        estimate = found["stiffness"][name]
        reference = estimate.get("nominal")
        if truth is not None:
            source = truth.magnets.ki if name.startswith("ki") else truth.magnets.ks
            reference = float(source[axes.index(plane + name[-1])])
        yield _row(plane, name, estimate, reference)


def _modes(plane: str, found: dict[str, Any], index: int, truth: Rig | None) -> Iterator[Row]:
    known = () if truth is None else truth.rotor.modes[index]
    for k, mode in enumerate(found["rotor_modes"]):
        w = mode["natural_frequency_rad_s"]
        same = min(known, key=lambda m: abs(m.natural_frequency_rad_s - w["value"]), default=None)
        yield _row(plane, f"wn{k + 1}", w, None if same is None else same.natural_frequency_rad_s)
        yield _row(plane, f"zeta{k + 1}", mode["damping_ratio"], None if same is None else same.damping_ratio)


def _row(plane: str, name: str, estimate: dict[str, Any], reference: float | None) -> Row:
    return Row(plane, name, estimate["unit"], estimate["value"], estimate["std"], reference)


def table(found: list[Row], reference: str) -> Table:
    """The rows as a table; ``reference`` heads the column of what they are compared with."""
    from rich import box
    from rich.table import Table

    out = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    out.add_column("plane")
    out.add_column("quantity")
    for head in ("identified", "std. dev.", reference, "difference %"):
        out.add_column(head, justify="right")
    last = ""
    for r in found:
        if last and r.plane != last:
            out.add_section()
        value, std = figures(r.value, r.std)
        out.add_row(
            r.plane if r.plane != last else "",
            f"{r.name}, {r.unit}" if r.unit else r.name,
            value,
            std,
            "" if r.reference is None else number(r.reference),
            "" if r.error_percent is None else f"{r.error_percent:+z.3f}",
        )
        last = r.plane
    return out


def fits(document: dict[str, Any]) -> list[str]:
    """NRMSE on the unseen sweep by plane and entry, in words."""
    out = []
    for name, plane in document["planes"].items():
        matrix, sweep = plane["cross_validation_fit_percent"], "unseen sweep"
        if matrix is None:
            matrix, sweep = plane["fit_percent"], "fitted sweep (no other one was measured)"
        a, b = (" ".join("-" if v is None else f"{v:.2f}" for v in row) for row in matrix)
        out.append(f"{name}-plane: NRMSE {a} / {b} % on the {sweep}")
    return out


def notes(document: dict[str, Any]) -> list[str]:
    """What the user must know beside the figures; points that were left out are counted, not listed."""
    out = [f"note: {text}" for text in document["warnings"]]
    for name, plane in document["planes"].items():
        own = [w for w in plane["warnings"] if " Hz: " not in w]
        out += [f"note, {name}-plane: {text}" for text in own]
        if left_out := len(plane["warnings"]) - len(own):
            out.append(f"note, {name}-plane: {left_out} points were not used; the report lists them")
    return out


def times(seconds: dict[str, float], experiment: Experiment) -> str:
    """Wall time by step, and how long the rig was busy.

    >>> from service.experiment.data import Experiment
    >>> times({"experiment": 31.0, "report": 0.5}, Experiment("r", ("xA", "xB"), (), {"rig_seconds": "1275.7"}))
    '31.5 s (experiment 31.0 s, report 0.5 s); the rig was busy for 21.3 min of its own time'
    """
    parts = ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items())
    busy = float(experiment.attributes.get("rig_seconds", 0.0))
    on_rig = f"; the rig was busy for {busy / 60:.1f} min of its own time" if busy else ""
    return f"{sum(seconds.values()):.1f} s ({parts}){on_rig}"


def compared(found: list[Row]) -> list[dict[str, Any]]:
    """Rows as JSON."""
    return [
        {
            "plane": r.plane,
            "name": r.name,
            "unit": r.unit,
            "value": r.value,
            "std": r.std,
            "reference": r.reference,
            "error_percent": r.error_percent,
        }
        for r in found
    ]
