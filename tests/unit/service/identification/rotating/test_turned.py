"""A turning rotor: polar inertia, splitting and whirl are found, at standstill the planes stand alone."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.controller.check import ControllerCheck, check_controller
from service.identification.fit import identify
from service.identification.priors.beyond import BEYOND_ROWS
from service.identification.priors.split import Split, log_ratios
from service.identification.result.commissioning import CommissioningResult
from service.identification.result.saved import saved_planes, saved_rotor
from service.identification.rotating.campbell import campbell
from service.identification.rotating.fit import fit_rotating, held_rows
from service.identification.rotating.model import joined, paired
from service.identification.rotating.motion import TurningPoints
from service.identification.rotating.points import speed_points
from service.identification.rotating.turned import Turned
from service.identification.rotating.whirl import loop_matrix, whirl
from service.identification.statistics.drawn import drawn
from sim.datasheet import Datasheet
from sim.loop import Loop
from sim.twin import linear_model
from tests.support import turning
from tests.support.turning import (
    COUPLING,
    HZ,
    INTERNAL,
    PERIOD_S,
    POLAR,
    SPEEDS,
    rig_at,
    sweep_at,
    told_the_noise,
    true_model,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def turning_result(datasheet: Datasheet) -> CommissioningResult:
    sweeps = [sweep_at(w, k) for k, w in enumerate(SPEEDS)]
    sweeps.append(sweep_at(SPEEDS[2], 9, np.geomspace(12, 950, 20), comment="validation"))
    return identify(Experiment("reference", datasheet.axes, tuple(sweeps)), datasheet)


@pytest.fixture(scope="module")
def turned(turning_result: CommissioningResult) -> Turned:
    assert turning_result.rotating is not None
    return turning_result.rotating


def test_the_model_is_the_twin_of_a_turning_rig() -> None:
    """An independent model of the same physics, through other code, at a speed."""
    rig, hz = rig_at(300.0), np.geomspace(10, 1000, 80)
    found, twin = true_model(rig).response(2 * np.pi * hz, 300.0), linear_model(rig, hz).y_per_u
    assert np.max(np.abs(found - twin)) < 1e-6 * np.max(np.abs(twin))


def test_at_standstill_the_model_is_the_two_planes() -> None:
    rig = rig_at(0.0)
    omega = 2 * np.pi * np.geomspace(10, 1000, 40)
    found = true_model(rig).response(omega, 0.0)
    for k, plane in enumerate(true_model(rig).planes):
        own = slice(2 * k, 2 * k + 2)
        assert np.allclose(found[:, own, own], plane.response(omega), rtol=1e-9)
        assert not np.any(found[:, own, 2 - 2 * k : 4 - 2 * k])


def test_the_jacobian_is_exact() -> None:
    model, rng = true_model(rig_at(0.0)), np.random.default_rng(0)
    omega = 2 * np.pi * np.geomspace(10, 1000, 30)
    u = 0.1 * (rng.normal(size=(30, 4)) + 1j * rng.normal(size=(30, 4)))
    points = TurningPoints(omega, rng.choice([0.0, 150.0, 300.0], 30), u)
    first = model.predict(points)
    from service.identification.plane.prediction import Amplitude

    amplitude = Amplitude(first.coil, np.full_like(first.x, 3e-6))
    exact = model.predict(points, amplitude, gradient=True)
    assert exact.d_i is not None
    assert exact.d_y is not None
    for k, name in enumerate(model.layout.names):
        step = 1e-6 * max(abs(model.theta[k]), 1e-3)
        if name.endswith("delay_s"):
            step = 1e-12
        up, down = model.theta.copy(), model.theta.copy()
        up[k] += step
        down[k] -= step
        a, b = (model.at(t).predict(points, amplitude) for t in (up, down))
        for numeric, given in (((a.y - b.y), exact.d_y), ((a.i - b.i), exact.d_i)):
            size = np.max(np.abs(numeric)) / (2 * step)
            assert np.max(np.abs(numeric / (2 * step) - given[:, :, k])) <= 1e-4 * size + 1e-15, name


def test_modes_beyond_the_band_are_known_at_speed_too() -> None:
    """Of either plane's second mode, as if lines ended below it, whatever data would give it."""
    model = true_model(rig_at(300.0))
    theta, layout = model.theta.copy(), model.layout
    places = [layout.own[p].start + layout.planes[p].mode(1).start + 1 for p in range(2)]
    theta[places] = -20.0, 2000.0
    theta[places[1] + 1] *= 20.0
    model = model.at(theta)
    beyond = np.array([False, True])
    splits = [Split(log_ratios(model.plane(p)), beyond=beyond) for p in range(2)]
    rows, jacobian = held_rows(model, (splits[0], splits[1]))
    first, second, held = np.split(rows, [BEYOND_ROWS, 2 * BEYOND_ROWS])
    assert first[0] < -5.0
    assert second[0] > 3.0
    assert np.all(abs(first[1:]) < 2.0)
    assert abs(second[1]) > 3.0
    assert len(held) == 4  # the splits last, two of each plane
    assert np.allclose(held, 0.0)
    for place in [*places, places[1] + 1]:
        step = np.zeros_like(theta)
        step[place] = 1e-6 * max(abs(theta[place]), 1.0)
        up, down = (held_rows(model.at(theta + d), (splits[0], splits[1]))[0] for d in (step, -step))
        assert np.allclose(jacobian[:, place], (up - down) / (2 * step[place]), rtol=1e-5)


