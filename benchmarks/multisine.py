"""Seconds on the rig against the standard deviation of ki and ks: stepped sine and multisine on the reference rig.

python benchmarks/multisine.py [runs of the multisine, default 20] [runs of the stepped sine, default 4]

Reported deviations are those of result.json; "MC" is the scatter of the errors over seeds of the rig's noise. The last
column is the time that the multisine would need for the stepped sine's reported deviation, as a share of the latter's
time: deviations fall with the root of the time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from drivers.simulated.driver import SimulatedController
from service.bootstrap import profile_for
from service.experiment.campaign import run_campaign
from service.experiment.data import Experiment
from service.identification.fit import identify
from sim.reference import reference_datasheet, reference_rig

RIG = reference_rig()


def measured(excitation: str, seed: int) -> tuple[Experiment, float]:
    """An experiment and the wall time that it took."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        rig = SimulatedController(RIG, seed=seed)
        experiment = run_campaign(rig, reference_datasheet(), Path(folder), profile=profile_for(excitation))
    return experiment, time.perf_counter() - began


def figures(experiment: Experiment) -> dict[str, tuple[float, float]]:
    """Error and reported deviation of every parameter, percent of the truth."""
    document: dict[str, Any] = identify(experiment, reference_datasheet()).document("experiment.h5")
    out = {}
    for p, (plane, found) in enumerate(document["planes"].items()):
        for b, bearing in enumerate("AB"):
            for name, truth in (("ki", RIG.magnets.ki), ("ks", RIG.magnets.ks)):
                value = found["stiffness"][name + bearing]
                true = truth[2 * p + b]
                out[f"{plane} {name}{bearing}"] = (100 * (value["value"] / true - 1), 100 * value["std"] / true)
        for k, (mode, true) in enumerate(zip(found["rotor_modes"], RIG.rotor.modes[p], strict=False)):
            for name, key, real in (
                ("wn", "natural_frequency_rad_s", true.natural_frequency_rad_s),
                ("zeta", "damping_ratio", true.damping_ratio),
            ):
                out[f"{plane} {name}{k + 1}"] = tuple(
                    100 * x for x in (mode[key]["value"] / real - 1, mode[key]["std"] / real)
                )
    return out


def main() -> None:
    arguments = [int(x) for x in sys.argv[1:]]
    runs = {"multisine": arguments[0] if arguments else 20, "stepped-sine": arguments[1] if len(arguments) > 1 else 4}
    errors: dict[str, dict[str, list[float]]] = {e: defaultdict(list) for e in runs}
    deviations: dict[str, dict[str, list[float]]] = {e: defaultdict(list) for e in runs}
    seconds = {}
    for excitation, count in runs.items():
        busy, wall = [], []
        for seed in range(1, count + 1):
            experiment, took = measured(excitation, seed)
            busy.append(float(experiment.attributes["rig_seconds"]))
            wall.append(took)
            for name, (error, deviation) in figures(experiment).items():
                errors[excitation][name].append(error)
                deviations[excitation][name].append(deviation)
        seconds[excitation] = float(np.mean(busy))
        print(f"{excitation}: {np.mean(busy):.0f} s on the rig, {np.mean(wall):.1f} s of wall time, {count} runs")
        sweeps = ", ".join(f"{s.comment} {s.time_s.max():.0f} s" for s in experiment.sweeps if s.time_s is not None)
        print(f"  sweeps end at: {sweeps}")
        print(f"  distortion over signal, dB: {experiment.attributes.get('distortion_db', 'not measured')}")
    share = seconds["multisine"] / seconds["stepped-sine"]
    print(f"\ntime of the multisine over that of the stepped sine: {share:.3f}\n")
    print("percent     stepped sine: std   MC      multisine: std   MC     bias   worst/std   time for equal std")
    for name in deviations["multisine"]:
        old, new = (float(np.mean(deviations[e][name])) for e in ("stepped-sine", "multisine"))
        mc = [float(np.std(errors[e][name], ddof=1)) if runs[e] > 1 else float("nan") for e in runs]
        e, s = np.array(errors["multisine"][name]), np.array(deviations["multisine"][name])
        print(
            f"{name:9s}{old:18.4f}{mc[1]:9.4f}{new:14.4f}{mc[0]:9.4f}{e.mean():+9.4f}{np.max(np.abs(e / s)):9.2f}"
            f"{share * (new / old) ** 2:18.3f}"
        )


if __name__ == "__main__":
    main()
