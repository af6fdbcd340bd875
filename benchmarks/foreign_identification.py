"""Identification of rigs that an independent program simulated: errors, coverage, and what each form of file gives.

Run: python benchmarks/foreign_identification.py [--rigs 12] [--seed 1] [--noise 1 3 10] [--loose]

The program (benchmarks/foreign) shares no line with this project. Each rig is the reference one or another rotor with
its own magnets, modes and controller; each is measured at every noise, and each measurement is identified as the
controller's own lock-in wrote it and as records, with four axes and with the x plane's two. Noise 1 is that of the
practice files: 20 nm and 2 mA per sample. Datasheets are off as those of the practice files, with mass, geometry and
sensor gains exact; with --loose they are off by all of their tolerances, those too.
"""

from __future__ import annotations

import argparse
import copy
import json
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
import h5py
import numpy as np
from foreign.cases import AXES, PRACTICE, TOLERANCE, datasheet, levitates, other_rotor, toml
from foreign.measure import LeftLimits, measure, plan
from foreign.rig import TS, Truth

from service.experiment.file import read
from service.identification.fit import identify
from service.identification.result.commissioning import CommissioningResult
from sim.rig_file import read as read_datasheet

FORMS = ("demodulated", "records", "two axes")
LIMITS = {"ki": 0.5, "ks": 0.5, "zeta": 10.0}
"""Percent."""
INSIDE = 1.96


def draw(index: int, seed: int, loose: bool) -> tuple[Truth, dict[str, Any], tuple, np.random.Generator]:
    """Rig ``index``, its datasheet, off as in the practice files or loosely, and the sweeps; half are other rotors."""
    rng = np.random.default_rng([seed, index])
    while True:
        rig = other_rotor(rng) if index % 2 else Truth()
        sheet = datasheet(rig, rng, TOLERANCE if loose else PRACTICE)
        if loose:
            rig.loop["sensor_gain"] = 1 + TOLERANCE["sensor_gain"] * rng.standard_normal(4)
        sweeps = plan(rig, rng, 0.6)
        try:
            if levitates(rig):
                loudest = copy.deepcopy(rig)
                loudest.noise_y, loudest.noise_i = 10 * rig.noise_y, 10 * rig.noise_i
                measure(loudest, sweeps[:1], copy.deepcopy(rng))
                return rig, sheet, sweeps, rng
        except LeftLimits:
            continue


def write(path: Path, sweeps: list[dict[str, np.ndarray]], axes: list[str]) -> None:
    """An experiment file with the sweeps' points that excite ``axes``, and these signals only."""
    n = len(axes)
    with h5py.File(path, "w") as f:
        f.attrs.update(format="amb-experiment", version=1, rig=path.stem, axes=json.dumps(axes))
        for k, (sweep, comment) in enumerate(zip(sweeps, ("main", "other amplitude"), strict=True)):
            g = f.create_group(f"sweeps/{k}")
            g.attrs.update(kind="stepped-sine", comment=comment, sample_rate_hz=1 / TS, speed_rad_s=0.0)
            points = sweep["axis"] < n
            for key in ("axis", "frequency_hz", "amplitude_a"):
                g[key] = sweep[key][points]
            if "r" in sweep:
                g["sample_start"] = sweep["sample_start"][: points.sum() + 1]
                for key in "ruiy":
                    g[key] = sweep[key][: sweep["sample_start"][points.sum()], :n]
            else:
                g["harmonics"] = np.arange(sweep["R"].shape[2], dtype=np.int8)
                for key in "RUIY":
                    g[key] = sweep[key][points][..., :n]


def narrowed(sheet: dict[str, Any]) -> dict[str, Any]:
    """The datasheet of the x plane alone."""
    out = copy.deepcopy(sheet)
    for section in ("bearings", "amplifier"):
        out[section] = {k: v[:2] if isinstance(v, list) else v for k, v in out[section].items()}
    return out


