"""Blind trials run for real: the campaign on a simulated controller, files as they are published, cases in parallel.

``OUT/case-0001/`` gets, in this order: experiment.h5 and rig.toml (all that the diagnosis may see), commitment.json,
sealed.json (readable by its owner only), gap.json, case.json (all of it, opened). ``OUT/trial.json`` has every case and
the scores. A trial that was stopped keeps what it has: measured.json beside an experiment says that it is whole.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from drivers.device.machine import RigDevice
from drivers.errors import CancelledError
from drivers.simulated.driver import SimulatedController
from service.campaign.aims import Profile
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.run import EXPERIMENT, run_campaign
from service.errors import StoppedError
from service.experiment import file
from service.experiment.data import Experiment
from service.experiment.errors import CampaignError
from service.gap.trial.blind_trial import Diagnose, Published, checked, fingerprint, run_case, summary
from service.gap.trial.scoring import case_in_words
from service.pool import workers
from sim.datasheet import Datasheet
from sim.errors import AmbError, reason
from sim.rig_file import to_toml
from sim.withheld.case import Case, draw
from sim.withheld.seal import SealError

Progress = Callable[[int, int, str], None]
"""(cases done, cases in all, what the last one was)."""

PROFILE = Profile(
    points=40,
    validation_points=16,
    amplifier_points=6,
    coarse_points=12,
    rig_seconds=100.0,
    peak_points=3,
    nonlinearity=20.0,
    displacement_share=0.2,
)
"""A compact campaign: four axes in some five minutes of rig time, at amplitudes where magnets are not quite linear."""
KEPT = "case.json"
"""A case that was run and opened, as it stands in trial.json."""
MEASURED = "measured.json"
"""Says that a case's experiment is whole, and which of the rigs drawn for it was measured."""
TRIES = 5
"""Rigs drawn anew for a case whose campaign cannot be run: they trip, or do not come to rest."""
ANEW = 1_000_003
"""From the seed of one drawing to that of the next."""


def measure(case: Case, out_dir: Path, profile: Profile | MultisineProfile | None = None) -> Experiment:
    """Run a campaign, the compact one by default, on a case's rig; experiment.h5 is written to ``out_dir``.

    Raises
    ------
    CampaignError
        The rig cannot be measured.
    """
    device = RigDevice(case.rig, simulation=case.simulation(case.number))
    controller = SimulatedController(device)
    try:
        return run_campaign(
            controller, case.datasheet, out_dir, profile=profile or PROFILE, resume=False, holder="blind trial"
        )
    finally:
        controller.close()
        device.close()


