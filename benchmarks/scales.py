"""The same gaps on rigs of other sizes: `python benchmarks/scales.py [--cases DIR] [--jobs J]`.

No verdict may hang on how heavy, large, fast or strong a rig is. Of a rig whose masses, displacements, lengths,
currents and times are multiplied by factors of their own, the same experiment is the same numbers multiplied, and its
diagnosis has to be the same. Cases are the practice ones where they are at hand, or else of another program.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
import h5py
import numpy as np
from foreign.cases import make, toml
from gap import PRACTICE, diagnosed

from service.pool import workers

DRAWN = 8
"""Cases of another program that are drawn where none are at hand."""


@dataclass(frozen=True)
class Scale:
    """Factors of a rig's units. ``gap`` is that of displacements at bearings, ``length`` that along the shaft."""

    mass: float = 1.0
    gap: float = 1.0
    length: float = 1.0
    current: float = 1.0
    time: float = 1.0

    def of(self, key: str) -> float:
        """Factor of a datasheet's value, by its name; 1 of what has no unit."""
        force = self.mass * self.gap / self.time**2
        inertia = self.mass * self.length**2
        known = {
            "mass_kg": self.mass,
            "transverse_inertia_kgm2": inertia,
            "polar_inertia_kgm2": inertia,
            "bearing_from_cog_m": self.length,
            "sensor_from_cog_m": self.length,
            "sensor_position_m": self.length,
            "shape_at_bearings": self.mass**-0.5,
            "shape_at_sensors": self.mass**-0.5,
            "current_stiffness_n_per_a": force / self.current,
            "position_stiffness_n_per_m": force / self.gap,
            "bias_current_a": self.current,
            "linear_range_m": self.gap,
            "displacement_m": self.gap,
            "current_a": self.current,
            "frequency_hz": 1 / self.time,
            "natural_frequency_hz": 1 / self.time,
            "bandwidth_hz": 1 / self.time,
            "sample_time_s": self.time,
            "computing_delay_s": self.time,
            "numerator": self.current / self.gap,
        }
        return known.get(key, 1.0)


def multiplied(value: Any, by: float) -> Any:
    return [multiplied(v, by) for v in value] if isinstance(value, list) else value * by


def scaled_sheet(sheet: dict[str, Any], scale: Scale) -> dict[str, Any]:
    def section(content: Any) -> Any:
        if isinstance(content, list):
            return [section(c) for c in content]
        return {k: multiplied(v, scale.of(k)) if scale.of(k) != 1 else v for k, v in content.items()}

    return {name: section(content) for name, content in sheet.items() if name != "rig"}


def write(case: Path, out: Path, scale: Scale) -> None:
    """The case folder ``case`` on another scale, as ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    sheet = tomllib.loads((case / "rig.toml").read_text())
    (out / "rig.toml").write_text(toml(sheet["rig"]["name"], scaled_sheet(sheet, scale)))
    truth = json.loads((case / "truth.json").read_text())
    (out / "truth.json").write_text(json.dumps({**truth, "changes": {}, "laws": truth.get("laws", truth["effects"])}))
    signals: dict[str, Callable[[Any], Any]] = {
        **dict.fromkeys(("R", "U", "I", "amplitude_a"), lambda v: v * scale.current),
        "Y": lambda v: v * scale.gap,
        "frequency_hz": lambda v: v / scale.time,
        "time_s": lambda v: v * scale.time,
    }
    with h5py.File(case / "experiment.h5") as old, h5py.File(out / "experiment.h5", "w") as new:
        new.attrs.update(old.attrs)
        for name, sweep in old["sweeps"].items():
            group = new.create_group(f"sweeps/{name}")
            group.attrs.update(sweep.attrs)
            group.attrs["sample_rate_hz"] = sweep.attrs["sample_rate_hz"] / scale.time
            group.attrs["speed_rad_s"] = sweep.attrs["speed_rad_s"] / scale.time
            for key, data in sweep.items():
                changed = signals.get(key, lambda v: v)(data[()])
                group.create_dataset(key, data=np.asarray(changed, dtype=data.dtype), compression="gzip")


SCALES = {
    "as it is": Scale(),
    "a hundredth of the mass": Scale(mass=0.01),
    "20 times the mass": Scale(mass=20.0),
    "4 times the air gap": Scale(gap=4.0),
    "a tenth of the length": Scale(length=0.1),
    "a tenth of the current": Scale(current=0.1),
    "10 times the current": Scale(current=10.0),
    "a third of the time": Scale(time=0.3),
}


def told(report: dict[str, Any]) -> tuple[str, float, float | None]:
    """Verdict, its probability and its closure."""
    v = report["verdict"]
    return "+".join(sorted(v["effects"])) or v["kind"], v["probability"], report["shrinkage"]["closure"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=Path, default=PRACTICE, help="folder of case folders")
    parser.add_argument("--seed", type=int, default=7, help="of the cases that are drawn where there are none")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    out = Path(tempfile.mkdtemp(prefix="scales-"))
    with workers(given.jobs) as pool:
        if not any(given.cases.glob("*/truth.json")):
            print(f"no cases in {given.cases.name}; {DRAWN} of another program are drawn")
            given.cases = out / "drawn"
            list(pool.map(make, range(DRAWN), [given.seed] * DRAWN, [given.cases] * DRAWN))
        cases = sorted(p.parent for p in given.cases.glob("*/truth.json"))
        first: list[tuple[str, float, float | None]] = []
        for words, scale in SCALES.items():
            folders = [out / words.replace(" ", "-") / case.name for case in cases]
            for case, folder in zip(cases, folders, strict=True):
                write(case, folder, scale)
            found = [told(report) for _, report, _ in pool.map(diagnosed, folders)]
            first = first or found
            pairs = list(zip(first, found, strict=True))
            others = [f"{c.name}: {b[0]} for {a[0]}" for c, (a, b) in zip(cases, pairs, strict=True) if a[0] != b[0]]
            moved = max(abs(a[1] - b[1]) for a, b in pairs)
            print(
                f"{words:25s} {len(cases) - len(others)} of {len(cases)} verdicts the same, probability at most "
                f"{moved:.3f} off{'; ' + ', '.join(others) if others else ''}",
                flush=True,
            )


if __name__ == "__main__":
    main()