def test_a_mode_above_the_last_line_is_not_made_to_grow_by_the_fit_of_all_speeds(datasheet: Datasheet) -> None:
    below = HZ[HZ < 700.0]
    sweeps = tuple(sweep_at(w, 20 + k, below) for k, w in enumerate((0.0, 314.0)))
    turned = identify(Experiment("reference", datasheet.axes, sweeps), datasheet).rotating
    assert turned is not None
    for plane in turned.refined.model.planes:
        assert 5e-4 < plane.damping_ratios[1] < 0.05
    polar = turned.estimate("polar_inertia_kgm2", "kg m2")
    assert polar.value == pytest.approx(POLAR, abs=3 * polar.std)


def test_poles_of_the_other_planes_loop_are_no_modes(datasheet: Datasheet) -> None:
    """At one speed alone, with lines that end below the second mode: a plane by itself sees the other one's loop."""
    sweep = sweep_at(157.0, 1, HZ[HZ < 700.0])
    found = identify(Experiment("reference", datasheet.axes, (sweep,)), datasheet)
    assert len(found.planes["x"].modes) > 2
    turned = found.rotating
    assert turned is not None
    assert turned.uncertainty.adequate
    assert any("what plane x by itself has at" in w and "no mode of the rotor" in w for w in found.warnings)
    for plane in turned.refined.model.planes:
        assert plane.layout.n_modes == 2
        assert np.all((plane.damping_ratios > 5e-4) & (plane.damping_ratios < 0.05))
    polar = turned.estimate("polar_inertia_kgm2", "kg m2")
    assert polar.value == pytest.approx(POLAR, abs=3 * polar.std)


def test_polar_inertia_and_splitting_are_recovered(turned: Turned) -> None:
    """From planes that know nothing of the speed, a datasheet without polar inertia, and no mode known."""
    polar = turned.estimate("polar_inertia_kgm2", "kg m2")
    assert polar.value == pytest.approx(POLAR, abs=3 * polar.std)
    assert polar.value == pytest.approx(POLAR, rel=0.02)
    for k in range(2):
        g, rotating, _ = turned.pair_figures(k)
        assert g.value == pytest.approx(COUPLING, abs=3 * g.std)
        assert g.value == pytest.approx(COUPLING, rel=0.02)
        assert rotating.value == pytest.approx(INTERNAL, abs=3.5 * rotating.std)


def test_a_speed_with_the_wrong_sign_is_told(datasheet: Datasheet) -> None:
    """A controller reports how fast a shaft turns, not always which way: the fit is as good, and turns backward."""
    sweeps = tuple(replace(sweep_at(w, k), speed_rad_s=-w) for k, w in enumerate(SPEEDS))
    found = identify(Experiment("reference", datasheet.axes, sweeps), datasheet)
    turned = found.rotating
    assert turned is not None
    assert turned.uncertainty.adequate
    assert turned.estimate("polar_inertia_kgm2", "kg m2").value == pytest.approx(-POLAR, rel=0.02)
    assert [w for w in found.warnings if "turns the other way" in w and "forward and backward whirl are swapped" in w]


