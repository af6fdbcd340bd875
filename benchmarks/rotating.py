"""A turning rotor, again and again: polar inertia, gyroscopic coupling and inertia against what is reported of them.

Run: python benchmarks/rotating.py [--runs 24]

Simulated rig with the exact force law at 0, 157 and 314 rad/s, noise of the practice files' size, no mode known.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from service.experiment.data import Experiment
from service.identification.fit import identify
from sim.reference import reference_datasheet
from tests.support.turning import COUPLING, INTERNAL, POLAR, SPEEDS, sweep_at


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    runs = parser.parse_args().runs
    sheet, values, stds, data, seconds = reference_datasheet(), [], [], [], []
    truth = {"polar inertia": POLAR, "g of mode 1": COUPLING, "g of mode 2": COUPLING, "transverse inertia": 10.87}
    truth |= {"turning damping 1": INTERNAL, "turning damping 2": INTERNAL}
    for seed in range(runs):
        sweeps = tuple(sweep_at(w, 10 * seed + k) for k, w in enumerate(SPEEDS))
        begin = time.process_time()
        turned = identify(Experiment("reference", sheet.axes, sweeps), sheet).rotating
        seconds.append(time.process_time() - begin)
        assert turned is not None
        pairs = [turned.pair_figures(k) for k in range(2)]
        found = [turned.estimate("polar_inertia_kgm2", ""), pairs[0][0], pairs[1][0]]
        found += [turned.estimate("transverse_inertia_kgm2", ""), pairs[0][1], pairs[1][1]]
        values.append([e.value for e in found])
        stds.append([e.std for e in found])
        data.append([e.std_from_data for e in found])
    value, std, part = np.array(values), np.array(stds), np.array(data)
    print(f"{runs} runs at {', '.join(f'{w:g}' for w in SPEEDS)} rad/s; CPU per run {np.median(seconds):.1f} s")
    print(f"{'':20}{'bias %':>9}{'sd %':>9}{'data sd/sd':>12}{'reported sd/sd':>16}{'within 1.96 sd':>16}")
    for k, (name, true) in enumerate(truth.items()):
        spread = value[:, k].std(ddof=1)
        inside = np.mean(np.abs(value[:, k] - true) < 1.96 * std[:, k])
        print(
            f"{name:20}{100 * (value[:, k].mean() / true - 1):9.4f}{100 * spread / true:9.4f}"
            f"{part[:, k].mean() / spread:12.2f}{std[:, k].mean() / spread:16.2f}{inside:16.2f}"
        )


if __name__ == "__main__":
    main()
