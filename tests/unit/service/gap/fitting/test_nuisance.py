"""What a datasheet leaves uncertain: errors with one cause cost less together than apart, and are told as they are."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.fitting.nuisance import LARGEST, Nuisance, nuisance
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from sim.datasheet import Tolerance
from sim.twin import linear_model
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import sheet_of_one_plane

DATASHEET, TRUTH = known_datasheet(seed=1)
NU = nuisance(DATASHEET)


def vector(nu: Nuisance, off: dict[str, float]) -> np.ndarray:
    """The vector whose deviations, in tolerances, are those given and none else."""
    return np.linalg.solve(nu.root, [off.get(name, 0.0) for name in nu.names])


def axes(name: str, by: list[float]) -> dict[str, float]:
    return {f"{name}_{axis}": x for axis, x in zip(DATASHEET.axes, by, strict=True)}


@pytest.mark.parametrize(
    ("together", "apart"),
    [
        (axes("ki", [2, 2, 2, 2]), axes("ki", [2, -2, 2, -2])),
        (axes("ks", [2, 2, 2, 2]), axes("ks", [2, 2, -2, -2])),
        ({f"mode1_frequency_{p}": 2.0 for p in "xy"}, {"mode1_frequency_x": 2.0, "mode1_frequency_y": -2.0}),
        ({f"mode2_damping_{p}": 2.0 for p in "xy"}, {"mode2_damping_x": 2.0, "mode2_damping_y": -2.0}),
    ],
    ids=["ki", "ks", "frequency", "damping"],
)
def test_errors_with_one_cause_cost_less_together_than_apart(
    together: dict[str, float], apart: dict[str, float]
) -> None:
    common, differing = (NU.price(vector(NU, off)) for off in (together, apart))
    alone = 4.0 * len(together)  # two tolerances each, were nothing shared
    assert 4.0 <= common < 0.75 * alone
    assert differing > 1.5 * alone


def test_what_some_values_surprise_by_is_what_they_cost_at_least() -> None:
    """Alone, as correlated values are, and whatever all others are."""
    both = vector(NU, {"mode1_damping_x": 3.0, "mode1_damping_y": 3.0, "mass": 1.0})
    of = [NU.names.index(f"mode1_damping_{plane}") for plane in "xy"]
    assert NU.surprise(both, of[:1]) == pytest.approx(9.0)
    assert 9.0 < NU.surprise(both, of) < 18.0  # one cause for both, not two
    assert NU.surprise(both, of) == pytest.approx(NU.price(both) - 1.0)
    assert NU.surprise(both, []) == 0.0


def test_one_value_off_moves_that_value_of_the_rig_and_is_told_alone() -> None:
    rig = NU.at(vector(NU, {"mode1_frequency_y": 3.0, "ki_xA": -4.0}))
    t = DATASHEET.tolerance
    was = NU.rig
    np.testing.assert_allclose(np.log(rig.magnets.ki / was.magnets.ki), [-4 * t.current_stiffness, 0, 0, 0], atol=1e-12)
    moved = [
        np.log(plane[0].natural_frequency_rad_s / before[0].natural_frequency_rad_s)
        for plane, before in zip(rig.rotor.modes, was.rotor.modes, strict=True)
    ]
    np.testing.assert_allclose(moved, [0, 3 * t.mode_frequency], atol=1e-12)
    told = NU.far_off(vector(NU, {"mode1_frequency_y": 3.0, "ki_xA": -4.0}))
    assert [words.rsplit(" ", 2)[0] for words in told] == ["current stiffness xA", "mode1 frequency y"]


@pytest.mark.parametrize(
    ("off", "beyond_doubt"),
    [
        ({"ki_xA": 3.0}, 0),
        ({"ki_xA": 3.0, "ki_yB": -3.0}, 2),
        ({"ki_xA": 3.0, "ks_xA": 3.0}, 0),
        ({"mass": -3.8}, 1),
        ({"mode1_frequency_x": 3.0, "mode1_frequency_y": 3.0}, 0),
    ],
)
def test_one_value_of_fifty_may_be_off_by_chance_and_several_of_a_kind_are_not(
    off: dict[str, float], beyond_doubt: int
) -> None:
    assert len(NU.clearly_off(vector(NU, off))) == beyond_doubt


def test_a_rig_with_two_axes_has_no_other_plane() -> None:
    one = nuisance(sheet_of_one_plane(DATASHEET))
    assert one.rig.n_axes == 2
    np.testing.assert_array_equal(one.root[-12:], np.eye(len(one))[-12:])


@pytest.mark.slow
def test_dampings_that_a_datasheet_has_wrong_by_what_it_allows_are_no_effect() -> None:
    """One statement for both planes, three times too low under a tolerance of a half, is one error and not two."""
    modes = tuple(replace(m, damping_ratio=m.damping_ratio / f) for m, f in zip(DATASHEET.modes, (3, 3), strict=True))
    d = diagnose(experiment(true_rig(TRUTH)), replace(DATASHEET, modes=modes))
    assert d.verdict.kind == "no_gap"


@pytest.mark.slow
def test_a_shaft_stiffer_in_one_plane_than_in_the_other_is_not_what_one_datasheet_describes() -> None:
    """By four tolerances, which errors of their own would hold: two of either plane's."""
    rig = true_rig(TRUTH)
    apart = 0.0065 * np.array([-1.0, 1.0])
    modes = tuple(
        tuple(replace(m, natural_frequency_rad_s=m.natural_frequency_rad_s * (1 + e)) for m in plane)
        for e, plane in zip(apart, rig.rotor.modes, strict=True)
    )
    d = diagnose(experiment(replace(rig, rotor=replace(rig.rotor, modes=modes))), DATASHEET)
    assert d.verdict.kind == "none_of_these"
    assert any(re.search(r"mode\d frequency (x by -2\.0|y by \+2\.0)", reason) for reason in d.verdict.reasons)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_tolerance_that_says_anything_lets_values_go_no_farther_than_arithmetic_does(sign: float) -> None:
    anything = Tolerance(**{f.name: 1e3 for f in fields(Tolerance)})
    loose = nuisance(replace(DATASHEET, tolerance=anything))
    assert loose.sigma.max() <= max(LARGEST, *DATASHEET.sensor_from_cog_m)
    rig = loose.at(np.full(len(loose), sign * TOLERANCE_BOUND))
    assert np.isfinite(linear_model(rig, np.geomspace(10.0, 1000.0, 20)).y_per_u).all()
    np.testing.assert_array_equal(nuisance(DATASHEET).sigma, NU.sigma)
