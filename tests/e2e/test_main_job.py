"""The main job from an empty folder to a result and a page, and the same from the experiment file alone."""

import json
from pathlib import Path

import pytest

from service.experiment import file
from sim import rig_file
from tests.support.browser import BROWSER, opened
from tests.support.command import ambit

TRUTH = {
    "x": {"kiA": 181.0, "kiB": 186.0, "ksA": 1.68e6, "ksB": 1.73e6},
    "y": {"kiA": 184.0, "kiB": 198.0, "ksA": 1.69e6, "ksB": 1.88e6},
}
MODES = {"x": (3097.0, 5708.0), "y": (3091.0, 5701.0)}


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Folder and JSON of a demo with the coarse plan."""
    out = tmp_path_factory.mktemp("demo") / "new" / "folder"
    done = ambit("demo", "--quick", "--seed", 3, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout), done.stderr


def test_everything_is_there(demo):
    out, _, _ = demo
    assert {p.name for p in out.iterdir()} == {"experiment.h5", "result.json", "report.html", "rig.toml", "service"}


def test_the_rig_is_found(demo):
    _, document, _ = demo
    for plane, truth in TRUTH.items():
        stiffness = document["planes"][plane]["stiffness"]
        for name, value in truth.items():
            assert stiffness[name]["value"] == pytest.approx(value, rel=0.01)
            assert stiffness[name]["unit"] == ("N/A" if name.startswith("ki") else "N/m")
        found = [m["natural_frequency_rad_s"]["value"] for m in document["planes"][plane]["rotor_modes"]]
        assert found == pytest.approx(MODES[plane], rel=1e-3)
        assert min(map(min, document["planes"][plane]["cross_validation_fit_percent"])) > 97


def test_the_result_file_is_what_was_printed(demo):
    out, document, _ = demo
    written = json.loads((out / "result.json").read_text())
    assert written["format"] == "amb-commissioning-result"
    assert written["version"] == 1
    assert written["experiment"].endswith("/experiment.h5")  # of the service: with the experiment's id
    assert "/api/v1/models/mod_" in document["report_url"]
    assert {k: document[k] for k in written} == written
    for path in document["files"].values():
        assert Path(path).exists()


@pytest.mark.slow
def test_in_process_it_gives_the_same(demo, tmp_path):
    """The demo goes through the service to a device process. Same seed: the plan takes the same way, to each figure."""
    _, document, _ = demo
    done = ambit("demo", "--quick", "--seed", 3, "--out", tmp_path, "--json", "--in-process")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["planes"] == document["planes"]


def test_progress_tells_points_rate_and_time_left(demo):
    _, _, said = demo
    assert "points/s" in said
    assert " left" in said


def test_the_experiment_has_all_its_parts(demo):
    experiment = file.read(demo[0] / "experiment.h5")
    assert {s.comment for s in experiment.sweeps} >= {"main", "validation", "amplifier", "noise"}


def test_identify_gives_the_same_from_the_file(demo, tmp_path):
    out, document, _ = demo
    done = ambit("identify", out / "experiment.h5", "--rig", out / "rig.toml", "--out", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    again = json.loads((tmp_path / "again" / "result.json").read_text())
    sheet, kept = (rig_file.read(folder / "rig.toml") for folder in (tmp_path / "again", out))
    assert sheet == kept, "a result without its datasheet is no baseline"
    for plane in "xy":
        for name, estimate in again["planes"][plane]["stiffness"].items():
            assert estimate["value"] == pytest.approx(document["planes"][plane]["stiffness"][name]["value"], rel=1e-6)
    assert "kiA, N/A" in done.stdout
    assert "unseen sweep" in done.stdout


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_the_report_opens_in_a_browser_without_a_network(demo):
    page = opened(demo[0] / "report.html")
    assert page.complaints == ()
    assert 'data-drawn="yes"' in page.dom
    for name in ("plant-xA", "plant-yB", "amplifier-x", "staged-y", "residuals-x", "poles-x", "amplitudes", "noise"):
        assert page.drawn(name) == 1, name
