"""A turning rotor, again and again: polar inertia, gyroscopic coupling and inertia against what is reported of them.

Run: python benchmarks/rotating.py [--runs 100] [--first-seed 0]

Simulated rig with the exact force law at 0, 157 and 314 rad/s, noise of the practice files' size, no mode known. Beside
what is reported stands the same fit of the same data told the exact noise: it draws the same lots, so what chance does
to a scatter or to a share of some runs is in both, and what the estimated noise costs is their difference.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import _one_thread  # noqa: F401  before numpy
import numpy as np
from scipy.stats import binom

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.rotating.turned import Turned
from sim.reference import reference_datasheet
from tests.support.turning import (
    COUPLING,
    INTERNAL,
    POLAR,
    SPEEDS,
    sweep_at,
    told_the_noise,
)

INSIDE = 1.96


def figures(turned: Turned) -> np.ndarray:
    """(figures, 3) values, reported deviations, and their part from data alone."""
    pairs = [turned.pair_figures(k) for k in range(2)]
    found = [turned.estimate("polar_inertia_kgm2", ""), pairs[0][0], pairs[1][0]]
    found += [turned.estimate("transverse_inertia_kgm2", ""), pairs[0][1], pairs[1][1]]
    return np.array([(e.value, e.std, e.std_from_data) for e in found])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    arguments = parser.parse_args()
    runs = arguments.runs
    sheet, own, told, seconds = reference_datasheet(), [], [], []
    truth = {"polar inertia": POLAR, "g of mode 1": COUPLING, "g of mode 2": COUPLING, "transverse inertia": 10.87}
    truth |= {"turning damping 1": INTERNAL, "turning damping 2": INTERNAL}
    for seed in range(arguments.first_seed, arguments.first_seed + runs):
        sweeps = tuple(sweep_at(w, 10 * seed + k) for k, w in enumerate(SPEEDS))
        begin = time.process_time()
        turned = identify(Experiment("reference", sheet.axes, sweeps), sheet).rotating
        seconds.append(time.process_time() - begin)
        assert turned is not None
        own.append(figures(turned))
        told.append(figures(told_the_noise(turned)))
    value, std, part = np.moveaxis(np.array(own), 2, 0)
    exact, _, bound = np.moveaxis(np.array(told), 2, 0)
    low, high = binom.interval(0.95, runs, 0.95)
    print(f"{runs} runs at {', '.join(f'{w:g}' for w in SPEEDS)} rad/s; CPU per run {np.median(seconds):.1f} s")
    print(f"chance alone lets 95 % intervals hold the truth in {low / runs:.2f} to {high / runs:.2f} of so many runs")
    head = f"{'':20}{'bias %':>9}{'sd %':>9}{'data sd/sd':>12}{'reported sd/sd':>16}{'within 1.96 sd':>16}"
    print(head + f"{'told the noise: sd/sd':>24}{'within':>8}{'sd by its':>11}{'data sd by its':>16}")
    for k, (name, true) in enumerate(truth.items()):
        spread, other = value[:, k].std(ddof=1), exact[:, k].std(ddof=1)
        inside = np.mean(np.abs(value[:, k] - true) < INSIDE * std[:, k])
        inside_told = np.mean(np.abs(exact[:, k] - true) < INSIDE * bound[:, k])
        print(
            f"{name:20}{100 * (value[:, k].mean() / true - 1):9.4f}{100 * spread / true:9.4f}"
            f"{part[:, k].mean() / spread:12.2f}{std[:, k].mean() / spread:16.2f}{inside:16.3f}"
            f"{bound[:, k].mean() / other:24.2f}{inside_told:8.3f}{spread / other:11.3f}"
            f"{part[:, k].mean() / bound[:, k].mean():16.3f}"
        )


if __name__ == "__main__":
    main()
