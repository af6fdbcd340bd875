"""A blind trial on the simulated rig, through the service's campaign; e2e/test_gap.py has one with its diagnosis."""

import json
import shutil
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import service.trial
from service.errors import StoppedError
from service.experiment.data import Experiment
from service.gap.trial.blind_trial import checked, fingerprint, summary
from service.trial import PROFILE, run_blind_trial, run_one
from sim.datasheet import Datasheet
from sim.errors import AmbError
from sim.rig_file import read
from sim.withheld.case import draw
from sim.withheld.seal import SealError, opened, seal

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

SHORT = replace(PROFILE, points=12, validation_points=4, amplifier_points=4, coarse_points=8, rig_seconds=30.0)
"""A campaign whose points nobody diagnoses."""
CASES, SEED = 3, 4
CLEAN = 2
"""Number of a case of these that withholds nothing: no effect whose strength would be searched for."""


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("trial")
    told: list[tuple[int, int]] = []

    def engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
        assert experiment.named("main") is not None
        assert datasheet.name == "withheld"
        return _report("effect", "loop_delay")

    with pytest.MonkeyPatch.context() as short:
        short.setattr(service.trial, "PROFILE", SHORT)
        result = run_blind_trial(
            CASES, SEED, out, lambda done, total, _: told.append((done, total)), jobs=1, engine=engine
        )
    assert told == [(k + 1, CASES) for k in range(CASES)]
    return out, result


def test_every_case_is_measured_sealed_diagnosed_and_scored(trial: tuple[Path, dict[str, Any]]) -> None:
    out, result = trial
    assert json.loads((out / "trial.json").read_text()) == result
    assert sum(result["scores"]["cases"].values()) == CASES
    assert result["scores"]["calibration"]["brier"] is not None
    for k in range(CASES):
        folder = out / f"case-{k + 1:04d}"
        names = {p.name for p in folder.iterdir()}
        assert names >= {"experiment.h5", "rig.toml", "commitment.json", "sealed.json", "gap.json"}
        assert json.loads((folder / "gap.json").read_text()) == result["cases"][k]["report"]


def test_the_published_files_alone_prove_the_trial(trial: tuple[Path, dict[str, Any]]) -> None:
    out, result = trial
    for k in range(CASES):
        folder = out / f"case-{k + 1:04d}"
        commitment = json.loads((folder / "commitment.json").read_text())["sha256"]
        truth = opened(json.loads((folder / "sealed.json").read_text()), commitment)
        drawn = draw(k, SEED).truth()
        assert truth == {**drawn, "detectability": truth["detectability"], "each": truth["each"]}
        assert set(truth["each"]) == (set(drawn["effects"]) if drawn["kind"] == "mixture" else set())
        assert truth["kind"] == "clean" or truth["detectability"] > 0
        assert result["cases"][k]["commitment"] == commitment
    again = summary(result["cases"], SEED)
    assert again["scores"] == result["scores"]


def test_what_the_diagnosis_may_see_tells_nothing(trial: tuple[Path, dict[str, Any]]) -> None:
    out, _ = trial
    for k in range(CASES):
        folder, truth = out / f"case-{k + 1:04d}", draw(k, SEED).truth()
        sheet = read(folder / "rig.toml")
        assert (sheet.name, sheet.effects) == ("withheld", ())
        raw = (folder / "experiment.h5").read_bytes()
        for word in [*truth["effects"], truth["law"]]:
            assert not word or word.encode() not in raw
        assert stat.S_IMODE((folder / "sealed.json").stat().st_mode) == 0o600


def test_a_truth_changed_after_the_trial_is_caught(trial: tuple[Path, dict[str, Any]]) -> None:
    _, result = trial
    case = result["cases"][0]
    truth = json.loads(case["sealed"]["truth"])
    flattering = {**truth, "effects": case["report"]["verdict"]["effects"], "kind": "single"}
    forged = {**case, "sealed": {**case["sealed"], "truth": json.dumps(flattering, sort_keys=True) + " "}}
    with pytest.raises(SealError, match="was changed"):
        summary([forged], SEED)


def test_a_report_changed_after_the_seal_was_opened_is_caught(trial: tuple[Path, dict[str, Any]]) -> None:
    _, result = trial
    case = result["cases"][0]
    forged = {**case, "report": {**case["report"], "rig": "another"}}
    with pytest.raises(SealError, match="report"):
        checked(forged)


