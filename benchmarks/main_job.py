"""The main job: a whole experiment on the simulated reference rig, identified, against the truth of that rig.

`python benchmarks/main_job.py` prints the worst errors of stiffness and modes, the fit on the unseen sweep, the
CPU of the identification of each plane, and the wall time of it all; then the stiffness of a practice experiment of
another program, where the sibling folder `shared/practice` is at hand.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import _one_thread  # noqa: F401  before numpy

from drivers.simulated.driver import SimulatedController
from service.campaign.run import run_campaign
from service.experiment import file
from service.identification.fit import identify
from sim import rig_file
from sim.reference import reference_datasheet, reference_rig

PRACTICE = Path(__file__).resolve().parents[2] / "shared" / "practice" / "p01"


def main_job() -> None:
    rig, datasheet = reference_rig(), reference_datasheet()
    controller = SimulatedController(rig, seed=1)
    begin, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        experiment = run_campaign(controller, datasheet, Path(folder))
    measured = time.perf_counter() - begin, time.process_time() - cpu
    cpu = time.process_time()
    planes = identify(experiment, datasheet).document()["planes"]
    identified = time.process_time() - cpu
    worst = {"ki": 0.0, "ks": 0.0, "wn": 0.0, "zeta": 0.0}
    for k, plane in enumerate(("x", "y")):
        found = planes[plane]
        for side in range(2):
            for name, truth in (("ki", rig.magnets.ki), ("ks", rig.magnets.ks)):
                value = found["stiffness"][f"{name}{'AB'[side]}"]["value"]
                worst[name] = max(worst[name], abs(value / truth[2 * k + side] - 1))
        for mode, truth_mode in zip(found["rotor_modes"], rig.rotor.modes[k], strict=True):
            wn, zeta = mode["natural_frequency_rad_s"]["value"], mode["damping_ratio"]["value"]
            worst["wn"] = max(worst["wn"], abs(wn / truth_mode.natural_frequency_rad_s - 1))
            worst["zeta"] = max(worst["zeta"], abs(zeta / truth_mode.damping_ratio - 1))
    fits = [f for p in planes.values() for row in p["cross_validation_fit_percent"] for f in row]
    print("largest error against the truth, %: " + ", ".join(f"{k} {100 * v:.3f}" for k, v in worst.items()))
    print(f"smallest NRMSE of any entry on the unseen sweep: {min(fits):.2f} %")
    print(f"experiment {measured[0]:.1f} s, {measured[1]:.1f} s of CPU")
    print(f"identification {identified / len(planes):.2f} s of CPU a plane")


def practice() -> None:
    if not PRACTICE.exists():
        print("practice experiment of another program: not at hand, left out")
        return
    found = identify(file.read(PRACTICE / "experiment.h5"), rig_file.read(PRACTICE / "rig.toml")).document()
    truth = {"x": (181, 186, 1.68e6, 1.73e6), "y": (184, 198, 1.69e6, 1.88e6)}
    errors = [
        abs(found["planes"][plane]["stiffness"][name]["value"] / value - 1)
        for plane, values in truth.items()
        for name, value in zip(("kiA", "kiB", "ksA", "ksB"), values, strict=True)
    ]
    print(f"practice p01, largest error of ki and ks: {100 * max(errors):.3f} %")


if __name__ == "__main__":
    main_job()
    practice()