def diagnose(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
    """The service's own diagnosis, on one core, as the document gap.json."""
    from service.gap.diagnose import diagnose as engine
    from service.gap.document import gap_document

    return gap_document(engine(experiment, datasheet))


def run_one(number: int, seed: int, out_dir: Path, engine: Diagnose = diagnose) -> dict[str, Any]:
    """Run case ``number`` and write its files; the case as it stands in trial.json.

    Raises
    ------
    AmbError
        No rig could be measured, or the diagnosis refused the experiment.
    """
    folder = _folder(number, out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    case, experiment = _measured(number, seed, folder)
    (folder / "rig.toml").write_text(to_toml(case.datasheet), encoding="utf-8")

    def publish(name: str, document: Mapping[str, Any]) -> None:
        path = folder / {"report": "gap.json"}.get(name, f"{name}.json")
        _write(path, document, private=name == "sealed")

    def reopen() -> dict[str, Any]:
        try:
            return dict(json.loads((folder / "sealed.json").read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            raise SealError(f"{folder / 'sealed.json'} cannot be read any more: {reason(error)}") from error

    # the diagnosis gets what the file holds, as anyone who reads it would
    seen = file.read(folder / EXPERIMENT)
    trial = run_case(case, lambda _: experiment, lambda _, sheet: engine(seen, sheet), publish, reopen)
    done = {"seed": seed, **trial.document()}
    _write(folder / KEPT, done, private=True)
    return done


def _kept(number: int, seed: int, out_dir: Path) -> dict[str, Any] | None:
    """Case ``number`` as an earlier run of the same trial left it, whole, and the one whose files were published."""
    folder = _folder(number, out_dir)
    path = folder / KEPT
    if not path.exists():
        return None
    try:
        document = dict(json.loads(path.read_text(encoding="utf-8")))
        same = document["seed"] == seed and checked(document, _published(folder)).case == number
    except SealError as error:
        raise SealError(f"{folder}: {error}; remove {KEPT} there, and its case is sealed and run again") from error
    except (OSError, ValueError, TypeError, KeyError) as error:
        which = getattr(error, "filename", None) or path
        raise AmbError(f"{which} cannot be read: {reason(error)}; remove {path} and its case is run again") from error
    if not same:
        raise AmbError(f"{path} is of another trial than seed {seed}; give another folder")
    return document


def _published(folder: Path) -> Published:
    """What a case's folder showed before its seal was opened."""

    def document(name: str) -> dict[str, Any]:
        return dict(json.loads((folder / name).read_text(encoding="utf-8")))

    return Published(document("commitment.json")["sha256"], fingerprint(document("gap.json")))


def _folder(number: int, out_dir: Path) -> Path:
    return out_dir / f"case-{number + 1:04d}"


def _measured(number: int, seed: int, folder: Path) -> tuple[Case, Experiment]:
    done = folder / MEASURED
    if (attempt := _attempt(done, seed)) is not None:
        return draw(number, seed + ANEW * attempt), file.read(folder / EXPERIMENT)
    problem: CampaignError | None = None
    for attempt in range(TRIES):
        case = draw(number, seed + ANEW * attempt)
        try:
            experiment = measure(case, folder)
        except CampaignError as error:
            problem = error
        else:
            _write(done, {"seed": seed, "attempt": attempt}, private=True)
            return case, experiment
    raise AmbError(f"case {number} of seed {seed}: no rig of {TRIES} could be measured: {problem}")


def _attempt(done: Path, seed: int) -> int | None:
    """Which drawing of a case an earlier run measured to the end."""
    try:
        document = json.loads(done.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return int(document["attempt"]) if document["seed"] == seed else None


def run_blind_trial(
    cases: int, seed: int, out_dir: Path, progress: Progress | None = None, jobs: int = 2, engine: Diagnose = diagnose
) -> dict[str, Any]:
    """Run a blind trial and write ``out_dir/trial.json``; returns what it holds.

    A trial that was stopped goes on where it was, with the cases that the folder holds.

    Parameters
    ----------
    cases, seed
        Number of cases, and the seed from which they all follow.
    out_dir
        Made when it does not exist.
    progress
        Called after every case.
    jobs
        Processes; with 1 everything runs in this one.
    engine
        The diagnosis; a module-level function when ``jobs`` is above 1.

    Raises
    ------
    AmbError
        A case could not be run, or the folder cannot be written.
    SealError
        A seal was tampered with.
    StoppedError
        The user stopped it, by Ctrl-C.
    """
    if cases < 1:
        raise AmbError(f"a blind trial needs at least 1 case, not {cases}")
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AmbError(f"cannot write the trial to {out_dir}: {reason(error)}; give another folder") from error
    done: dict[int, dict[str, Any]] = {}
    try:
        for number, document in _finished(cases, seed, out_dir, jobs, engine):
            done[number] = document
            if progress is not None:
                progress(len(done), cases, case_in_words(checked(document)))
    except (KeyboardInterrupt, CancelledError):  # the second one is a campaign's word for the first
        kept = sum((_folder(number, out_dir) / KEPT).exists() for number in range(cases))
        raise StoppedError(
            f"stopped by the user: {kept} of {cases} cases are kept in {out_dir}, where the same command goes on"
        ) from None
    result = summary([done[k] for k in range(cases)], seed)
    _write(out_dir / "trial.json", result)
    return result


def _finished(
    cases: int, seed: int, out_dir: Path, jobs: int, engine: Diagnose
) -> Iterator[tuple[int, dict[str, Any]]]:
    """(number, case) as they come to an end, those of an earlier run first."""
    kept = {number: _kept(number, seed, out_dir) for number in range(cases)}
    yield from ((number, document) for number, document in kept.items() if document is not None)
    missing = [number for number, document in kept.items() if document is None]
    if jobs <= 1:
        for number in missing:
            yield number, run_one(number, seed, out_dir, engine)
        return
    failed: dict[int, AmbError] = {}
    with workers(jobs) as pool:
        waiting = {pool.submit(run_one, k, seed, out_dir, engine): k for k in missing}
        for future in as_completed(waiting):
            try:
                document = future.result()
            except SealError:
                raise
            except AmbError as error:  # the others may still be run
                failed[waiting[future]] = error
            else:
                yield waiting[future], document
    if failed:
        told = "; ".join(f"case {k + 1}: {error}" for k, error in sorted(failed.items()))
        raise AmbError(f"{told}; the other cases are kept in {out_dir}, where the trial can go on")


def _write(path: Path, document: Mapping[str, Any], private: bool = False) -> None:
    """Write JSON whole or not at all."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        json.dump(document, stream, indent=1)
        stream.write("\n")
    os.chmod(name, 0o600 if private else 0o644)
    os.replace(name, path)
