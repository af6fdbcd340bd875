"""Where a fit of a resonance, a voltage limit or a drift begins."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.predict import current, residual, weight
from service.gap.fitting.starts import resonances
from service.gap.fitting.starts.of_effect import SEARCHES, starts
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from service.gap.measured.observation import observe
from service.gap.which.optional_parameters import on_stops_off_centre
from service.gap.which.search import explain, plain_twin
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.slow


def test_a_mode_between_two_lines_begins_near_its_frequency_and_shape() -> None:
    """Its ends move against each other, which no housing does, and it is far narrower than the lines are apart."""
    datasheet, truth = known_datasheet(seed=12)
    nu = nuisance(datasheet)
    shape = {"bearing_A": 0.017, "bearing_B": -0.019, "sensor_A": 0.017, "sensor_B": -0.015}
    values = {"frequency_hz": 145.0, "damping_ratio": 0.0016, **{f"{k}_per_sqrt_kg": v for k, v in shape.items()}}
    o = observe(sweep(with_effects(true_rig(truth), {"extra_flexible_mode": values}), lines(), 0.15, seed=1), nu.rig)
    assert np.abs(o.frequency_hz / 145.0 - 1).min() > 0.02
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    left = residual(nu.rig, o)[..., 2 * nu.rig.n_axes :]
    first, *_ = starts(CATALOGUE["extra_flexible_mode"], SweepResiduals(nu.rig, left, o, ground))
    assert abs(first["frequency_hz"] / 145.0 - 1) < 0.01
    found, true = (np.array([v[f"{k}_per_sqrt_kg"] for k in shape]) for v in (first, values))
    assert abs(found @ true) > 0.8 * np.linalg.norm(found) * np.linalg.norm(true)


@pytest.mark.parametrize(("beside", "size"), [(0.98, 1.4), (1.02, 2.0)])
def test_a_faint_mode_that_shows_at_one_line_alone_is_found(beside: float, size: float) -> None:
    """To a rough stage of a fit the twin is as good without it, and its start as good as any other."""
    datasheet, truth = known_datasheet(seed=12)
    nu, hz = nuisance(datasheet), lines(24)
    shape = {"bearing_A": 1.7e-3, "bearing_B": 1.4e-3, "sensor_A": -1.3e-3, "sensor_B": -1.0e-3}
    values = {f"{k}_per_sqrt_kg": size * v for k, v in shape.items()}
    own = beside * float(hz[np.argmin(np.abs(hz - 90.0))])
    faint = with_effects(
        true_rig(truth), {"extra_flexible_mode": {"frequency_hz": own, "damping_ratio": 0.0035, **values}}
    )
    o = observe(sweep(faint, hz, 0.15, seed=1), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    best = explain(Fitter(), ground).order[0].candidate
    assert best.effects == ("extra_flexible_mode",)
    assert abs(best.fit.values[0]["frequency_hz"] / own - 1) < 0.002


def test_a_mode_above_all_lines_begins_up_there() -> None:
    """Only its flank is in the band: from the last line a fit ended at a mode that is none."""
    datasheet, truth = known_datasheet(seed=13)
    nu = nuisance(datasheet)
    shapes = {f"{place}_{end}_per_sqrt_kg": 0.1 for place in ("bearing", "sensor") for end in "AB"}
    mode = {"frequency_hz": 1450.0, "damping_ratio": 0.006, **shapes, "sensor_B_per_sqrt_kg": -0.08}
    o = observe(sweep(with_effects(true_rig(truth), {"extra_flexible_mode": mode}), lines(), 0.3, 1), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        e = explain(fitter, ground)
    best = e.order[0].candidate
    assert best.effects == ("extra_flexible_mode",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    assert best.fit.values[0]["frequency_hz"] == pytest.approx(1450.0, rel=0.05)


def test_a_plane_that_was_never_excited_has_no_resonance_of_its_own() -> None:
    datasheet, truth = known_datasheet(seed=12)
    nu, measured = nuisance(datasheet), sweep(true_rig(truth), lines(), 0.15, seed=1)
    o = observe(measured.select(measured.axis < 2), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    left = SweepResiduals(nu.rig, residual(nu.rig, o)[..., 2 * nu.rig.n_axes :], o, ground)
    housing = CATALOGUE["support_resonance"]
    assert resonances.resonances(housing, left, plane=0)
    assert resonances.resonances(housing, left, plane=1) == []
    assert resonances.unlike_planes(housing, left) == []


def test_a_voltage_limit_begins_at_that_of_a_current_that_slews_all_the_time() -> None:
    """Such a current is a triangle, whose fundamental is 4/pi as steep; from a limit far off there it is not found."""
    datasheet, truth = known_datasheet(seed=13)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), lines(8), 0.15, seed=1), nu.rig)
    assert o.I is not None
    limit_a_per_s, steepest = 600.0, np.abs(o.U[:, o.fundamental]).max(axis=1) * 2 * np.pi * o.points_hz
    o = replace(o, U=o.U * (4 * limit_a_per_s / steepest)[:, None, None])
    limited = CATALOGUE["amplifier_voltage_limit"].on(nu.rig, slew_inverse_s_per_a=1 / limit_a_per_s, slope_seen=0.0)
    o = replace(o, I=current(limited, o))
    left = (o.I - current(nu.rig, o)) * weight(o, "i")
    ground = Ground(nu, parts(nu, (o,))[1], (o,), np.zeros(len(nu)))
    begun = starts(CATALOGUE["amplifier_voltage_limit"], SweepResiduals(nu.rig, left, o, ground))
    assert min(abs(1 / s["slew_inverse_s_per_a"] / limit_a_per_s - 1) for s in begun) < 0.02


def test_a_voltage_limit_begins_near_that_of_a_current_loop_that_has_wound_up() -> None:
    """One line lags by half a period, for limits within some per cent alone; from any other no fit comes there."""
    datasheet, truth = known_datasheet(seed=13)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), np.append(lines(8), 479.0), 0.15, seed=1), nu.rig)
    assert o.I is not None
    slopes = np.abs(o.U[:, o.fundamental]).max(axis=1) * 2 * np.pi * o.points_hz
    o = replace(o, U=o.U * (np.where(o.points_hz == 479.0, 1.0, 0.3) * 3100.0 / slopes)[:, None, None])
    limited = CATALOGUE["amplifier_voltage_limit"].on(nu.rig, slew_inverse_s_per_a=1 / 2650.0, slope_seen=1.0)
    o = replace(o, I=current(limited, replace(o, I=-current(nu.rig, o))))
    driven = o.points_hz == 479.0
    own = np.arange(len(o.line))[driven], o.axis[driven]
    lag = np.angle(o.I[:, o.fundamental][own] / o.U[:, o.fundamental][own])
    assert (np.abs(lag) > 2.5).all(), "wound up"
    ground = Ground(nu, parts(nu, (o,))[1], (o,), np.zeros(len(nu)))
    left = (o.I - current(nu.rig, o)) * weight(o, "i")
    first, *_ = starts(CATALOGUE["amplifier_voltage_limit"], SweepResiduals(nu.rig, left, o, ground))
    assert 1 / first["slew_inverse_s_per_a"] == pytest.approx(2650.0, rel=0.02)
    assert first["slope_seen"] == 1.0


def test_without_the_current_a_voltage_limit_begins_at_what_the_amplifiers_make_of_the_control_signal() -> None:
    """Above their bandwidth they ask for much less than it: from a limit beyond that, none is ever reached."""
    datasheet, truth = known_datasheet(seed=13)
    nu = nuisance(datasheet)
    measured = sweep(true_rig(truth), np.geomspace(100.0, 2500.0, 8), 0.15, seed=1)
    o, blind = observe(measured, nu.rig), observe(replace(measured, I=None), nu.rig)
    assert o.I is not None
    steepest = float((np.abs(o.I[:, o.fundamental]).max(axis=1) * 2 * np.pi * o.points_hz).max())
    ground = Ground(nu, parts(nu, (blind,))[1], (blind,), np.zeros(len(nu)))
    begun = starts(CATALOGUE["amplifier_voltage_limit"], SweepResiduals(nu.rig, np.zeros_like(o.Y), blind, ground))
    assert all(0.5 * steepest < 1 / s["slew_inverse_s_per_a"] < steepest for s in begun)


@pytest.mark.parametrize(("end", "plane"), [(-0.9, 0.0), (0.0, 0.0), (1.0, 1.0)])
def test_a_drift_begins_at_its_strength_and_at_the_magnets_that_drift(end: float, plane: float) -> None:
    datasheet, truth = known_datasheet(seed=18)
    nu = nuisance(datasheet)
    values = {"ki_change": -0.02, "ks_change": -0.03, "duration_s": 300.0}
    one = {**values, "end_imbalance": end, "plane_imbalance": plane}
    o = observe(sweep(with_effects(true_rig(truth), {"thermal_drift": one}), lines(), 0.15, 1, during=(0, 1)), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    null, (left,) = plain_twin(Fitter(), ground)
    (begun,) = starts(CATALOGUE["thermal_drift"], SweepResiduals(null.fit.rig, left, o, ground))
    assert (begun["end_imbalance"], begun["plane_imbalance"]) == pytest.approx((end, plane), abs=0.26)
    assert (begun["ki_change"], begun["ks_change"]) == pytest.approx((-0.02, -0.03), rel=0.3)


def test_a_disc_is_found_with_the_way_in_which_each_mode_tilts_it() -> None:
    """From no slope at all the second one came out with the other sign, and an inertia a tenth too small."""
    datasheet, truth = known_datasheet(seed=15)
    nu = nuisance(datasheet)
    slopes = {"mode1_slope_per_m_sqrt_kg": -0.19, "mode2_slope_per_m_sqrt_kg": -0.73}
    values = {"polar_inertia_kgm2": 0.37, "mode_coupling": 0.0, **slopes}
    rig = with_effects(replace(true_rig(truth), speed_rad_s=254.0), {"gyroscopic_coupling": values})
    o = replace(observe(sweep(rig, lines(14), 0.15, seed=1), nu.rig), speed_rad_s=254.0)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        best = explain(fitter, ground, plain_twin(fitter, ground)).order[0].candidate
    assert best.effects == ("gyroscopic_coupling",)
    for name, value in values.items():
        assert best.fit.values[0][name] == pytest.approx(value, rel=0.05, abs=0.003), name


def test_a_stop_that_the_fitted_twin_cannot_have_begins_as_typical() -> None:
    """A datasheet with its stiffness in N/mm: the fitted magnets have another air gap, and their stops other places."""
    sheet, truth = known_datasheet(seed=12)
    in_n_per_mm = replace(sheet, position_stiffness_n_per_m=tuple(1e-3 * k for k in sheet.position_stiffness_n_per_m))
    nu, rig = nuisance(in_n_per_mm), true_rig(truth)
    o = observe(sweep(rig, lines(14), 0.15, seed=1), rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    left = residual(rig, o)[..., 2 * rig.n_axes :]
    effect = CATALOGUE["touchdown_contact"]
    (only,) = starts(effect, SweepResiduals(rig, left, o, ground))
    assert only["stiffness_n_per_m"] == next(p for p in effect.of(nu.rig).parameters).typical
    basic = SimpleNamespace(effects=(effect.id,), fit=SimpleNamespace(values=[only]))
    null = SimpleNamespace(fit=SimpleNamespace(rig=rig, theta=ground.theta))
    assert list(on_stops_off_centre(ground, null, [left], [basic])) == [], "none off the centre either"


def test_every_search_is_of_an_effect() -> None:
    """A name that is none would never be searched, and its effect start anywhere."""
    assert SEARCHES.keys() <= CATALOGUE.keys()