def test_a_right_sign_raises_no_such_warning(turned: Turned) -> None:
    assert not any("turns the other way" in w for w in turned.warnings)


@pytest.mark.parametrize(("polar", "speeds"), [(9.0, (0.0, 314.0, 628.0)), (13.744, (0.0, 445.0, 852.0))])
def test_a_disc_is_found_at_speeds_where_its_nutation_crosses_the_lines(
    datasheet: Datasheet, monkeypatch: pytest.MonkeyPatch, polar: float, speeds: tuple[float, ...]
) -> None:
    """A polar inertia about as large as the transverse one: its nutation passes a line every hundredth of it."""
    monkeypatch.setattr(turning, "POLAR", polar)
    sweeps = tuple(sweep_at(w, k) for k, w in enumerate(speeds))
    turned = identify(Experiment("reference", datasheet.axes, sweeps), datasheet).rotating
    assert turned is not None
    found = turned.estimate("polar_inertia_kgm2", "kg m2")
    assert turned.uncertainty.adequate
    assert found.value == pytest.approx(polar, rel=1e-3)
    assert found.value == pytest.approx(polar, abs=4 * found.std)


def test_inertia_and_stiffness_are_recovered_with_honest_intervals(turned: Turned) -> None:
    rig = rig_at(0.0)
    inertia = turned.estimate("transverse_inertia_kgm2", "kg m2")
    assert inertia.value == pytest.approx(10.87, abs=3 * inertia.std)
    assert inertia.value == pytest.approx(10.87, rel=0.002)
    for k, axis in enumerate(rig.axes):
        for kind, truth in (("ki", rig.magnets.ki[k]), ("ks", rig.magnets.ks[k])):
            found = turned.stiffness()[f"{kind}_{axis}"]
            assert found.value == pytest.approx(truth, abs=4 * found.std)
            assert found.std < 0.003 * truth


def test_deviations_allow_for_mass_and_sensors_that_are_held_within_tolerances(datasheet: Datasheet) -> None:
    told = replace(
        datasheet,
        mass_kg=0.996 * datasheet.mass_kg,
        transverse_inertia_kgm2=1.008 * datasheet.transverse_inertia_kgm2,
        sensor_gain=(0.994, 1.004, 1.009, 0.989),
        sensor_from_cog_m=(datasheet.sensor_from_cog_m[0] - 0.7e-3, datasheet.sensor_from_cog_m[1] + 1.1e-3),
    )
    sweeps = tuple(sweep_at(w, k) for k, w in enumerate(SPEEDS))
    result = identify(Experiment("reference", told.axes, sweeps), told)
    found, rig = result.rotating, rig_at(0.0)
    assert found is not None
    held = {a.name: a for a in result.adjusted}
    stiffness = found.stiffness()
    true = dict(zip(stiffness, [*rig.magnets.ki, *rig.magnets.ks], strict=True))
    for name, one in stiffness.items():
        kind, axis = name.split("_")
        assert abs(one.value - true[name]) < 3 * one.std
        assert one.std == pytest.approx(result.planes[axis[0]].stiffness[kind + axis[1]].std, rel=0.1)
    for name, value in (("transverse_inertia_kgm2", datasheet.transverse_inertia_kgm2), ("centre_of_gravity_m", 0.0)):
        one = found.estimate(name, "")
        assert abs(one.value - value) < 3 * one.std
        assert one.std == pytest.approx(held[name].std, rel=0.1)
    # it is in proportion to the other inertia, and to the mass
    polar = found.estimate("polar_inertia_kgm2", "kg m2")
    assert abs(polar.value - POLAR) < 3 * polar.std
    assert polar.std / polar.value == pytest.approx(held["transverse_inertia_kgm2"].std / 10.87, rel=0.1)
    # what mass and sensors do not change is as sharp as with these given
    given = replace(found, told=found.uncertainty)
    for k in range(2):
        for one, other in zip(found.pair_figures(k)[2], given.pair_figures(k)[2], strict=True):
            assert one.std == pytest.approx(other.std, rel=0.2)


