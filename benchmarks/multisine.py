"""Seconds on the rig against the standard deviation of ki and ks: stepped sine and multisine on the reference rig.

python benchmarks/multisine.py [runs of the multisine, default 20] [runs of the stepped sine, default 4]
python benchmarks/multisine.py 10 --delay-us 30

Rig seconds are those of the whole experiment: noise, pilot, settling, ramps, validation, amplifiers. Reported
deviations are those of result.json; "data" is their part that noise brings, "MC" the scatter of the errors over seeds
of the rig's noise. The rest of a deviation is what nobody has told of the modes' shapes (`identification.split`): it
is alike in both experiments and no time on the rig lowers it. So the last columns ask for the time that the
multisine would need for the data's part of the stepped sine's deviation, as a share of the latter's time (deviations
fall with the root of the time): as measured, and by the Cramer-Rao bound of the best powers of all odd lines at the
same root mean squares of displacement, current and excitation, the model known beforehand, nothing kept for its checks.

With a delay that the controller was not made for the loop hardly damps the first mode, and the question is another one:
what starts, and noise that rings on over the periods, leave in damping ratios. So many multisine campaigns are measured
as they are, and as many that wait only until periods agree with one another, not for what the pilot's model says.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any
from unittest.mock import patch

import _one_thread  # noqa: F401  before numpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from drivers.simulated.driver import SimulatedController
from service.bootstrap import profile_for
from service.campaign.multisine.design import Design
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.input_design import best_powers, closed_loop, line_information
from service.identification.loop.closed_loop import closed_loop_poles
from sim.reference import reference_datasheet, reference_rig
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.planes import plane_model_of, relative_std

RIG = reference_rig()
PROFILE = MultisineProfile()
Figures = dict[str, tuple[float, float, float]]


def measured(excitation: str, seed: int, rig: Rig = RIG) -> tuple[Experiment, float]:
    """An experiment and the wall time that it took."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        controller = SimulatedController(rig, seed=seed)
        experiment = run_campaign(controller, reference_datasheet(), Path(folder), profile=profile_for(excitation))
    return experiment, time.perf_counter() - began


def figures(experiment: Experiment) -> Figures:
    """Error, reported deviation and its part from data of every parameter, percent of the truth."""
    planes = identify(experiment, reference_datasheet()).planes
    out: Figures = {}

    def keep(name: str, found: Any, true: float) -> None:
        out[name] = (100 * (found.value / true - 1), 100 * found.std / true, 100 * found.std_from_data / true)

    for p, (plane, found) in enumerate(planes.items()):
        for b, bearing in enumerate("AB"):
            for name, truth in (("ki", RIG.magnets.ki), ("ks", RIG.magnets.ks)):
                keep(f"{plane} {name}{bearing}", found.stiffness[name + bearing], float(truth[2 * p + b]))
        for k, (mode, true) in enumerate(zip(found.modes, RIG.rotor.modes[p], strict=False)):
            keep(f"{plane} wn{k + 1}", mode.natural_frequency_rad_s, true.natural_frequency_rad_s)
            keep(f"{plane} zeta{k + 1}", mode.damping_ratio, true.damping_ratio)
    return out


def bounds(experiment: Experiment) -> dict[str, float]:
    """Least deviations, percent, that any powers of the main sweep's limits could reach in its recorded time."""
    main, sheet, rate = experiment.main, reference_datasheet(), experiment.main.sample_rate_hz
    assert main.block_samples is not None
    seconds = float(main.block_samples[0]) / rate * main.Y.shape[1] * RIG.n_axes
    controller = (np.array(sheet.numerator), np.array(sheet.denominator))
    hz = np.arange(np.ceil(PROFILE.from_hz / 2) * 2 + 1, PROFILE.to_hz, 2.0)
    n = RIG.noise
    white = [n.current_a**2 + n.current_step_a**2 / 12, n.displacement_m**2 + n.displacement_step_m**2 / 12]
    noise = 4 / rate * np.repeat(white, 2)
    out: dict[str, float] = {}
    for p, plane in enumerate("xy"):
        model = plane_model_of(RIG, plane)
        information = line_information(model, controller, 2 * np.pi * hz, np.tile(noise, (len(hz), 1)), np.inf)
        shares, top = [], []
        for at in (2 * np.pi * main.frequency_hz[main.axis == 2 * p], 2 * np.pi * hz):
            loop = closed_loop(model, controller, at)
            own = np.broadcast_to(np.eye(2), loop.y.shape)
            shares.append([0.5 * np.abs(x) ** 2 for x in (loop.y, loop.i, own)])
        played = np.stack([main.amplitude_a[main.axis == 2 * p + j] ** 2 for j in range(2)], axis=1)
        top = [np.max(np.einsum("lsj,lj->s", s, played)) for s in shares[0]]
        use = np.concatenate([s / t for s, t in zip(shares[1], top, strict=True)], axis=1)
        least = 100 * relative_std(information, seconds * best_powers([information], use))
        names = ["kiA", "kiB", "ksA", "ksB"] + [f"zeta{k + 1}" for k in range(len(least) - 4)]
        out |= {f"{plane} {n}": float(s) for n, s in zip(names, least, strict=True)}
    return out


