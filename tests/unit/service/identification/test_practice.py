"""Data that an independent nonlinear program made; skipped where the folder is not beside the repository."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from service.experiment.file import read as read_experiment
from service.identification.fit import identify
from sim.rig_file import read as read_datasheet

PRACTICE = Path(__file__).parents[5] / "shared" / "practice"
KI = (181.0, 186.0, 184.0, 198.0)
KS = (1.68e6, 1.73e6, 1.69e6, 1.88e6)
pytestmark = [
    pytest.mark.skipif(not PRACTICE.is_dir(), reason="practice cases are not beside the repository"),
    pytest.mark.slow,
]


@cache
def result_of(case: str):
    folder = PRACTICE / case
    return identify(read_experiment(folder / "experiment.h5"), read_datasheet(folder / "rig.toml"))


@pytest.fixture(scope="module")
def no_effect():
    return result_of("p01")


def test_stiffness_of_the_case_without_effect(no_effect) -> None:
    found = [no_effect.planes[p].stiffness for p in "xy"]
    ki = [s[k].value for s in found for k in ("kiA", "kiB")]
    ks = [s[k].value for s in found for k in ("ksA", "ksB")]
    assert ki == pytest.approx(KI, rel=5e-4)
    assert ks == pytest.approx(KS, rel=5e-4)
    for s in found:
        assert s["kiA"].std < 1e-3 * s["kiA"].value


def test_modes_of_the_case_without_effect_are_those_of_the_free_rotor(no_effect) -> None:
    for plane in no_effect.planes.values():
        w = [m.natural_frequency_rad_s.value for m in plane.modes]
        zeta = [m.damping_ratio.value for m in plane.modes]
        assert w == pytest.approx([3097.0, 5708.0], rel=2e-4)
        assert zeta == pytest.approx([0.001, 0.001], rel=0.1)


def test_the_case_without_effect_fits_another_amplitude_and_passes_its_tests(no_effect) -> None:
    for plane in no_effect.planes.values():
        assert plane.cross_validation_fit_percent is not None
        assert plane.cross_validation_fit_percent.min() > 99.9
        assert plane.adequate
        assert plane.tests_passed


@pytest.mark.parametrize("case", ["p05", "p06", "p09", "p13"])
def test_an_effect_that_the_model_lacks_is_flagged_and_never_an_exception(case: str) -> None:
    result = result_of(case)
    json.dumps(result.document(), allow_nan=False)
    for k, plane in enumerate(result.planes.values()):
        assert not plane.adequate
        assert "something acts" in plane.warnings[0]
        # still of the right size
        assert [plane.stiffness[n].value for n in ("kiA", "kiB")] == pytest.approx(KI[2 * k : 2 * k + 2], rel=0.04)
        assert [m.natural_frequency_rad_s.value for m in plane.modes][-1] == pytest.approx(5708, rel=2e-3)


def test_a_delay_is_told_and_spoils_nothing() -> None:
    plane = result_of("p02").planes["x"]
    assert plane.delay_s.value == pytest.approx(35e-6, abs=0.5e-6)
    assert plane.stiffness["kiA"].value == pytest.approx(181, rel=1e-3)
    assert np.all(np.isfinite(plane.covariance))


def test_a_log_out_of_step_whose_last_block_lost_a_sample_is_mended_and_told() -> None:
    result = result_of("p03")
    assert any("1 sample early" in w for w in result.warnings)
    assert any("block 6 of 6" in w for w in result.warnings)
    for k, plane in enumerate(result.planes.values()):
        assert plane.delay_s.value == pytest.approx(0, abs=0.5e-6)
        found = [plane.stiffness[n] for n in ("kiA", "kiB", "ksA", "ksB")]
        assert [s.value for s in found] == pytest.approx((*KI[2 * k :][:2], *KS[2 * k :][:2]), rel=3e-4)


def test_a_support_shows_as_a_third_mode() -> None:
    plane = result_of("p08").planes["x"]
    assert plane.modes[0].natural_frequency_rad_s.value == pytest.approx(2 * np.pi * 430, rel=1e-3)
    assert plane.modes[0].damping_ratio.value == pytest.approx(0.01, rel=0.03)


def test_saturated_magnets_leave_the_rotor_its_modes() -> None:
    """No model explains them, and from the poles that were seen no fit leads anywhere: what is told are two modes."""
    for plane in result_of("p06").planes.values():
        assert [m.kind for m in plane.modes] == ["rotor", "rotor"]
        assert [m.natural_frequency_rad_s.value for m in plane.modes] == pytest.approx([3097.0, 5708.0], rel=2e-3)
        assert [m.damping_ratio.value for m in plane.modes] == pytest.approx([0.001, 0.001], rel=0.1)
