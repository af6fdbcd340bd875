"""Damping ratios of points in which something rang: errors, deviations and coverage, with it taken out and without.

Run: python benchmarks/ringing.py [--runs 16]

The linear loop of a plane, simulated step by step with sensors' noise of 20 nm: with its own delay after short and long
settling, where the loop damps the first mode with 5.6 1/s, and with 20, 30 and 34 us more, which leave 2.6, 1.1 and
0.5 1/s.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

import _one_thread  # noqa: F401  before numpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.ringing.transient import settled
from tests.support.planes import synthetic_experiment
from tests.support.ringing import AXES, late, run, sheet

CASES = ((0.0, 0.25), (0.0, 2.0), (20e-6, 1.5), (30e-6, 0.3), (30e-6, 3.0), (34e-6, 0.5))
"""Delay and settling, s."""
INSIDE = 1.96


def left_alone(data: Any, *_: Any) -> tuple[Any, tuple[()]]:
    return data, ()


def dampings(experiments: list[Experiment]) -> np.ndarray:
    """(runs, 2) of the first mode: value and reported deviation."""
    found = []
    for e in experiments:
        zeta = identify(e, sheet()).planes["x"].modes[0].damping_ratio
        found.append((zeta.value, zeta.std))
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=16)
    runs = parser.parse_args().runs
    print(f"zeta1 of {runs} runs: error (rms) and deviation (median) in percent, share of 95 % intervals that hold")
    print(f"{'delay us':>8} {'settled s':>10} {'':>12} {'error':>8} {'deviation':>10} {'inside':>8}")
    for delay_s, settle_s in CASES:
        truth = late(delay_s)
        true = truth.damping_ratios[0]
        experiments = [synthetic_experiment(run(settle_s, seed=k, truth=truth), axes=AXES) for k in range(runs)]
        for name, in_place in (("taken out", settled), ("left alone", left_alone)):
            with patch("service.identification.plane_fit.settled", in_place):
                found = dampings(experiments)
            error, std = found[:, 0] - true, found[:, 1]
            rms, typical = 100 * np.sqrt(np.mean(error**2)) / true, 100 * np.median(std) / true
            inside = np.mean(np.abs(error) < INSIDE * std)
            print(
                f"{1e6 * delay_s:8.0f} {settle_s:10.2f} {name:>12} {rms:8.2f} {typical:10.2f} {inside:8.2f}", flush=True
            )


if __name__ == "__main__":
    main()
