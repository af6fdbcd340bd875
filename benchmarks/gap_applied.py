"""Whether a twin has no gap any more once what a diagnosis named is added to it.

`python benchmarks/gap_applied.py [DIR] [--jobs J]` diagnoses every case folder in DIR (experiment.h5 and rig.toml; else
the practice cases, where they are at hand), adds the effects that are named to the twin, and diagnoses the same
experiment against that. It prints both verdicts of each case, and how many have no gap then; a case without named
effects has nothing to add.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
from gap import PRACTICE

from service.experiment import file
from service.gap.apply import applied
from service.pool import workers
from service.trial import diagnose
from sim import rig_file


def twice(folder: Path) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """gap.json of a case's twin, and of the twin with the effects that the first names, if it names any."""
    experiment, twin = file.read(folder / "experiment.h5"), rig_file.read(folder / "rig.toml")
    first = diagnose(experiment, twin)
    if not first["verdict"]["effects"]:
        return first, None
    return first, diagnose(experiment, applied(twin, first))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=PRACTICE)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    folders = sorted(p.parent for p in args.folder.glob("*/experiment.h5"))
    if not folders and args.folder == PRACTICE:
        print(f"no practice cases in {PRACTICE.name}, left out")
        return
    if not folders:
        parser.error(f"no case folders in {args.folder}")
    gone = added = 0
    with workers(args.jobs) as pool:
        for folder, (first, second) in zip(folders, pool.map(twice, folders), strict=True):
            named = " + ".join(first["verdict"]["effects"]) or first["verdict"]["kind"]
            if second is None:
                print(f"{folder.name} -      {named}", flush=True)
                continue
            without = second["verdict"]["kind"] == "no_gap"
            added, gone = added + 1, gone + without
            told = f"{'ok   ' if without else 'WRONG'} {named:38s} then: {second['verdict']['sentence']}"
            print(f"{folder.name} {told}", flush=True)
    print(f"-- {gone} of {added} twins have no gap with what was named added")


if __name__ == "__main__":
    main()