def test_deviations_from_data_are_those_of_a_fit_that_knows_the_noise(datasheet: Datasheet, turned: Turned) -> None:
    """Few blocks tell a variance badly: taken as they are, the weights promise more than a per cent too much."""
    sweeps = tuple(sweep_at(w, 10 + k) for k, w in enumerate(SPEEDS))
    another = identify(Experiment("reference", datasheet.axes, sweeps), datasheet).rotating
    ratios = []
    for one in (turned, another):
        assert one is not None
        own, exact = (np.sqrt(np.diag(t.uncertainty.from_data)) for t in (one, told_the_noise(one)))
        ratios.append(np.mean(own / exact))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.006)


def test_the_fit_is_at_the_noise_and_agrees_with_the_planes(turned: Turned) -> None:
    assert not any("no mode of the rotor" in w for w in turned.warnings)
    assert turned.uncertainty.adequate
    assert np.all(np.abs(turned.rms - 1) < 0.1)
    assert turned.apart is not None
    assert turned.apart < 3.5
    ((name, speed, rms),) = turned.unseen
    assert "validation" in name
    assert speed == SPEEDS[2]
    assert rms < 1.4


def test_standstill_alone_gives_the_planes_fits(datasheet: Datasheet, turning_result: CommissioningResult) -> None:
    """The two-by-two fits are the special case of no speed."""
    planes = turning_result.planes  # of the sweep at standstill
    x, y = planes["x"].model, planes["y"].model
    start = joined(x, y, paired(x, y), POLAR)
    free = start.layout.free()
    free[start.layout.rigid] = False  # known, as the planes have it
    data = (speed_points(sweep_at(0.0, 0), datasheet.axes, "main"),)
    found = fit_rotating(start, data, (Split(log_ratios(x)), Split(log_ratios(y))), free)
    for k, plane in enumerate((planes["x"], planes["y"])):
        names = plane.model.layout.names
        std = np.zeros(plane.model.layout.size)
        std[[names.index(n) for n in plane.parameter_names]] = np.sqrt(np.diag(plane.covariance_from_data))
        apart = np.abs(found.model.plane(k).theta - plane.model.theta)
        # the other plane's sensors and currents tell a little more, so not to the last digit
        assert np.all(apart <= 0.7 * std)
    assert found.model.polar_inertia == POLAR  # nothing turns, nothing is said


def test_poles_of_the_loop_are_those_of_the_simulator(controller: tuple[np.ndarray, np.ndarray]) -> None:
    rig = rig_at(300.0)
    ours = np.linalg.eigvals(loop_matrix(true_model(rig), controller, 300.0)[0])
    theirs = np.linalg.eigvals(Loop(rig, 4).closed_loop())
    slow = theirs[np.abs(theirs) > 0.9]
    assert all(np.min(np.abs(ours - p)) < 2e-6 for p in slow)


def test_whirl_intervals_are_those_of_the_covariance(turned: Turned, controller: tuple[np.ndarray, np.ndarray]) -> None:
    """First order in the parameters, against draws of them."""
    u, model = turned.uncertainty, turned.model
    given = whirl(model, controller, 200.0, u.from_data, u.free, 2 * np.pi * 1000)
    rng, drawn = np.random.default_rng(0), []
    root = np.linalg.cholesky(u.from_data)
    for _ in range(60):
        theta = model.theta.copy()
        theta[u.free] += root @ rng.normal(size=len(root))
        values = np.log(np.linalg.eigvals(loop_matrix(model.at(theta), controller, 200.0)[0]) + 1e-300) / PERIOD_S
        drawn.append([values[np.argmin(np.abs(values - p))].imag for p in given.pole])
    assert np.std(drawn, axis=0) == pytest.approx(given.frequency_std, rel=0.35)