def results(rig: Truth, sheet: dict[str, Any], sweeps: tuple, seed: int) -> dict[str, CommissioningResult]:
    """What is identified from each form of one measurement."""
    out = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for form in FORMS:
            axes = AXES[:2] if form == "two axes" else AXES
            data = measure(rig, sweeps, np.random.default_rng(seed), records=form == "records")
            write(folder / "experiment.h5", data, axes)
            text = toml("foreign", narrowed(sheet) if form == "two axes" else sheet)
            (folder / "rig.toml").write_text(text.replace(json.dumps(AXES), json.dumps(axes)))
            out[form] = identify(read(folder / "experiment.h5"), read_datasheet(folder / "rig.toml"))
    return out


def unexplained(result: CommissioningResult) -> int:
    """Planes that do not behave as their model."""
    return sum(not plane.adequate for plane in result.planes.values())


def deviations(rig: Truth, result: CommissioningResult) -> tuple[dict[str, list[tuple[float, float]]], int]:
    """Error and reported standard deviation of each figure, percent of the truth; planes with wrong mode counts."""
    out: dict[str, list[tuple[float, float]]] = defaultdict(list)
    wrong = 0
    for p, plane in enumerate(result.planes.values()):
        for b, bearing in enumerate("AB"):
            for name, truth in (("ki", rig.ki), ("ks", rig.ks)):
                e, true = plane.stiffness[name + bearing], truth[2 * p + b]
                out[name].append((100 * (e.value / true - 1), 100 * e.std / true))
        modes = [m for m in plane.modes if m.kind == "rotor"]
        if len(modes) != len(rig.modes):
            wrong += 1
            continue
        for mode, (w, zeta, *_) in zip(modes, sorted(rig.modes), strict=True):
            for name, e, true in (("wn", mode.natural_frequency_rad_s, w), ("zeta", mode.damping_ratio, zeta)):
                out[name].append((100 * (e.value / true - 1), 100 * e.std / true))
    return out, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise", type=float, nargs="+", default=[1.0, 3.0, 10.0])
    parser.add_argument("--loose", action="store_true")
    args = parser.parse_args()
    begin = time.perf_counter()
    found: dict[tuple[float, str], dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    wrong: dict[tuple[float, str], int] = defaultdict(int)
    odd: dict[tuple[float, str], int] = defaultdict(int)
    for index in range(args.rigs):
        quiet, sheet, sweeps, _ = draw(index, args.seed, args.loose)
        for noise in args.noise:
            rig = copy.deepcopy(quiet)
            rig.noise_y, rig.noise_i = noise * quiet.noise_y, noise * quiet.noise_i
            for form, result in results(rig, sheet, sweeps, 1000 * args.seed + index).items():
                figures, bad = deviations(rig, result)
                wrong[noise, form] += bad
                odd[noise, form] += unexplained(result)
                for name, values in figures.items():
                    found[noise, form][name] += values
                    for error, std in values:
                        too_far = abs(error) > LIMITS.get(name, np.inf) and not args.loose
                        if too_far or abs(error) > 4 * std:
                            print(
                                f"rig {index}, noise {noise:g}, {form}: {name} off by {error:+.3f} %, std {std:.3f} %"
                            )
    print(f"\n{args.rigs} rigs in {time.perf_counter() - begin:.0f} s; errors and deviations in percent of the truth")
    print("wrong: planes with another number of modes; odd: planes told not to behave as their model")
    print(
        f"{'noise':>6} {'form':12}{'':6}{'worst':>9}{'rms':>9}{'std':>9}{'z rms':>7}{'inside 95 %':>13}{'wrong':>7}"
        f"{'odd':>5}"
    )
    for (noise, form), figures in found.items():
        for name, values in figures.items():
            e, s = np.array(values).T
            print(
                f"{noise:6g} {form:12}{name:6}{np.abs(e).max():9.4f}{np.sqrt(np.mean(e**2)):9.4f}{s.mean():9.4f}"
                f"{np.sqrt(np.mean((e / s) ** 2)):7.2f}{np.mean(np.abs(e) < INSIDE * s):13.3f}{wrong[noise, form]:7d}"
                f"{odd[noise, form]:5d}"
            )


if __name__ == "__main__":
    main()
