"""Scores of the gap diagnosis: the practice cases where they are at hand, rigs of another program, a blind trial.

`python benchmarks/gap.py [--practice DIR] [--foreign N or DIR] [--trial N] [--seed S] [--jobs J]`. Every part prints
verdicts as they come, scores and the time that a diagnosis took; 0 leaves a part out. `--alone` has the practice cases
diagnosed one after the other, each by a command of its own on all ``--jobs`` cores as a user would, and nothing else:
the time from its start until its report is written. `--multisine N` draws N rigs of a blind trial, has each measured by
multisines, and prints what is found; no detectability is known there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
from foreign.values import in_terms_of_the_catalogue

from service.campaign.multisine.plan import MultisineProfile
from service.experiment import file
from service.gap.trial.scoring import Outcome, score
from service.pool import workers
from service.trial import diagnose, measure, run_blind_trial
from sim.errors import AmbError
from sim.rig_file import parse
from sim.withheld.case import draw

PRACTICE = Path(__file__).resolve().parents[2] / "shared" / "practice"
KNOWN = {
    "delay": ("loop_delay", "delay_s", lambda v: v),
    "_log_offset": ("logging_offset", "samples", lambda v: v),
    "amp_w": ("amplifier_bandwidth", "frequency_change", lambda v: v[0] / 9244 - 1),
    "eddy_tau": ("eddy_currents", "time_constant_s", lambda v: v),
    "sat_A": ("magnetic_saturation", "saturation_inverse_per_a", lambda v: 1 / v),
    "sensor_hz": ("sensor_lag", "time_constant_s", lambda v: 1 / (2 * 3.141592653589793 * v)),
    "house_hz": ("support_resonance", "frequency_hz", lambda v: v),
    "house_mass": ("support_resonance", "inverse_mass_per_kg", lambda v: 1 / v),
    "sA": ("sensor_position", "shift_A_m", lambda v: v - 0.484),
    "sB": ("sensor_position", "shift_B_m", lambda v: v - 0.470),
    "xy_mag": ("magnetic_cross_coupling", "rotation_rad", lambda v: v),
    "x0": ("off_centre_rotor", "offset_xA_m", lambda v: v[0]),
}
"""Change in a practice case's truth.json -> effect, parameter, its value there."""


def diagnosed(folder: Path) -> tuple[dict[str, Any], dict[str, Any], float]:
    """(truth, gap.json, seconds) of a case folder."""
    experiment = file.read(folder / "experiment.h5")
    datasheet = parse((folder / "rig.toml").read_text(), str(folder))
    start = time.perf_counter()
    report = json.loads(json.dumps(diagnose(experiment, datasheet)))
    return json.loads((folder / "truth.json").read_text()), report, time.perf_counter() - start


def commanded(folder: Path, out: Path, jobs: int) -> tuple[dict[str, Any], float]:
    """What `ambit gap diagnose` writes on a case folder, and the seconds that the whole command took."""
    words = [sys.executable, "-m", "service", "gap", "diagnose", str(folder / "experiment.h5")]
    words += ["--rig", str(folder / "rig.toml"), "--out", str(out), "--jobs", str(jobs)]
    start = time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return json.loads((out / "gap.json").read_text()), time.perf_counter() - start


def alone(folders: list[Path], out: Path, jobs: int) -> None:
    """Print the wall time of one diagnosis at a time."""
    took: list[float] = []
    right = 0
    for k, folder in enumerate(folders):
        report, seconds = commanded(folder, out / folder.name, jobs)
        o = outcome(k, json.loads((folder / "truth.json").read_text()), report, seconds)
        took, right = [*took, seconds], right + o.right
        verdict = " + ".join(o.named) or o.verdict["kind"]
        print(f"{folder.name} {'ok   ' if o.right else 'WRONG'} {verdict:38s} {seconds:5.1f} s", flush=True)
    took.sort()
    print(
        f"-- {right} of {len(took)} right; one diagnosis, start and report included, on {jobs} processes: "
        f"median {took[len(took) // 2]:.1f} s, longest {took[-1]:.1f} s"
    )


def outcome(number: int, truth: dict[str, Any], report: dict[str, Any], seconds: float) -> Outcome:
    """A case folder's truth in the trial's terms; what carries no detectability counts as plain."""
    effects = tuple(truth["effects"])
    unlisted = effects == ("none_of_these",)
    kind = "unlisted" if unlisted else ("clean", "single", "mixture")[min(len(effects), 2)]
    return Outcome(
        case=number,
        kind=kind,
        effects=() if unlisted else effects,
        parameters=in_terms_of_the_catalogue(truth) if "laws" in truth else {},
        law="+".join(truth.get("laws", ["unlisted"])) if unlisted else "",
        detectability=float(truth.get("detectability", 1e9)),
        report=report,
        seconds=seconds,
        each=truth.get("each", {}),
    )


def run_folder(folders: list[Path], jobs: int) -> list[Outcome]:
    outcomes = []
    with workers(jobs) as pool:
        for k, (folder, result) in enumerate(zip(folders, pool.map(diagnosed, folders), strict=True)):
            truth, report, seconds = result
            o = outcome(k, truth, report, seconds)
            outcomes.append(o)
            verdict = " + ".join(o.named) or o.verdict["kind"]
            others = sorted({e for g in o.verdict["indistinguishable"] for e in g} - set(o.named))
            told = " + ".join(truth.get("laws", truth["effects"])) or "clean"
            closure = report["shrinkage"]["closure"]
            print(
                f"{folder.name} {'ok   ' if o.right else 'WRONG'} {told:38s} -> {verdict}"
                f"{' or ' + ', '.join(others) if others else ''} (p {o.probability:.2f}, closure "
                f"{'-' if closure is None else f'{closure:.3f}'}, path {report['where']['path']}, "
                f"detectability {o.detectability:.0f}, {seconds:.1f} s)",
                flush=True,
            )
            for line in known_values(truth, report):
                print("     " + line)
    return outcomes


