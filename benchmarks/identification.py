"""Identification at the statistical limit: CPU time, other tools beside it, Monte Carlo (`_monte_carlo`).

Run: python benchmarks/identification.py [--runs 200] [--first-seed 0] [--noise 0.01] [--peers-only]

Reference plant (Tables 5-1, 5-3, 5-5 and Appendix A of the thesis), 320 points, the noise relative to each signal; the
datasheet's ki is 88 % off, ks 37 %, and no mode is known. Seeds are fixed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import _one_thread  # noqa: F401  before numpy
import _peers
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from _monte_carlo import experiment, no_mode_known, reference_plane, splits_drawn, splits_known

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.joint.refine import refine
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from service.identification.plane_fit import fit_plane
from service.identification.priors.split import Split, log_ratios
from service.identification.steps.staged import staged_fit
from service.identification.steps.start import joint_start, with_split
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet

Result = TypeVar("Result")


def one_fit(noise: float) -> None:
    """CPU of the joint fit of 16 parameters, amplifiers known, from staged starting values."""
    sheet = reference_datasheet()
    data, truth = experiment(noise, 0), reference_plane()
    points = Data(plane_points(data.main, sheet.axes, "x"))
    layout = truth.layout
    fixed = tuple(n for n in layout.names if n.startswith("amplifier") or n == "delay_s")
    free = layout.free(fixed=fixed)
    rng = np.random.default_rng(0)
    start = truth.at(truth.theta * np.where(free, 1 + 0.03 * rng.normal(size=layout.size), 1.0))
    theta = start.theta.copy()
    for k in range(2):  # peaks are seen: their place is good from the start
        theta[layout.mode(k).start] = truth.theta[layout.mode(k).start] * (1 + 1e-4)
    start = start.at(theta)
    split = Split(log_ratios(truth))
    weights = refine(truth, points, free, split=split).weights
    spent, fit = timed(lambda: refine(start, points, free, weights=weights, nonlinear=False, split=split), 20)
    print(
        f"\nOne joint fit, {int(free.sum())} parameters, {len(points.plant.omega)} points: "
        f"{1e3 * spent:.1f} ms CPU, {fit.fit.iterations} steps"
    )


def beside(noise: float, data_sets: int = 5) -> None:
    """The joint fit, the whole procedure, and other tools on the same data."""
    sheet, cases = reference_datasheet(), []
    for seed in range(data_sets):
        data = experiment(noise, seed)
        begin = time.process_time()
        plane = identify(data, sheet).planes["x"]
        whole = time.process_time() - begin
        cases.append(_peers.Case(plane, joint_fit(data, sheet), whole))
    _peers.table(cases, reference_plane(), noise)


def joint_fit(data: Experiment, sheet: Datasheet) -> tuple[float, float, PlaneModel]:
    """CPU of one joint fit, amplifiers and noise known, and of the staged steps that it starts from; and its model."""
    found = fit_plane(data.main, None, None, sheet.axes, "x", sheet)
    points, plant = found.data.plant, found.plant

    def begun() -> PlaneModel:
        staged = staged_fit(found.staged.rigid_model, points, plant)
        return joint_start(staged.rigid_model, staged.rational, points, plant)

    starting, start = timed(begun)
    best = found.selected.refined.model
    split = Split(log_ratios(best))
    start = with_split(start, split.log_ratios)
    theta = start.theta.copy()
    theta[4 : start.layout.delay + 1] = best.theta[4 : best.layout.delay + 1]
    start = start.at(theta)
    fixed = tuple(n for n in start.layout.names if n.startswith("amplifier") or n == "delay_s")
    free = start.layout.free(fixed=fixed)
    weights = found.selected.refined.weights
    fitting, refined = timed(lambda: refine(start, found.data, free, weights=weights, split=split))
    return fitting, starting, refined.model


def timed(work: Callable[[], Result], times: int = 7) -> tuple[float, Result]:
    """Median CPU of some work, s, and what it gives."""
    spent = []
    for _ in range(times):
        begin = time.process_time()
        result = work()
        spent.append(time.process_time() - begin)
    return float(np.median(spent)), result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.01)
    parser.add_argument("--peers-only", action="store_true", help="the table of tools alone")
    arguments = parser.parse_args()
    if not arguments.peers_only:
        one_fit(arguments.noise)
    beside(arguments.noise)
    if arguments.peers_only:
        return
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.runs)
    splits_known(seeds, arguments.noise)
    no_mode_known(seeds, arguments.noise)
    splits_drawn(seeds, arguments.noise)


if __name__ == "__main__":
    main()
