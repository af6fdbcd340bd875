"""The blind trial over a real bus: a rig is served with something withheld, commissioned, diagnosed, opened, scored."""

import json

import pytest

from tests.support.command import Running, ambit, refusal

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
LAW = 72
"""A seed that withholds a law of no catalogue, in the log. A coarse log, in which the rotor seems to stand, would be
measured many times as long."""


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    """Folder with withheld.json, experiment.h5 and gap.json, and the commitment."""
    out = tmp_path_factory.mktemp("withheld")
    device = Running("rig", "serve", "--withheld", LAW, "--sealed", out / "withheld.json")
    try:
        url, commitment, rig = (device.first_line().removeprefix(p) for p in ("", "withheld: ", "datasheet: "))
        words = ("commission", "--controller", url, "--rig", rig, "--out", out, "--quick")
        done = ambit(*words, timeout_s=600)
        assert done.returncode == 0, done.stderr
    finally:
        device.end()
    words = ("gap", "diagnose", out / "experiment.h5", "--rig", rig, "--out", out, "--jobs", 1)
    done = ambit(*words, timeout_s=300)
    assert done.returncode == 0, done.stderr
    return out, commitment


def opening(out, commitment):
    return ("gap", "open", out / "withheld.json", "--commitment", commitment, "--gap", out / "gap.json")


def test_what_was_withheld_is_opened_and_scored(diagnosed):
    out, commitment = diagnosed
    done = ambit(*opening(out, commitment))
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("unlisted: held log -> none of these")
    assert done.stdout.endswith(": right\n")
    done = ambit(*opening(out, commitment), "--experiment", out / "experiment.h5", "--json")
    document = json.loads(done.stdout)
    assert document["right"]
    assert document["truth"]["law"] == "held_log"
    assert document["detectability"] > 10
    assert document["verdict"]["kind"] == json.loads((out / "gap.json").read_text())["verdict"]["kind"]


def test_a_diagnosis_of_another_served_case_is_refused(diagnosed, tmp_path):
    out, _ = diagnosed
    device = Running("rig", "serve", "--withheld", LAW + 1, "--sealed", tmp_path / "withheld.json")
    try:
        _, commitment = (device.first_line().removeprefix(p) for p in ("", "withheld: "))
    finally:
        device.end()
    (tmp_path / "gap.json").write_bytes((out / "gap.json").read_bytes())
    assert "measured on another case" in refusal(*opening(tmp_path, commitment))


def test_a_tampered_seal_is_caught(diagnosed, tmp_path):
    out, commitment = diagnosed
    sealed = json.loads((out / "withheld.json").read_text())
    (tmp_path / "withheld.json").write_text(json.dumps(sealed | {"truth": sealed["truth"].replace("held", "clipped")}))
    (tmp_path / "gap.json").write_bytes((out / "gap.json").read_bytes())
    assert "it was changed" in refusal(*opening(tmp_path, commitment))
    assert "it was changed" in refusal(*opening(out, "0" * 64))
