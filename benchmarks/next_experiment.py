"""Whether the proposed experiment tells apart what a diagnosis left together, as often as it was predicted.

`python benchmarks/next_experiment.py [--repeats 6] [--rig NAME]`. Rigs whose effect the first experiment leaves
together with another one are diagnosed; what is then proposed is run on the simulated rig, with other noise each time,
and diagnosed on its own. Prints how often the true explanation has the greater evidence of the two beside the predicted
odds, and the time of the rig beside the predicted one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from drivers.simulated.driver import SimulatedController
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.jobs.campaigns import profile_of
from sim.datasheet import Datasheet
from sim.rig import Noise, Rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig

NOISE = Noise(displacement_m=4.5e-8, current_a=4.5e-3)
"""White noise of each sample that has, over a tenth of a second, what the first, synthetic experiment has."""
FAINT_A = 0.02
"""Amplitude of the first experiment."""
RIGS: Mapping[str, tuple[dict[str, dict[str, float]], float]] = {
    "sensor lag": ({"sensor_lag": {"time_constant_s": 5e-7, "delay_s": 9.9e-6}}, FAINT_A),
    "eddy currents": ({"eddy_currents": {"time_constant_s": 3.1e-5, "corner_rad_s": 9e4}}, FAINT_A),
    "internal damping": ({"internal_damping": {"damping_ratio": 0.005}}, 0.15),
}
"""Effects, and the amplitude of the first experiment."""


def measured(rig: Rig, sheet: Datasheet, proposal: Mapping[str, Any], seed: int) -> Experiment:
    """The proposed experiment, run on the simulated rig as the service would."""
    there = replace(rig, noise=NOISE, speed_rad_s=proposal["speed_rad_s"])
    profile = profile_of(proposal["job"]["options"])
    with tempfile.TemporaryDirectory() as folder:
        return run_campaign(SimulatedController(there, seed=seed), sheet, Path(folder), profile=profile)


def shown(name: str, repeats: int) -> None:
    effects, amplitude = RIGS[name]
    sheet, truth = known_datasheet(seed=1)
    rig = with_effects(true_rig(truth), effects)
    begun = time.perf_counter()
    first = diagnose(experiment(rig, seed=1, amplitude_a=amplitude), sheet)
    print(f"== {name}: named {' + '.join(first.verdict.effects) or first.verdict.kind}, "
          f"{time.perf_counter() - begun:.1f} s")  # fmt: skip
    proposal = first.next_experiment
    if proposal is None:
        print("   nothing proposed:", "; ".join(first.notes))
        return
    odds, seconds = proposal["odds_of_telling_apart"], proposal["rig_seconds"]
    print(f"   {' or '.join(proposal['separates'])}: {proposal['experiment']}, odds {odds:.3f}, {seconds:.0f} s")
    others = [(o["experiment"], round(o["odds_of_telling_apart"], 3)) for o in proposal["alternatives"]]
    print(f"   others: {others}")
    true, right, took = "+".join(effects), 0, []
    for k in range(repeats):
        outcome = measured(rig, sheet, proposal, seed=100 + k)
        again = diagnose(outcome, sheet)
        evidence = {"+".join(r.candidate.effects): r.log_evidence for r in again.order}
        one, other = (evidence.get(e, -np.inf) for e in (true, next(e for e in proposal["separates"] if e != true)))
        right += one > other
        took.append(float(outcome.attributes["rig_seconds"]))
        named = " + ".join(again.verdict.effects) or again.verdict.kind
        print(f"   {took[-1]:.0f} s: named {named}, log evidence of the true one {one - other:+.1f}", flush=True)
    print(f"-- {name}: right {right} of {repeats}, predicted {odds * repeats:.1f}; "
          f"{np.mean(took):.0f} s of the rig, predicted {seconds:.0f} s", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=6)
    parser.add_argument("--rig", choices=RIGS, help="one of the rigs only")
    args = parser.parse_args()
    for name in [args.rig] if args.rig else RIGS:
        shown(name, args.repeats)


if __name__ == "__main__":
    main()
