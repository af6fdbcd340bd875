"""Diagnosis from an experiment of an independent program, and the twin that it leads to."""

import hashlib
import json
import signal
import time
from pathlib import Path

import pytest

from sim import rig_file
from tests.support.browser import BROWSER, opened
from tests.support.command import Running, ambit, refusal, wait_until

PRACTICE = Path(__file__).parents[2].parent / "shared" / "practice"
pytestmark = pytest.mark.slow
needs_practice = pytest.mark.skipif(not PRACTICE.exists(), reason="the practice cases are not beside the repository")
CASE = "p02"


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """Folder with gap.json and the JSON that was printed."""
    if not PRACTICE.exists():
        pytest.skip("the practice cases are not beside the repository")
    out = tmp_path_factory.mktemp("gap") / "out"
    case = PRACTICE / CASE
    done = ambit(
        "gap", "diagnose", case / "experiment.h5", "--rig", case / "rig.toml", "--out", out, "--json", timeout_s=280
    )
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout)


def test_the_effect_is_found(diagnosed):
    out, printed = diagnosed
    truth = json.loads((PRACTICE / CASE / "truth.json").read_text())
    document = json.loads((out / "gap.json").read_text())
    assert {k: printed[k] for k in document} == document
    assert document["format"] == "amb-gap-report"
    assert document["verdict"]["effects"] == truth["effects"]
    assert document["shrinkage"]["closure"] > 0.9


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_the_report_opens_in_a_browser_without_a_network(diagnosed):
    page = opened(diagnosed[0] / "gap.html")
    assert page.complaints == ()
    assert 'data-drawn="yes"' in page.dom
    for name in ("gap", "quotient", "residuals", "channels", "candidates", "amplitude", "harmonics", "nu-gap"):
        assert page.drawn(name) == 1, name


def test_the_twin_with_the_effect_has_no_gap(diagnosed, tmp_path):
    out, _ = diagnosed
    case = PRACTICE / CASE
    twin = tmp_path / "twin" / "rig.toml"
    done = ambit("gap", "apply", out / "gap.json", "--rig", case / "rig.toml", "--out", twin)
    assert done.returncode == 0, done.stderr
    assert "loop_delay" in done.stdout
    assert [name for name, _ in rig_file.read(twin).effects] == ["loop_delay"]
    words = ("gap", "diagnose", case / "experiment.h5", "--rig", twin, "--out", tmp_path, "--jobs", 1, "--json")
    again = ambit(*words, timeout_s=280)
    assert json.loads(again.stdout)["verdict"]["kind"] == "no_gap", again.stderr
    assert "already" in refusal("gap", "apply", out / "gap.json", "--rig", twin, "--out", tmp_path / "twice.toml")
    before = twin.read_bytes()
    assert "give --out another name" in refusal("gap", "apply", out / "gap.json", "--rig", twin, "--out", twin)
    absent = tmp_path / "absent.toml"
    assert str(absent) in refusal("gap", "apply", out / "gap.json", "--rig", absent, "--out", twin)
    assert twin.read_bytes() == before


@needs_practice
def test_a_report_that_is_none(tmp_path):
    (tmp_path / "gap.json").write_text('{"format": "something else"}')
    case = PRACTICE / CASE
    line = refusal("gap", "apply", tmp_path / "gap.json", "--rig", case / "rig.toml", "--out", tmp_path / "twin.toml")
    assert "gap.json" in line


@needs_practice
@pytest.mark.parametrize("seconds", [0.3, 3.0], ids=["while workers load", "while they fit"])
def test_ctrl_c_ends_all_workers_in_one_line(seconds, tmp_path):
    case, out = PRACTICE / CASE, tmp_path / "out"
    run = Running("gap", "diagnose", case / "experiment.h5", "--rig", case / "rig.toml", "--out", out, "--jobs", 2)
    try:
        wait_until(out.exists, "the folder")
        time.sleep(seconds)
        run.interrupt()
        assert run.wait() == 1
        assert run.said == ["ambit: stopped by the user; files that were finished are kept\n"]
        assert not (out / "gap.json").exists()
    finally:
        run.end()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_blind_trial_told_to_stop_ends_at_once_and_says_what_it_keeps(number, tmp_path):
    out = tmp_path / "trial"
    run = Running("gap", "blind-trial", "--cases", 2, "--seed", 4, "--jobs", 2, "--out", out)
    try:
        wait_until(lambda: (out / "case-0001").exists() and (out / "case-0002").exists(), "both cases")
        run.process.send_signal(number)  # to the command alone, as a supervisor does
        assert run.wait(15) == 1
        kept = f"0 of 2 cases are kept in {out}, where the same command goes on"
        assert run.said == [f"ambit: stopped by the user: {kept}\n"]
    finally:
        run.end()


def test_a_blind_trial_can_be_checked_by_anyone(tmp_path):
    """Truth sealed behind the hash that was published, report and seal as they were, scores printed."""
    out = tmp_path / "trial"
    words = ("gap", "blind-trial", "--cases", 1, "--seed", 4, "--jobs", 1, "--out", out, "--json")
    done = ambit(*words, timeout_s=280)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scores"]["cases"]["single"] == 1
    case = out / "case-0001"
    assert {p.name for p in case.iterdir()} >= {
        "experiment.h5", "rig.toml", "commitment.json", "sealed.json", "gap.json",
    }  # fmt: skip
    commitment = json.loads((case / "commitment.json").read_text())["sha256"]
    sealed = json.loads((case / "sealed.json").read_text())
    assert hashlib.sha256(f"{sealed['nonce']}\n{sealed['truth']}".encode()).hexdigest() == commitment
    truth = json.loads(sealed["truth"])
    assert truth["kind"] == "single"
    assert truth["effects"][0] not in (case / "rig.toml").read_text()
