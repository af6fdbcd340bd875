"""Cases from a program that is not this project: `python benchmarks/foreign_rig.py --cases N --seed S --out DIR`.

Each case is a folder with experiment.h5, rig.toml and truth.json in the layout of the practice cases. See
benchmarks/foreign for the physics, the effects and their laws. `--effects contact,delay+sensor_lag,none` has the cases
take these sets of effects in turn, in place of drawn ones; `gap.py --foreign DIR` diagnoses and scores them.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import _one_thread  # noqa: F401  before numpy
from foreign.cases import make
from foreign.effects import CATALOGUE, UNKNOWN


def effect_sets(parser: argparse.ArgumentParser, text: str | None) -> list[list[str] | None]:
    """Effects of the cases in turn; ``None`` has a case draw its own."""
    if text is None:
        return [None]
    sets = [[] if s == "none" else s.split("+") for s in text.split(",")]
    known = [*CATALOGUE, *UNKNOWN]
    if wrong := {name for s in sets for name in s} - set(known):
        parser.error(f"no effect {', '.join(sorted(wrong))}; there are {', '.join(known)}, and none")
    return [*sets]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder of the cases; a temporary one when not given")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--effects", help="sets of effects for the cases in turn, as a,b+c,none")
    args = parser.parse_args()
    sets = effect_sets(parser, args.effects)
    out = args.out or Path(tempfile.mkdtemp(prefix="foreign-"))
    start = time.perf_counter()
    with ProcessPoolExecutor(args.jobs) as pool:
        waiting = [pool.submit(make, k, args.seed, out, sets[k % len(sets)]) for k in range(args.cases)]
        for k, case in enumerate(waiting):
            truth = case.result()
            print(
                f"c{k + 1:03d} {truth['kind']:8s} {' + '.join(truth['laws']) or '-':45s} "
                f"level {' '.join(f'{x:.2f}' for x in truth['level'])}{' other rotor' if truth['other_rotor'] else ''} "
                f"detectability {truth['detectability']:.0f}"
            )
    print(f"{args.cases} cases in {out} after {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
