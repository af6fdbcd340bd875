"""The main job on rigs that nobody chose: drawn rotors, magnets, sampling rates and controllers, experiment to result.

Run: python benchmarks/other_rigs.py [--rigs 12] [--first-seed 0] [--multisine]

The rigs are those of tests/support/whole_rigs.py, simulated; what is printed is to be compared with the truth.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from itertools import count, islice
from pathlib import Path

import _one_thread  # noqa: F401  before numpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from drivers.simulated.driver import SimulatedController
from service.campaign.aims import Profile
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.progress import Progress
from service.campaign.run import run_campaign
from service.identification.fit import identify
from tests.support.planes import plane_model_of
from tests.support.whole_rigs import levitating


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--multisine", action="store_true")
    given = parser.parse_args()
    profile = MultisineProfile() if given.multisine else Profile()
    for seed, rig, sheet, peak in islice(levitating(count(given.first_seed)), given.rigs):
        told: list[Progress] = []
        law = rig.controller
        print(
            f"{seed}: {rig.rotor.mass_kg:.0f} kg, {np.sqrt(2 * rig.magnets.ks.mean() / rig.rotor.mass_kg):.0f} rad/s, "
            f"{1e-3 / law.sample_time_s:.0f} kHz, gap {1e3 * rig.magnets.gap_m.mean():.2f} mm, "
            f"modes at {', '.join(f'{m.natural_frequency_rad_s / 2 / np.pi:.0f}' for m in rig.rotor.modes[0])} Hz, "
            f"peak of S {20 * np.log10(peak):.1f} dB",
            flush=True,
        )
        cpu = time.process_time()
        try:
            with tempfile.TemporaryDirectory() as folder:
                experiment = run_campaign(
                    SimulatedController(rig, seed=seed), sheet, Path(folder), told.append, profile=profile
                )
        except Exception as error:  # whatever goes wrong is what this is for
            print(f"   experiment: {type(error).__name__}: {error}")
            continue
        measured = time.process_time() - cpu
        marks = Counter(f for s in experiment.sweeps for f in s.flags if f)
        result = identify(experiment, sheet)
        print(
            f"   {sum(s.n_points for s in experiment.sweeps)} points, {told[-1].rig_seconds / 60:.1f} min on the rig, "
            f"CPU {measured:.0f} + {time.process_time() - cpu - measured:.0f} s, marked {dict(marks)}"
        )
        for name, plane in result.planes.items():
            truth = plane_model_of(rig, name)
            pairs = [
                (plane.stiffness[k], v)
                for k, v in zip(("kiA", "kiB", "ksA", "ksB"), [*truth.ki, *truth.ks], strict=True)
            ]
            off = [100 * abs(e.value / v - 1) for e, v in pairs]
            away = [abs(e.value - v) / e.std for e, v in pairs]
            inside = [m for m in plane.modes if m.kind == "rotor"]
            true = [z for w, z in zip(truth.natural_frequencies, truth.damping_ratios, strict=True) if w < 2e3 * np.pi]
            damping = [100 * abs(m.damping_ratio.value / z - 1) for m, z in zip(inside, true, strict=False)]
            print(
                f"   {name}: ki off {max(off[:2]):.2f} %, ks {max(off[2:]):.2f} %, at most {max(away):.1f} deviations; "
                f"{len(inside)} of {len(true)} modes, damping off {max(damping, default=0):.1f} %; "
                f"{'adequate' if plane.adequate else 'not adequate'}"
            )
        for warning in result.warnings:
            print(f"   note: {warning}")


if __name__ == "__main__":
    main()