def test_the_campbell_diagram_tells_forward_from_backward(turned: Turned) -> None:
    diagram = turned.campbell
    for nu, splitting in ((3094.0, COUPLING), (5700.0, COUPLING)):
        near = [b for b in diagram.levitated if abs(np.nanmean(b.frequency) - nu) < 0.06 * nu]
        assert sorted(b.direction for b in near) == ["backward", "forward"]
        forward, backward = (next(b for b in near if b.direction == d) for d in ("forward", "backward"))
        assert np.all(np.diff(forward.frequency) > 0)
        assert np.all(np.diff(backward.frequency) < 0)
        # far from standstill, where the planes' own difference no longer counts, whirls part by g W
        parting = np.diff(forward.frequency - backward.frequency)[-1] / np.diff(diagram.speed_rad_s)[-1]
        assert parting == pytest.approx(splitting, rel=0.2)
        # damping that turns with the shaft feeds the forward whirl
        assert (
            forward.damping_ratio[-1] - forward.damping_ratio[0]
            < backward.damping_ratio[-1] - (backward.damping_ratio[0])
        )
    assert [b.direction for b in diagram.free] == ["backward", "forward"] * 2
    assert diagram.critical
    assert diagram.critical[0].speed_rad_s == pytest.approx(96.6, rel=0.01)


def test_forward_is_with_the_shaft_whichever_way_it_turns(turned: Turned, controller) -> None:
    """Seen from the other end of the shaft nothing differs."""
    one, other = (campbell(turned.model, controller, turned.uncertainty, w, 2 * np.pi * 1000) for w in (300.0, -300.0))
    assert other.speed_rad_s.tolist() == (-one.speed_rad_s).tolist()
    for name in ("levitated", "free"):
        for a, b in zip(getattr(one, name), getattr(other, name), strict=True):
            assert a.direction == b.direction
            np.testing.assert_allclose(a.frequency, b.frequency, rtol=1e-6)
            # at standstill the planes' own whirls turn no way
            np.testing.assert_allclose(a.turn[1:], b.turn[1:], atol=1e-3)
    assert {b.direction for b in one.levitated} >= {"forward", "backward"}


def test_synchronous_lines_are_taken_out(datasheet: Datasheet) -> None:
    """Runout hundreds of times the noise: seen, taken out where it leaks, and the means are where they would be."""
    hz = np.sort(np.append(HZ, 157.0 / (2 * np.pi)))
    clean, loud = (sweep_at(157.0, 1, hz, runout_m=size) for size in (0.0, 2e-6))
    before = speed_points(clean, datasheet.axes, "clean")
    after = speed_points(loud, datasheet.axes, "loud")
    raw = replace(loud, speed_rad_s=0.0)
    untouched = speed_points(raw, datasheet.axes, "raw")
    assert not any(line.seen for line in before.lines)
    first = after.lines[0]
    assert first.seen
    assert first.notched > 50
    assert after.left_out
    assert not after.lines[1].seen
    places = np.array(
        [np.flatnonzero((before.omega == w) & (before.axis == a)) for w, a in zip(after.omega, after.axis, strict=True)]
    )[:, 0]
    there = np.array(
        [
            np.flatnonzero((untouched.omega == w) & (untouched.axis == a))
            for w, a in zip(after.omega, after.axis, strict=True)
        ]
    )[:, 0]
    error, left = np.abs(after.y - before.y[places]), np.abs(untouched.y[there] - before.y[places])
    assert np.median(left) > 3e-9
    assert np.sqrt(np.mean(error**2)) < 0.15 * np.sqrt(np.mean(left**2))
    assert np.median(error) < 3e-9


def test_runout_does_not_move_the_estimates(datasheet: Datasheet) -> None:
    sweeps = tuple(sweep_at(w, k, runout_m=2e-6 if w else 0.0) for k, w in enumerate(SPEEDS))
    found = identify(Experiment("reference", datasheet.axes, sweeps), datasheet).rotating
    assert found is not None
    polar = found.estimate("polar_inertia_kgm2", "kg m2")
    assert polar.value == pytest.approx(POLAR, abs=3 * polar.std)
    assert polar.value == pytest.approx(POLAR, rel=0.02)
    assert np.all(found.rms < 1.3)


