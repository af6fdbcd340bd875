"""What a commissioning found, in a table that fits a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service.report.format import decibel, figures, fixed, number, signed
from sim.datasheet import NOT_KNOWN, source_of

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
    error_percent: float | None
    """Of the identified value, percent of the truth; of the datasheet's value, percent of the identified one."""


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
        if truth is None:
            yield _row(plane, name, estimate, estimate.get("nominal"), estimate.get("error_percent"))
            continue
        source = truth.magnets.ki if name.startswith("ki") else truth.magnets.ks
        yield _beside(plane, name, estimate, float(source[axes.index(plane + name[-1])]))


def _modes(plane: str, found: dict[str, Any], index: int, truth: Rig | None) -> Iterator[Row]:
    known = () if truth is None else truth.rotor.modes[index]
    for k, mode in enumerate(found["rotor_modes"]):
        w = mode["natural_frequency_rad_s"]
        same = min(known, key=lambda m: abs(m.natural_frequency_rad_s - w["value"]), default=None)
        yield _beside(plane, f"wn{k + 1}", w, None if same is None else same.natural_frequency_rad_s)
        yield _beside(plane, f"zeta{k + 1}", mode["damping_ratio"], None if same is None else same.damping_ratio)


def _beside(plane: str, name: str, estimate: dict[str, Any], truth: float | None) -> Row:
    return _row(plane, name, estimate, truth, 100 * (estimate["value"] / truth - 1) if truth else None)


def _row(plane: str, name: str, estimate: dict[str, Any], reference: float | None, error_percent: float | None) -> Row:
    return Row(plane, name, estimate["unit"], estimate["value"], estimate["std"], reference, error_percent)


def table(found: list[Row], reference: str) -> Table:
    """The rows as a table; ``reference`` heads the column of what they are compared with: "truth" or "datasheet"."""
    from rich import box
    from rich.table import Table

    out = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    out.add_column("plane")
    out.add_column("quantity")
    # the sign of the report and of result.json: what is off is the datasheet
    off = "datasheet off by, %" if reference == "datasheet" else "difference, %"
    for head in ("identified", "std. dev.", reference, off):
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
            "" if r.reference is None else signed(r.error_percent, 1 if reference == "datasheet" else 3),
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


def margins(document: dict[str, Any]) -> list[str]:
    """Peak of the sensitivity by plane and axis, with the zone that the worst is in.

    >>> found = {"sensitivity_peak": {"A": 2.0, "B": 3.0}, "iso_14839_3_zone": "B", "zone_limits_db": {"A": 9.5}}
    >>> margins({"planes": {"x": {"margins": found}}})
    ["x-plane: sensitivity peak A 2.00 (6.0 dB), B 3.00 (9.5 dB), zone B of the rig's own table"]
    """
    out = []
    for name, plane in document["planes"].items():
        found = plane["margins"]
        peaks = (f"{axis} {fixed(s, 2)} ({fixed(decibel(s))} dB)" for axis, s in found["sensitivity_peak"].items())
        zone = found["iso_14839_3_zone"]
        told = f"zone {zone} of {source_of(found['zone_limits_db'].items())}" if zone != NOT_KNOWN else "zone not known"
        out.append(f"{name}-plane: sensitivity peak {', '.join(peaks)}, {told}")
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
    busy = experiment.rig_seconds
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
