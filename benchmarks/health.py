"""Health checks on the reference rig: rig time, calibration, false alarms of a year, what is detected.

python benchmarks/health.py [checks]
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import _one_thread  # noqa: F401  before numpy
import numpy as np
from scipy.stats import norm

from drivers.simulated.driver import SimulatedController
from service.bootstrap import identify_into, measure
from service.campaign.run import run_campaign
from service.health.compare import Baseline, compare
from service.health.result import HealthResult
from service.health.sequential import CHECKS_A_YEAR, Policy
from service.health.tones import short_plan
from sim.effects import CATALOGUE
from sim.reference import reference_datasheet, reference_rig
from sim.rig import Rig

SHEET = reference_datasheet()


def changed(**what: float) -> Rig:
    rig = reference_rig()
    magnets = replace(rig.magnets, ki=rig.magnets.ki * what.get("ki", 1), ks=rig.magnets.ks * what.get("ks", 1))
    rig = replace(rig, magnets=magnets)
    if "zeta1" in what:
        values = {"mode1_log_ratio": float(np.log(what["zeta1"])), "mode2_log_ratio": 0.0}
        rig = CATALOGUE["modal_damping"].on(rig, **values)
    if "wn1" in what:
        planes = tuple(
            (replace(m[0], natural_frequency_rad_s=m[0].natural_frequency_rad_s * what["wn1"]), *m[1:])
            for m in rig.rotor.modes
        )
        rig = replace(rig, rotor=replace(rig.rotor, modes=planes))
    return rig


def main() -> None:
    checks = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    with tempfile.TemporaryDirectory() as folder:
        experiment = measure(SimulatedController(reference_rig(), 1), SHEET, Path(folder))
        baseline = Baseline(identify_into(experiment, SHEET, Path(folder)).document)
    whole = float(experiment.attributes["rig_seconds"])
    began = time.process_time()
    plan = short_plan(SHEET, baseline.document)
    print(f"plan: {len(plan.profile.frequencies_hz)} tones, {time.process_time() - began:.1f} s of CPU")

    def check(rig: Rig, seed: int) -> tuple[HealthResult, float]:
        with tempfile.TemporaryDirectory() as folder:
            found = run_campaign(SimulatedController(rig, seed), SHEET, Path(folder), profile=plan.profile)
        began = time.process_time()
        return compare(baseline, found, SHEET), time.process_time() - began

    results = [check(reference_rig(), 100 + k) for k in range(checks)]
    seconds = np.array([r.rig_seconds for r, _ in results], dtype=float)
    print(
        f"rig time {seconds.mean():.0f} s (most {seconds.max():.0f} s) of a commissioning's {whole:.0f} s: "
        f"{100 * seconds.mean() / whole:.1f} %; comparison {np.mean([c for _, c in results]):.2f} s of CPU"
    )
    now = np.array([[c.now for c in r.changes] for r, _ in results])
    std = np.array([[c.std_now for c in r.changes] for r, _ in results])
    significance = np.array([[c.significance for c in r.changes] for r, _ in results])
    names = [c.monitored.name.rstrip("AB12_") for c in results[0][0].changes]
    values = np.array([c.was for c in results[0][0].changes])
    z = (now - now.mean(axis=0)) / std * np.sqrt(checks / (checks - 1))
    print(f"{checks} checks of the rig that did not change; alarms: {sum(r.alarm for r, _ in results)}")
    print("figure                 scatter / reported std   std, %    largest change in std. dev.")
    for name in dict.fromkeys(names):
        k = [i for i, n in enumerate(names) if n == name]
        relative = 100 * np.median(std[:, k] / np.abs(values[k]))
        ratio = np.sqrt(np.mean(z[:, k] ** 2))
        print(f"{name:22s} {ratio:22.2f} {relative:9.4f} {np.abs(significance[:, k]).max():15.1f}")
    policy, n = Policy(), len(names) + 2
    threshold = policy.threshold(0, n, 300.0)
    yearly = _yearly(significance, threshold)
    print(
        f"threshold {threshold:.2f} standard deviations; false alarms a year expected of this rig from mean and "
        f"scatter of its checks, Gaussian tails: {yearly:.2g} (accepted: {policy.per_year:g})"
    )
    for name, what in (
        ("ki -5 %", {"ki": 0.95}),
        ("ki -0.5 %", {"ki": 0.995}),
        ("ks +1 %", {"ks": 1.01}),
        ("zeta1 x 2", {"zeta1": 2.0}),
        ("zeta1 x 1.1", {"zeta1": 1.1}),
        ("wn1 -0.5 %", {"wn1": 0.995}),
    ):
        found, _ = check(changed(**what), 7)
        print(f"{name:12s} alarm {found.alarm}, zone {found.zone}, drifted: {', '.join(found.drifted) or 'nothing'}")


def _yearly(significance: np.ndarray, threshold: float) -> float:
    """Expected false alarms a year: what the baseline's error leaves of the threshold, in units of the scatter."""
    mean, scatter = np.abs(significance.mean(axis=0)), significance.std(axis=0, ddof=1)
    return float(CHECKS_A_YEAR * np.sum(norm.sf((threshold - mean) / scatter) + norm.sf((threshold + mean) / scatter)))


if __name__ == "__main__":
    main()