def test_the_result_has_the_section_and_the_report_the_diagram(turning_result: CommissioningResult) -> None:
    from service.report.rotating import campbell_figure, rotating_section

    section = turning_result.document()["rotating"]
    assert section["polar_inertia_kgm2"]["value"] == pytest.approx(POLAR, rel=0.02)
    assert len(section["modes"]) == 2
    assert {b["direction"] for b in section["campbell"]["levitated"]} >= {"forward", "backward"}
    assert turning_result.rotating is not None
    names = {t.get("name") for t in campbell_figure(turning_result.rotating).data}
    assert {"forward", "backward", "once a turn", "forward, 95 %"} <= names
    assert any("polar inertia" in p for p in rotating_section(turning_result.rotating).parts if isinstance(p, str))


def of_a_wrong_model(result: CommissioningResult) -> CommissioningResult:
    assert result.rotating is not None
    wrong = replace(result.rotating.uncertainty, adequate=False, scale=7.31)
    return replace(result, rotating=replace(result.rotating, uncertainty=wrong))


def test_a_search_that_converged_on_a_wrong_model_is_not_said_to_have_converged(
    turning_result: CommissioningResult,
) -> None:
    wrong = of_a_wrong_model(turning_result)
    assert turning_result.document()["rotating"]["status"].startswith("converged")
    told = wrong.document()["rotating"]
    assert told["model_adequate"] is False
    assert told["status"].startswith("model not adequate: residuals are larger than the noise")
    assert "search for its parameters: converged" in told["status"]


def test_whoever_reads_the_report_of_a_wrong_model_of_the_turning_rotor_is_told(
    turning_result: CommissioningResult,
) -> None:
    from service.report.commissioning import verdict
    from service.report.rotating import rotating_section

    wrong = of_a_wrong_model(turning_result)
    assert wrong.rotating is not None
    assert turning_result.rotating is not None
    words = "over all speeds the residuals are 7.3 times the noise"
    assert words in str(rotating_section(wrong.rotating).parts[0])
    assert "times the noise, so" not in str(rotating_section(turning_result.rotating).parts)
    (tone, sentence), (_, right) = verdict(wrong), verdict(turning_result)
    assert sentence.startswith(right)
    assert words in sentence
    assert tone != "good"


def test_planes_without_gyroscopic_coupling_are_not_the_last_word_on_a_turning_rotor(
    turning_result: CommissioningResult,
) -> None:
    """Measured at speed alone, the planes' models lack something that the turning rotor's has."""
    from service.report.commissioning import verdict

    planes = {k: replace(p, adequate=False, residual_rms_total=4.3) for k, p in turning_result.planes.items()}
    told = "The model of the turning rotor has what the planes lack"
    assert told in verdict(replace(turning_result, planes=planes, speed_rad_s=314.0))[1]
    assert told not in verdict(replace(turning_result, planes=planes))[1]
    assert told not in verdict(turning_result)[1]


def test_one_speed_has_no_such_section(result: CommissioningResult) -> None:
    assert "rotating" not in result.document()


def test_a_rotor_that_rests_is_not_identified_as_a_turning_one(experiment, datasheet, result) -> None:
    """A controller that measures the speed tells a little of a rotor at rest, too, and nothing turns all the same."""
    sweeps = tuple(replace(s, speed_rad_s=0.02) for s in experiment.sweeps)
    found = identify(replace(experiment, sweeps=sweeps), datasheet)
    assert found.rotating is None
    assert found.cross_planes == result.cross_planes != ()
    assert found.warnings == result.warnings
    for plane, of_zero in result.planes.items():
        np.testing.assert_array_equal(found.planes[plane].model.theta, of_zero.model.theta)


def test_speeds_without_standstill_and_one_speed_alone_do_as_well(datasheet: Datasheet) -> None:
    """The search starts from planes whose models lack the coupling."""
    for speeds in ((157.0, -314.0), (314.0,)):
        sweeps = tuple(sweep_at(w, k) for k, w in enumerate(speeds))
        found = identify(Experiment("reference", datasheet.axes, sweeps), datasheet)
        assert any("gyroscopic coupling is not in their models" in w for w in found.warnings)
        assert found.rotating is not None
        assert found.rotating.uncertainty.adequate
        assert [p.layout.n_modes for p in found.rotating.refined.model.planes] == [2, 2]
        polar = found.rotating.estimate("polar_inertia_kgm2", "kg m2")
        assert polar.value == pytest.approx(POLAR, abs=3.5 * polar.std)
        assert polar.value == pytest.approx(POLAR, rel=0.02)
        assert found.rotating.apart is None