def known_values(truth: dict[str, Any], report: dict[str, Any]) -> Iterable[str]:
    """Parameters of a practice case against what was found."""
    candidates = {tuple(sorted(c["effect"].split("+"))): c for c in report["candidates"]}
    found = candidates.get(tuple(sorted(truth["effects"])))
    for name, value in truth.get("changes", {}).items():
        if name not in KNOWN or found is None or "laws" in truth:
            continue
        effect, parameter, convert = KNOWN[name]
        values = found["parameters"]
        got = values.get(parameter) or values.get(f"{effect}.{parameter}")
        if got is None:
            continue
        true, sd = convert(value), got["std"]
        inside = sd is not None and abs(got["value"] - true) <= 1.96 * sd
        error = 100 * (got["value"] / true - 1)
        where = "in" if inside else "OUT OF"
        yield f"{parameter} {got['value']:.4g}, true {true:.4g}: {error:+.1f} %, {where} its interval"


def shown(title: str, scores: dict[str, Any]) -> None:
    print(f"-- {title}")
    for section, content in scores.items():
        if section in ("by_detectability",):
            for row in content:
                print(f"   detectability {row['from']:g}..{row['to'] or 'inf'}: {row}")
        elif isinstance(content, dict):
            flat: dict[str, Any] = {k: round(v, 4) if isinstance(v, float) else v for k, v in content.items()}
            for key in ("by_effect", "by_law"):
                for name, row in flat.pop(key, {}).items():
                    print(f"     {name}: {row}")
            flat.pop("bins", None)
            print(f"   {section}: {flat}")
        else:
            print(f"   {section}: {content}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--practice", default=str(PRACTICE))
    parser.add_argument("--foreign", default="40", help="how many cases to make, or a folder of them")
    parser.add_argument("--trial", type=int, default=200)
    parser.add_argument("--multisine", type=int, default=12, help="rigs of a blind trial, measured by multisines")
    parser.add_argument("--seed", type=int, default=2024)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder of what is made; a temporary one when not given")
    parser.add_argument("--alone", action="store_true", help="time the practice diagnoses one by one, nothing else")
    args = parser.parse_args()
    out = args.out or Path(tempfile.mkdtemp(prefix="gap-"))
    practice = sorted(Path(args.practice).glob("*/truth.json")) if args.practice != "0" else []
    if args.alone:
        if not practice:
            parser.error(f"no practice cases in {args.practice}")
        alone([p.parent for p in practice], out / "alone", args.jobs)
        return
    if practice:
        print("== practice cases")
        shown("practice", score(run_folder([p.parent for p in practice], args.jobs)))
    elif args.practice != "0":
        print(f"== practice cases: none in {Path(args.practice).name}, left out")
    if args.foreign != "0":
        folder = Path(args.foreign)
        if args.foreign.isdigit():
            folder = out / "foreign"
            made_foreign(int(args.foreign), args.seed, folder, args.jobs)
        print("== rigs of another program")
        shown("foreign", score(run_folder(sorted(p.parent for p in folder.glob("*/truth.json")), args.jobs)))
    if args.multisine:
        print(f"== rigs measured by multisines, seed {args.seed}")
        multisines(args.multisine, args.seed, out / "multisine", args.jobs)
    if args.trial:
        print(f"== blind trial, {args.trial} cases, seed {args.seed}")
        result = run_blind_trial(
            args.trial, args.seed, out / "trial", lambda a, b, text: print(f"{a}/{b} {text}", flush=True), args.jobs
        )
        shown("blind trial", result["scores"])


def by_multisines(number: int, seed: int, out: Path) -> tuple[Outcome, str] | str:
    """A rig of a blind trial measured by multisines, diagnosed, and what was withheld; or why it cannot be measured."""
    case, folder = draw(number, seed), out / f"case-{number + 1:04d}"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        measure(case, folder, MultisineProfile())
    except AmbError as error:
        return f"case {number + 1} cannot be measured: {error}"
    start = time.perf_counter()
    report = json.loads(json.dumps(diagnose(file.read(folder / "experiment.h5"), case.datasheet)))
    effects = tuple(name for name, _ in case.effects)
    told = " + ".join(effects) or case.law or "clean"
    return Outcome(number, case.kind, effects, {}, case.law, 1e9, report, time.perf_counter() - start), told


def multisines(cases: int, seed: int, out: Path, jobs: int) -> None:
    """Print what is found, case by case, and how often it is right, no gap, or wrong."""
    count = {"right": 0, "no gap": 0, "WRONG": 0}
    with workers(jobs) as pool:
        for done in pool.map(by_multisines, range(cases), [seed] * cases, [out] * cases):
            if isinstance(done, str):
                print(done, flush=True)
                continue
            o, told = done
            verdict = " + ".join(o.named) or o.verdict["kind"]
            mark = "right" if o.right else "no gap" if verdict == "no_gap" else "WRONG"
            count[mark] += 1
            print(f"{mark:6s} {told:45s} -> {verdict} (p {o.probability:.2f}, {o.seconds:.1f} s)", flush=True)
    print(f"-- multisines: {count}; what leaves no gap may be too faint")


def made_foreign(count: int, seed: int, folder: Path, jobs: int) -> None:
    from foreign.cases import make

    start = time.perf_counter()
    with workers(jobs) as pool:
        list(pool.map(make, range(count), [seed] * count, [folder] * count))
    print(f"made {count} cases in {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