def late(runs: int, delay_us: float) -> None:
    """Damping ratios where the loop hardly damps a mode, with and without a wait for what the pilot's model says."""
    rig, sheet = with_effects(RIG, {"loop_delay": {"delay_s": 1e-6 * delay_us}}), reference_datasheet()
    controller = (np.array(sheet.numerator), np.array(sheet.denominator))
    for p in "xy":
        z = closed_loop_poles(plane_model_of(rig, p), controller)
        swings = np.log(z[z.imag > 0]) * sheet.sample_rate_hz
        slowest = swings[np.argmax(swings.real)]
        print(f"{p}-plane: the loop damps {slowest.imag / (2 * np.pi):.1f} Hz with {-slowest.real:.2f} 1/s")
    print(f"damping ratios, percent of the truth, {runs} campaigns each")
    print(f"{'wait':26}{'rig s':>6}{'':9}" + "".join(f"{c:>9}" for c in ("bias", "rms", "std", "bias/std", "rms/std")))
    for wait, settle_s in (("as the pilot's model says", Design.settle_s), ("until periods agree", lambda _: 0.0)):
        with patch.object(Design, "settle_s", settle_s):
            experiments = [measured("multisine", seed, rig)[0] for seed in range(1, runs + 1)]
        seconds = np.mean([float(e.attributes["rig_seconds"]) for e in experiments])
        found = [figures(e) for e in experiments]
        for name in (n for n in found[0] if "zeta" in n):
            error, std, _ = np.array([f[name] for f in found]).T
            rms = float(np.sqrt(np.mean(error**2)))
            row = (error.mean(), rms, std.mean(), error.mean() / std.mean(), np.sqrt(np.mean((error / std) ** 2)))
            print(f"{wait:26}{seconds:6.0f} {name:8}" + "".join(f"{x:9.3f}" for x in row), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("multisines", type=int, nargs="?", default=20)
    parser.add_argument("stepped", type=int, nargs="?", default=4)
    parser.add_argument("--delay-us", type=float, help="more delay in the loop: damping ratios of multisines alone")
    arguments = parser.parse_args()
    if arguments.delay_us is not None:
        late(arguments.multisines, arguments.delay_us)
        return
    runs = {"multisine": arguments.multisines, "stepped-sine": arguments.stepped}
    found: dict[str, dict[str, list[tuple[float, float, float]]]] = {e: defaultdict(list) for e in runs}
    seconds, least = {}, {}
    for excitation, count in runs.items():
        busy, wall = [], []
        for seed in range(1, count + 1):
            experiment, took = measured(excitation, seed)
            busy.append(float(experiment.attributes["rig_seconds"]))
            wall.append(took)
            for name, figure in figures(experiment).items():
                found[excitation][name].append(figure)
        seconds[excitation] = float(np.mean(busy))
        if excitation == "multisine":
            least = bounds(experiment)
        print(f"{excitation}: {np.mean(busy):.0f} s on the rig, {np.mean(wall):.1f} s of wall time, {count} runs")
        sweeps = ", ".join(f"{s.comment} {s.time_s.max():.0f} s" for s in experiment.sweeps if s.time_s is not None)
        print(f"  sweeps end at: {sweeps}")
        print(f"  distortion over signal, dB: {experiment.attributes.get('distortion_db', 'not measured')}")
    share = seconds["multisine"] / seconds["stepped-sine"]
    print(f"\ntime of the multisine over that of the stepped sine: {share:.3f}\n")
    print(f"{'':9}{'stepped sine, percent':^26}{'multisine, percent':^51}{'time for equal data std':^26}")
    columns = ("std", "data", "MC", "std", "data", "MC", "bound", "bias", "worst/std", "measured", "bound")
    print(f"{'':9}" + "".join(f"{c:>9}" if c != "worst/std" else f"{c:>11}" for c in columns))
    for name, runs_of in found["multisine"].items():
        old, new = np.array(found["stepped-sine"][name]), np.array(runs_of)
        scatter = [float(np.std(x[:, 0], ddof=1)) if len(x) > 1 else float("nan") for x in (old, new)]
        bound, data = least.get(name, float("nan")), new[:, 2].mean()
        print(
            f"{name:9}{old[:, 1].mean():9.4f}{old[:, 2].mean():9.4f}{scatter[0]:9.4f}"
            f"{new[:, 1].mean():9.4f}{data:9.4f}{scatter[1]:9.4f}{_or_dash(bound, 4)}{new[:, 0].mean():+9.4f}"
            f"{np.max(np.abs(new[:, 0] / new[:, 1])):11.2f}"
            f"{share * (data / old[:, 2].mean()) ** 2:9.3f}{_or_dash(share * (bound / old[:, 2].mean()) ** 2, 3)}"
        )


def _or_dash(value: float, digits: int) -> str:
    return f"{'-':>9}" if np.isnan(value) else f"{value:9.{digits}f}"


if __name__ == "__main__":
    main()
