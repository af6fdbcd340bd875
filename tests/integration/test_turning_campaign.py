"""Campaigns on a simulated rig at standstill and at speed, with runout, and one identification of both."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.simulated.driver import SimulatedController
from service import bootstrap
from service.campaign.aims import Profile
from service.experiment import file
from sim.reference import reference_datasheet, reference_rig
from sim.twin import with_effects
from tests.support.command import ambit, refusal

pytestmark = pytest.mark.slow

POLAR, COUPLING, SPEED = 2.4, 0.03, 300.0
PROFILE = Profile(
    accuracy=0.005, points=36, validation_points=8, amplifier_points=8, coarse_points=12, blocks=6, rig_seconds=100.0
)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    effects = {
        "gyroscopic_coupling": {"polar_inertia_kgm2": POLAR - 1.9, "mode_coupling": COUPLING},
        "runout": {"amplitude_m": 1e-6},
    }
    paths = []
    for k, speed in enumerate((0.0, SPEED)):
        folder = tmp_path_factory.mktemp(f"speed{k}")
        controller = SimulatedController(with_effects(reference_rig(speed_rad_s=speed), effects), k + 1)
        bootstrap.measure(controller, reference_datasheet(), folder, profile=PROFILE)
        controller.close()
        paths.append(folder)
    return paths


def test_two_campaigns_give_the_rotor_at_speed(measured: list[Path], tmp_path: Path) -> None:
    still, turning = (folder / bootstrap.EXPERIMENT for folder in measured)
    sheet = measured[0] / bootstrap.DATASHEET
    done = ambit("identify", still, "--also", turning, "--rig", sheet, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / bootstrap.RESULT).read_text())["rotating"]
    polar = found["polar_inertia_kgm2"]
    assert polar["value"] == pytest.approx(POLAR, abs=3.5 * polar["std"])
    assert polar["value"] == pytest.approx(POLAR, rel=0.02)
    for mode in found["modes"]:
        assert mode["gyroscopic"]["value"] == pytest.approx(COUPLING, abs=3.5 * mode["gyroscopic"]["std"])
        assert mode["gyroscopic"]["std"] < 0.025 * COUPLING
    at_speed = next(s for s in found["sweeps"] if s["speed_rad_s"] == pytest.approx(SPEED))
    assert at_speed["synchronous"][0]["seen"]
    assert at_speed["rms_over_sigma"] < 1.5
    report = (tmp_path / bootstrap.REPORT).read_text()
    assert "Rotor at speed" in report
    assert 'id="campbell"' in report


def test_experiments_of_two_rigs_are_not_mixed(measured: list[Path], tmp_path: Path) -> None:
    other = file.read(measured[1] / bootstrap.EXPERIMENT)
    file.write(tmp_path / "other.h5", type(other)("other", other.axes, other.sweeps, other.attributes))
    line = refusal(
        "identify",
        measured[0] / bootstrap.EXPERIMENT,
        "--also",
        tmp_path / "other.h5",
        "--rig",
        measured[0] / bootstrap.DATASHEET,
        "--out",
        tmp_path / "out",
    )
    assert "give experiments of one rig" in line
