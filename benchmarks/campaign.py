"""What a whole campaign on the reference rig costs, and how near the measured plant is to the true one.

python benchmarks/campaign.py
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from pathlib import Path

import _one_thread  # noqa: F401  before numpy
import numpy as np

from drivers.simulated.driver import SimulatedController
from service.campaign.progress import Progress
from service.campaign.run import run_campaign
from service.experiment.data import Sweep
from sim.reference import reference_datasheet, reference_rig
from sim.twin import linear_model


def nrmse_percent(sweep: Sweep, plane: slice) -> np.ndarray:
    """NRMSE (eq. 6.1) of the measured against the true plant of one plane, per entry."""
    n = 4
    f = np.unique(sweep.frequency_hz)
    U, Y = (x[:, :, 1].mean(axis=1).reshape(len(f), n, n).swapaxes(1, 2) for x in (sweep.U, sweep.Y))
    measured = (Y @ np.linalg.inv(U))[:, plane, plane]
    true = linear_model(reference_rig(), f).y_per_u[:, plane, plane]
    size = np.abs(true - true.mean(axis=0))
    return 100 * (1 - np.sqrt(np.sum(np.abs(measured - true) ** 2, axis=0) / np.sum(size**2, axis=0)))


def main() -> None:
    rig = SimulatedController(reference_rig(), seed=1)
    reports: list[Progress] = []
    with tempfile.TemporaryDirectory() as folder:
        wall, cpu = time.perf_counter(), time.process_time()
        experiment = run_campaign(rig, reference_datasheet(), Path(folder), progress=reports.append)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        size = (Path(folder) / "experiment.h5").stat().st_size
    seconds = reports[-1].rig_seconds
    print(f"rig time {seconds:.0f} s, CPU {cpu:.1f} s, wall {wall:.1f} s: {seconds / cpu:.0f} times real time")
    print(f"experiment.h5 {size / 1e6:.1f} MB")
    for s in experiment.sweeps:
        marks = Counter(f for f in s.flags if f)
        print(
            f"{s.comment:12s} {s.n_points:4d} points, {len(np.unique(s.frequency_hz)):3d} frequencies, "
            f"{s.amplitude_a.min():.3g} to {s.amplitude_a.max():.3g} A, "
            f"displacement up to {np.abs(s.Y[:, :, 1]).max() * 1e6:.2f} um, marked {dict(marks)}"
        )
    for name in ("main", "validation"):
        sweep = experiment.named(name)
        assert sweep is not None
        for plane, where in (("x", slice(0, 2)), ("y", slice(2, 4))):
            print(f"{name}, plane {plane}: NRMSE {nrmse_percent(sweep, where).round(2).tolist()} %")


if __name__ == "__main__":
    main()
