"""Alternatives are shown with every score, and what data can tell of the extended set is proven by profiles."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.fit import identify
from service.identification.result.commissioning import CommissioningResult
from service.identification.statistics.evidence import leave_one_out
from tests.support.rotors import drawn_rig


def test_leave_one_out_is_what_refits_without_each_value_give() -> None:
    rng = np.random.default_rng(0)
    jacobian, data = rng.normal(size=(20, 3)), rng.normal(size=20)
    found = leave_one_out(data - jacobian @ np.linalg.lstsq(jacobian, data, rcond=None)[0], jacobian)
    errors = []
    for k in range(20):
        rest = np.arange(20) != k
        theta = np.linalg.lstsq(jacobian[rest], data[rest], rcond=None)[0]
        errors.append(data[k] - jacobian[k] @ theta)
    assert found == pytest.approx(np.sqrt(np.mean(np.square(errors))))


def test_every_number_of_modes_has_every_score(result: CommissioningResult) -> None:
    """The right number of modes is no worse by cross-validation than any other, and one less is far worse."""
    for plane in result.document()["planes"].values():
        rows = plane["mode_evidence"]
        for row in rows:
            assert all(row[k] is not None for k in ("aic", "fpe", "mdl", "leave_one_out_rms", "cross_validation_rms"))
        chosen = next(r for r in rows if r["chosen"])
        assert chosen["name"] == "2 modes"
        assert chosen["cross_validation_rms"] == pytest.approx(1.0, abs=0.25)
        assert chosen["leave_one_out_rms"] == pytest.approx(1.0, abs=0.25)
        fewer = next(r for r in rows if r["name"] == "1 mode")
        assert fewer["cross_validation_rms"] > 10 * chosen["cross_validation_rms"]
        assert fewer["leave_one_out_rms"] > 10 * chosen["leave_one_out_rms"]


def test_every_order_of_an_amplifier_has_every_score(result: CommissioningResult) -> None:
    for plane in result.document()["planes"].values():
        for amplifier in plane["amplifiers"].values():
            rows = {r["name"]: r for r in amplifier["evidence"]}
            assert rows["order 2"]["chosen"]
            for score in ("aic", "fpe", "mdl", "leave_one_out_rms", "cross_validation_rms"):
                assert rows["order 1"][score] > rows["order 2"][score]


def test_profiles_prove_what_can_be_told(result: CommissioningResult) -> None:
    """Quadratic in standard deviations where identifiable; flat to rounding along the aliases, ten per cent away."""
    for plane in result.document()["planes"].values():
        profile = plane["extended"]["profile"]
        for name in ("transverse_inertia_kgm2", "centre_of_gravity_m"):
            assert not profile[name]["flat"]
            assert profile[name]["cost_growth"] == pytest.approx([4.0, 1.0, 1.0, 4.0], rel=0.15)
        for name in ("mass_kg", "common_sensor_gain"):
            assert profile[name]["flat"]
            assert profile[name]["held_at"] == pytest.approx([0.9 * profile[name]["best"], 1.1 * profile[name]["best"]])
        assert np.max(np.abs(profile["mass_kg"]["cost_growth"])) < 1e-3


def test_a_profile_keeps_to_what_is_known_of_modes_beyond_the_band() -> None:
    """Two of them, whose damping no line tells: a refit that gave them any would undercut the fit that is profiled."""
    rng = np.random.default_rng(0)
    rig = drawn_rig("node at a sensor", lambda low, high: float(rng.uniform(low, high)))
    plane = identify(rig.experiment(10 ** rng.uniform(-3, -2), 0), rig.sheet).planes["x"]
    assert [m.kind for m in plane.modes] == ["rotor", "rotor", "beyond", "beyond"]
    profile = plane.document()["extended"]["profile"]["centre_of_gravity_m"]
    assert not profile["flat"]
    assert profile["cost_growth"] == pytest.approx([4.0, 1.0, 1.0, 4.0], rel=0.15)
