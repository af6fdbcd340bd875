"""The datasheet's values as priors, when they are asked for."""

from dataclasses import replace

import numpy as np
import pytest

from service.identification.fit import identify
from service.identification.options import Options
from service.identification.priors.tolerances import Tolerances
from sim.datasheet import Mode, Tolerance
from sim.reference import reference_rig
from tests.support.measured import small_experiment
from tests.support.planes import plane_model_of

TRUTH = plane_model_of(reference_rig(), "x")
LOOSE = Tolerance(
    current_stiffness=1e3,
    position_stiffness=1e3,
    mode_frequency=1e3,
    mode_damping=1e3,
    amplifier_frequency=1e3,
    amplifier_damping=1e3,
    amplifier_gain=1e3,
)


def sheet_of_truth(sheet, **tolerance):
    """A datasheet that is right about the x plane."""
    modes = tuple(
        Mode(w / (2 * np.pi), zeta, tuple(m[2:4]), tuple(m[4:6]))
        for m, w, zeta in zip(TRUTH.modes, TRUTH.natural_frequencies, TRUTH.damping_ratios, strict=True)
    )
    return replace(
        sheet,
        modes=modes,
        current_stiffness_n_per_a=(*TRUTH.ki, *sheet.current_stiffness_n_per_a[2:]),
        position_stiffness_n_per_m=(*TRUTH.ks, *sheet.position_stiffness_n_per_m[2:]),
        tolerance=replace(LOOSE, **tolerance),
    )


def test_the_jacobian_is_that_of_the_residuals():
    sheet = sheet_of_truth(small_experiment("x")[1], mode_frequency=0.01, mode_damping=0.5, current_stiffness=0.2)
    prior = Tolerances.of(sheet, ("xA", "xB"))
    rng = np.random.default_rng(0)
    model = TRUTH.at(TRUTH.theta * (1 + 0.003 * rng.normal(size=TRUTH.layout.size)))
    residual, jacobian = prior.rows(model)
    assert np.count_nonzero(np.abs(jacobian).sum(axis=1)) == len(residual), "a value of the datasheet is not used"
    for place in range(TRUTH.layout.delay):
        step = 1e-6 * abs(model.theta[place])
        up, down = model.theta.copy(), model.theta.copy()
        up[place] += step
        down[place] -= step
        slope = (prior.rows(model.at(up))[0] - prior.rows(model.at(down))[0]) / (2 * step)
        assert np.allclose(jacobian[:, place], slope, rtol=1e-5, atol=1e-6 * np.abs(jacobian).max() / abs(step) * 1e-9)


def test_what_the_model_lacks_says_nothing():
    sheet = sheet_of_truth(small_experiment("x")[1])
    far = replace(sheet, modes=(Mode(250.0, 0.001, (0.1, 0.1), (0.1, 0.1)),))
    residual, jacobian = Tolerances.of(far, ("xA", "xB")).rows(TRUTH)
    assert not residual[-5:].any()
    assert not jacobian[-5:].any()


@pytest.mark.parametrize(
    ("unknown", "silent"),
    [
        ({"damping_ratio": 0.0}, [1]),
        ({"shape_at_bearings": (0.0, 0.0), "shape_at_sensors": (0.0, 0.0)}, [2, 3, 4]),
        ({"shape_at_sensors": (0.0, 0.0)}, [2, 3, 4]),
        ({"shape_at_bearings": (0.0, 0.0)}, [2, 3, 4]),
    ],
    ids=["damping", "shape", "sensors", "bearings"],
)
def test_a_mode_whose_damping_or_shape_is_zero_is_known_by_the_rest(unknown, silent):
    sheet = sheet_of_truth(small_experiment("x")[1])
    full, part = (
        Tolerances.of(replace(sheet, modes=(replace(sheet.modes[0], **told),)), ("xA", "xB")).rows(TRUTH)
        for told in ({}, unknown)
    )
    rows = len(full[0]) - 5 + np.array(silent)
    assert full[1][rows].any(axis=1).all()
    for whole, without in zip(full, part, strict=True):
        assert not without[rows].any()
        np.testing.assert_array_equal(np.delete(without, rows, axis=0), np.delete(whole, rows, axis=0))


def test_deviations_shrink_as_bayes_says_and_only_when_asked():
    """1/sd^2 of data and datasheet add up, parameters correlated as they are."""
    experiment, sheet = small_experiment("x")
    loose, tight = sheet_of_truth(sheet), sheet_of_truth(sheet, current_stiffness=2e-5, mode_damping=3e-4)
    plain, ignored = (identify(experiment, s).planes["x"] for s in (loose, tight))
    assert np.array_equal(plain.model.theta, ignored.model.theta), "tolerances count though nobody asked"
    assert np.array_equal(plain.covariance, ignored.covariance)
    given = identify(experiment, tight, Options(priors=True)).planes["x"]
    assert given.parameter_names == plain.parameter_names
    places = [plain.model.layout.index(name) for name in plain.parameter_names]
    _, rows = Tolerances.of(tight, ("xA", "xB")).rows(plain.model)
    expected = np.linalg.inv(np.linalg.inv(plain.covariance_from_data) + rows[:, places].T @ rows[:, places])
    for name in ("ki_A", "ki_B", "ks_A", "mode_1_sigma_rad_s", "mode_2_sigma_rad_s"):
        k = plain.parameter_names.index(name)
        before, now = (np.sqrt(p.covariance_from_data[k, k]) for p in (plain, given))
        assert now == pytest.approx(np.sqrt(expected[k, k]), rel=0.03), name
        if name != "ks_A":
            assert now < 0.9 * before, name
    for key, truth in zip(("kiA", "kiB"), TRUTH.ki, strict=True):
        assert abs(given.stiffness[key].value - truth) < 4 * given.stiffness[key].std


def test_a_prior_against_the_data_is_told():
    experiment, sheet = small_experiment("x")
    wrong = replace(sheet_of_truth(sheet, current_stiffness=0.01), current_stiffness_n_per_a=(340.0,) * 4)
    plane = identify(experiment, wrong, Options(priors=True)).planes["x"]
    assert any("ki_A lies" in w and "tolerances off" in w for w in plane.warnings)
    assert not any("tolerances off" in w for w in identify(experiment, wrong).planes["x"].warnings)