def test_a_speed_measured_plane_by_plane_is_one_sweep_of_the_rotating_model(datasheet: Datasheet) -> None:
    """The same points in a sweep a plane: the rotor is that of the file that has them in one."""
    hz = HZ[::2]
    still, fast = sweep_at(0.0, 0, hz), sweep_at(314.0, 2, hz)
    parts = [still.select(np.isin(still.axis, plane)) for plane in ((0, 1), (2, 3))]
    found = identify(Experiment("reference", datasheet.axes, (*parts, fast)), datasheet).rotating
    assert found is not None
    assert [(p.name, p.speed_rad_s, len(p.omega)) for p in found.data] == [
        ("sweeps/0 (main), sweeps/1 (main)", 0.0, still.n_points),
        ("sweeps/2 (main)", 314.0, fast.n_points),
    ]
    assert found.unseen == ()
    polar = found.estimate("polar_inertia_kgm2", "kg m2")
    assert polar.value == pytest.approx(POLAR, abs=3.5 * polar.std)


ANY_ZONE = (("any", 40.0), ("bad", np.inf))


def judged(document: dict, datasheet: Datasheet, zones=ANY_ZONE, accepted: str = "any") -> ControllerCheck:
    law = np.array(datasheet.numerator), np.array(datasheet.denominator)
    planes, rotor = saved_planes(document, datasheet), saved_rotor(document, datasheet)
    return check_controller("reference", planes, law, zones=zones, accepted_zone=accepted, rotor=rotor)


def test_the_turning_rotor_of_a_result_is_read_back(turning_result: CommissioningResult, datasheet: Datasheet) -> None:
    assert turning_result.rotating is not None
    document = json.loads(json.dumps(turning_result.document()))
    found = saved_rotor(document, datasheet)
    assert found is not None
    np.testing.assert_array_equal(found.model.theta, turning_result.rotating.model.theta)
    assert found.model.layout == turning_result.rotating.model.layout
    assert found.speeds_rad_s[-1] == pytest.approx(1.25 * SPEEDS[-1])
    del document["rotating"]["parameters"]["pairs"]  # as an older version wrote it
    older = saved_rotor(document, datasheet)
    assert older is not None
    assert older.model.layout == found.model.layout


def test_a_controller_is_judged_at_speed(turning_result: CommissioningResult, datasheet: Datasheet) -> None:
    """Damping that turns with the shaft takes the forward whirl's: the planes at standstill know nothing of it."""
    document = json.loads(json.dumps(turning_result.document()))
    assert judged(document, datasheet).safe
    document["rotating"]["parameters"]["values"]["pair_1_rotating_damping_rad_s"] = 60.0
    found = judged(document, datasheet)
    assert not found.safe
    (reason,) = found.reasons
    assert "at 353.2 rad/s" in reason
    assert "a motion of 501.1 Hz" in reason