def test_a_trial_that_was_stopped_goes_on_with_what_it_has(trial: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    out, result = trial
    kept = tmp_path / "trial"
    shutil.copytree(out, kept)
    (kept / "case-0003" / "case.json").unlink()  # stopped while this one was diagnosed
    asked: list[int] = []

    def engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
        asked.append(1)
        return _report()

    again = run_blind_trial(CASES, SEED, kept, jobs=1, engine=engine)
    assert len(asked) == 1
    assert again["cases"][:CLEAN] == result["cases"][:CLEAN]
    assert again["cases"][CLEAN]["report"]["verdict"]["probability"] == 0.9


def test_ctrl_c_tells_how_many_cases_are_kept(trial: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    _measured(trial, tmp_path)  # the third case is measured, and nothing diagnosed

    def engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
        raise KeyboardInterrupt

    for number in (1, 2):
        shutil.copytree(trial[0] / f"case-000{number}", tmp_path / f"case-000{number}")
    with pytest.raises(StoppedError, match=r"stopped by the user: 2 of 3 cases are kept in .*goes on"):
        run_blind_trial(CASES, SEED, tmp_path, jobs=1, engine=engine)
    assert run_blind_trial(CASES, SEED, tmp_path, jobs=1, engine=lambda *_: _report())["scores"]["cases"]


def test_ctrl_c_in_a_campaign_ends_the_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("service.campaign.run._run", interrupted)
    with pytest.raises(StoppedError, match="0 of 1 cases are kept"):
        run_blind_trial(1, SEED, tmp_path, jobs=1, engine=_no_engine)


def _no_engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
    raise AssertionError("a kept case is not diagnosed again")


def _flattered(document: dict[str, Any]) -> dict[str, Any]:
    """A kept case with a truth that its verdict is right about, sealed anew: it agrees with itself."""
    truth = json.loads(document["sealed"]["truth"])
    kept = seal({**truth, "kind": "single", "effects": document["report"]["verdict"]["effects"]})
    return {**document, "commitment": kept.commitment, "sealed": kept.document()}


def _reported_otherwise(document: dict[str, Any]) -> dict[str, Any]:
    """A kept case with another verdict, which has its hash."""
    report = {**document["report"], "verdict": {**document["report"]["verdict"], "kind": "none_of_these"}}
    return {**document, "report": report, "report_sha256": fingerprint(report)}


@pytest.mark.parametrize(
    ("forged", "message"),
    [(_flattered, "not the one of commitment"), (_reported_otherwise, "that was published")],
)
def test_a_kept_case_that_was_forged_as_a_whole_is_caught_by_what_was_published(
    trial: tuple[Path, dict[str, Any]], tmp_path: Path, forged: Any, message: str
) -> None:
    shutil.copytree(trial[0], tmp_path, dirs_exist_ok=True)
    kept = tmp_path / "case-0001" / "case.json"
    document = forged(json.loads(kept.read_text()))
    checked(document)  # it holds within itself
    kept.write_text(json.dumps(document))
    with pytest.raises(SealError, match=f"case-0001: .*{message}.*remove case.json"):
        run_blind_trial(CASES, SEED, tmp_path, jobs=1, engine=_no_engine)


@pytest.mark.parametrize(
    ("name", "change"),
    [("commitment.json", {"sha256": "0" * 64}), ("gap.json", {"where": {"path": "amplifier"}})],
)
def test_published_files_that_were_changed_are_caught_when_a_trial_goes_on(
    trial: tuple[Path, dict[str, Any]], tmp_path: Path, name: str, change: dict[str, Any]
) -> None:
    shutil.copytree(trial[0], tmp_path, dirs_exist_ok=True)
    path = tmp_path / "case-0002" / name
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(SealError, match="case-0002"):
        run_blind_trial(CASES, SEED, tmp_path, jobs=1, engine=_no_engine)


def test_a_kept_case_whose_published_files_are_gone_is_not_counted(
    trial: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(trial[0], tmp_path, dirs_exist_ok=True)
    (tmp_path / "case-0002" / "commitment.json").unlink()
    with pytest.raises(AmbError, match=r"commitment\.json"):
        run_blind_trial(CASES, SEED, tmp_path, jobs=1, engine=_no_engine)


def test_a_folder_of_another_trial_is_refused(trial: tuple[Path, dict[str, Any]]) -> None:
    out, _ = trial
    with pytest.raises(AmbError, match="another trial"):
        run_blind_trial(CASES, SEED + 1, out, jobs=1)


def _report(kind: str = "no_gap", *effects: str) -> dict[str, Any]:
    verdict = {"kind": kind, "effects": list(effects), "indistinguishable": [], "probability": 0.9}
    return {
        "verdict": verdict,
        "where": {"path": "plant"},
        "candidates": [],
        "shrinkage": {"closure": 0.9},
    }


def _measured(trial: tuple[Path, dict[str, Any]], folder: Path) -> None:
    """A case as it is when its campaign has ended."""
    case = folder / "case-0003"
    case.mkdir()
    for name in ("experiment.h5", "measured.json"):
        shutil.copy(trial[0] / "case-0003" / name, case)


def test_the_truth_is_committed_to_before_the_diagnosis_begins(
    trial: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    _measured(trial, tmp_path)
    seen: list[set[str]] = []

    def engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
        seen.append({p.name for p in (tmp_path / "case-0003").iterdir()})
        return _report()

    run_one(CLEAN, SEED, tmp_path, engine)
    assert {"commitment.json", "sealed.json"} <= seen[0]
    assert "gap.json" not in seen[0]


def test_a_seal_changed_while_the_diagnosis_runs_is_caught(trial: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    _measured(trial, tmp_path)
    sealed = tmp_path / "case-0003" / "sealed.json"

    def engine(experiment: Experiment, datasheet: Datasheet) -> dict[str, Any]:
        document = json.loads(sealed.read_text())
        truth = {**json.loads(document["truth"]), "kind": "single", "effects": ["loop_delay"]}
        sealed.write_text(json.dumps({**document, "truth": json.dumps(truth)}))
        return _report()

    with pytest.raises(SealError, match="was changed"):
        run_one(CLEAN, SEED, tmp_path, engine)


def test_a_trial_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AmbError, match="at least 1 case"):
        run_blind_trial(0, SEED, tmp_path)


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AmbError, match="cannot write the trial"):
        run_blind_trial(1, SEED, tmp_path / "file" / "out")