def test_models_that_the_data_allow_scatter_as_their_deviations_say(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    """Of a stiffness of a million newtons per metre, whose rounding hides a delay of nanoseconds, and of that delay."""
    rotor = saved_rotor(json.loads(json.dumps(turning_result.document())), datasheet)
    assert rotor is not None
    found = np.array([m.theta[rotor.free] for m in drawn(rotor.model, rotor.free, rotor.covariance, 300, 0)])
    late = [n.endswith("delay_s") for n in np.array(rotor.model.layout.names)[rotor.free]]
    ratio = found.std(axis=0) / np.sqrt(np.diag(rotor.covariance))
    assert ratio[late] == pytest.approx(1.0, abs=0.2)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


def test_margins_at_speed_are_the_worst_of_the_twins(turning_result: CommissioningResult, datasheet: Datasheet) -> None:
    """The sensitivity of the true rig at each speed, by another program's model of it."""
    found = judged(json.loads(json.dumps(turning_result.document())), datasheet).at_speed
    assert found is not None
    assert found.stable_share == 1.0
    assert [a.axis for a in found.axes] == list(datasheet.axes)
    hz = np.unique(np.concatenate([np.geomspace(1, 1000, 200), np.linspace(480, 520, 801)]))
    size = {w: np.abs(linear_model(rig_at(w), hz).u_per_r) for w in found.speeds_rad_s}
    for k, axis in enumerate(found.axes):
        truth = {w: s[:, k, k].max() for w, s in size.items()}
        worst = max(truth, key=truth.__getitem__)
        peak = axis.sensitivity_peak
        assert peak.speed_rad_s == worst
        assert peak.figure.value == pytest.approx(truth[worst], rel=0.01)
        assert peak.figure.low <= peak.figure.value <= peak.figure.high
        assert peak.figure.high - peak.figure.low < 0.02 * peak.figure.value
        assert 10 < axis.phase_margin_deg.figure.low < 18


def test_a_zone_that_only_the_turning_rotor_has_is_a_reason(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    document = json.loads(json.dumps(turning_result.document()))
    document["rotating"]["parameters"]["values"]["pair_1_rotating_damping_rad_s"] = 30.0
    still = max(judged(document, datasheet).axes, key=lambda a: a.sensitivity_peak.high or 0.0).sensitivity_peak.high
    assert still is not None
    limit = 20 * np.log10(1.02 * still)
    found = judged(document, datasheet, (("ok", limit), ("bad", np.inf)), "ok")
    assert not found.safe
    assert all("at 392.5 rad/s: sensitivity peak" in reason for reason in found.reasons)


def test_other_models_that_the_data_allow_are_judged_at_speed_too(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    """The best model holds at every speed, and others that fit as well do not."""
    document = json.loads(json.dumps(turning_result.document()))
    kept = document["rotating"]["parameters"]
    kept["values"]["pair_1_rotating_damping_rad_s"] = 40.0
    place = kept["free"].index("pair_1_rotating_damping_rad_s")
    for row in kept["covariance"]:
        row[place] = 0.0
    kept["covariance"][place] = [0.0] * len(kept["free"])
    kept["covariance"][place][place] = 20.0**2
    found = judged(document, datasheet)
    assert found.stable
    assert 0 < found.stable_share < 1
    assert not found.safe
    (reason,) = found.reasons
    assert "models that the data allow as well are unstable" in reason
    assert "at speed, from" in reason


def test_a_turning_model_that_lacks_something_is_told(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    document = json.loads(json.dumps(turning_result.document()))
    document["rotating"]["model_adequate"] = False
    document["rotating"]["sweeps"][1]["rms_over_sigma"] = 7.0
    found = judged(document, datasheet)
    assert found.verdict == "not known"
    (why,) = found.not_known
    assert "turning rotor leaves residuals 7 times the noise" in why


def test_a_turning_rotor_that_is_described_is_judged_where_its_planes_alone_are_not(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    """Planes that were measured at speed lack what couples them: the rotor's own model tells, at standstill, too."""
    document = json.loads(json.dumps(turning_result.document()))
    assert 0.0 not in judged(document, datasheet).at_speed.speeds_rad_s
    for plane in document["planes"].values():
        plane["residuals"]["model_adequate"] = False
    found = judged(document, datasheet)
    assert found.safe
    assert found.at_speed is not None
    assert 0.0 in found.at_speed.speeds_rad_s


def test_margins_at_speed_are_not_known_of_a_loop_beyond_what_was_measured(
    turning_result: CommissioningResult, datasheet: Datasheet
) -> None:
    document = json.loads(json.dumps(turning_result.document()))
    for plane in document["planes"].values():
        plane["measured_hz"][1] = 400.0  # below the first flexible mode
    found = judged(document, datasheet)
    assert found.verdict == "not known"
    assert any(why.startswith("at speed: a sensitivity peak") and "(400 Hz)" in why for why in found.not_known)
    assert found.at_speed is not None
    assert {a.zone for a in found.at_speed.axes} == {"not known"}


def test_a_turning_rotor_that_cannot_be_read_is_told(turning_result: CommissioningResult, datasheet: Datasheet) -> None:
    document = json.loads(json.dumps(turning_result.document()))
    del document["rotating"]["parameters"]["values"]["polar_inertia_kgm2"]
    assert saved_rotor(document, datasheet) is None
    assert any("stands still" in w for w in judged(document, datasheet).warnings)
