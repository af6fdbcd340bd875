"""A limit of voltage or output, or a stop, that is reached in one line alone is found, wherever that line is."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import Observation, observe
from service.gap.measured.sweeps import halves
from service.gap.weighing.ranking import ranked
from service.gap.weighing.significance import alone_hz, fastest_alone_hz, furthest_alone_hz, shows_alone_hz
from service.gap.where.dependence import dependence
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from service.gap.which.search import plain_twin
from sim.datasheet import Datasheet
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


MAIN_HZ = np.geomspace(12.0, 800.0, 12)
OTHER_HZ = np.geomspace(15.0, 930.0, 12)
HIGHEST = float(OTHER_HZ[-1])


@pytest.fixture(scope="module")
def limited() -> tuple[Experiment, Datasheet]:
    """Two axes whose amplifiers reach their limit in the highest line of the other, larger sweep alone."""
    datasheet, truth = known_datasheet(seed=3)
    plain = true_rig(truth)
    limit = {"amplifier_voltage_limit": {"slew_inverse_s_per_a": 1 / (0.9 * largest_rate(plain, HIGHEST))}}
    rig = with_effects(plain, limit)
    sweeps = (
        replace(sweep(rig, MAIN_HZ, 0.1, 1), comment="main"),
        replace(sweep(rig, OTHER_HZ, 0.2, 2, during=(0.8, 1.0)), comment="other amplitude"),
    )
    return one_plane(Experiment(rig.name, rig.axes, sweeps), datasheet)


def largest_rate(rig: Rig, hz: float) -> float:
    """Slope of the coil current that a tone of the other sweep asks for, A/s."""
    s = sweep(rig, np.array([hz]), 0.2, 2)
    return float(2 * np.pi * hz * np.abs(s.I[:, 0, s.harmonics.index(1)]).max())


def test_a_limit_that_only_the_other_sweep_reaches_and_in_one_line_is_named_and_measured(
    limited: tuple[Experiment, Datasheet],
) -> None:
    measured, datasheet = limited
    d = diagnose(measured, datasheet)
    assert d.verdict.effects == ("amplifier_voltage_limit",)
    found = gap_document(d)["candidates"][0]["parameters"]["slew_inverse_s_per_a"]
    true = 1 / (0.9 * largest_rate(true_rig(known_datasheet(seed=3)[1]), HIGHEST))
    assert found["value"] == pytest.approx(true, rel=0.02)
    assert any("not the other" in note for note in d.notes)


def test_an_output_that_ends_in_one_line_alone_is_no_effect_and_told_with_the_line() -> None:
    """Where the controller clips, what it puts out is less than its law makes of r and y; the rotor goes on."""
    datasheet, truth = known_datasheet(seed=3)
    s = sweep(true_rig(truth), MAIN_HZ, 0.1, 1)
    R = s.R.copy()
    R[s.frequency_hz == MAIN_HZ[6]] *= 1.2
    measured = Experiment("reference", datasheet.axes, (replace(s, R=R),))
    d = diagnose(*one_plane(measured, datasheet))
    assert d.verdict.kind == "none_of_these"
    assert f"{MAIN_HZ[6]:.3g} Hz" in d.verdict.reasons[0]
    assert d.verdict.reasons[0].startswith("controller: ")


def test_without_the_current_the_gap_of_that_line_alone_depends_on_amplitude(
    limited: tuple[Experiment, Datasheet],
) -> None:
    measured, datasheet = limited
    nu = nuisance(datasheet)
    main, other = (observe(replace(s, I=None), nu.rig) for s in measured.sweeps)
    ground = Ground(nu, parts(nu, (main,))[-1], (main,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        null, plain = plain_twin(fitter, ground)
    e = Explained(ground, tuple(ranked(null, [])), plain, plain)
    assert alone_hz(e.part, on_sweep(e, null, other)[1], other) == HIGHEST
    assert dependence(e, other, distorted=False).amplitude is True


def halved(other: Observation, fitted_hz: float | None = None) -> tuple[Observation, Observation]:
    both = halves(other, "sweeps/1", fitted_hz)
    assert both is not None
    return both[:2]


def test_the_line_that_alone_shows_a_gap_is_among_those_that_are_fitted_too(
    limited: tuple[Experiment, Datasheet],
) -> None:
    other = observe(limited[0].sweeps[1], nuisance(limited[1]).rig)
    for hz in OTHER_HZ[-2:]:
        seen, unseen = halved(other, float(hz))
        assert hz in seen.frequency_hz
        assert hz not in unseen.frequency_hz


def test_a_half_has_the_points_of_its_lines_and_the_noise_that_all_lines_told_of(
    limited: tuple[Experiment, Datasheet],
) -> None:
    other = observe(limited[0].sweeps[1], nuisance(limited[1]).rig)
    for half in halved(other):
        at = np.isin(other.points_hz, half.frequency_hz)
        assert 0.3 < at.mean() < 0.7
        np.testing.assert_array_equal(half.points_hz, other.points_hz[at])
        np.testing.assert_array_equal(half.axis, other.axis[at])
        for name in ("R", "U", "I", "Y", "sd_u", "sd_i", "sd_y", "progress"):
            np.testing.assert_array_equal(getattr(half, name), getattr(other, name)[at], err_msg=name)


@pytest.fixture
def quiet(limited: tuple[Experiment, Datasheet]) -> tuple[Observation, np.ndarray]:
    """The other sweep and residuals that are noise alone."""
    o = observe(limited[0].sweeps[1], nuisance(limited[1]).rig)
    parts = np.random.default_rng(1).standard_normal((2, *o.Y.shape))
    return o, parts[0] + 1j * parts[1]


def test_noise_and_one_wild_value_are_no_line_alone(quiet: tuple[Observation, np.ndarray]) -> None:
    o, z = quiet
    assert shows_alone_hz(z, o) is None
    z[3, o.fundamental, 0] = 100.0
    assert shows_alone_hz(z, o) is None
    z[0, o.fundamental, 0] = 100.0  # nor two in two lines
    assert shows_alone_hz(z, o) is None


def test_a_fundamental_and_an_odd_harmonic_off_in_one_line_show_there(quiet: tuple[Observation, np.ndarray]) -> None:
    o, z = quiet
    point = int(np.flatnonzero(o.line == 5)[0])
    z[point, [o.fundamental, o.harmonics.index(3)], 1] = 9.0
    assert shows_alone_hz(z, o) == o.frequency_hz[5]


def test_of_a_plant_only_the_line_with_the_steepest_current_shows_a_limit(
    quiet: tuple[Observation, np.ndarray],
) -> None:
    """A mode's peak looks the same in any other."""
    o, z = quiet
    steepest = int(np.argmax(np.abs(o.U[:, o.fundamental]).max(axis=1) * o.points_hz))
    other = int(np.flatnonzero(o.line == 2)[0])
    z[other, o.fundamental, :] = 100.0
    assert shows_alone_hz(z, o) == o.frequency_hz[2]
    assert fastest_alone_hz(z, o) is None
    z[steepest, o.fundamental, :] = 50.0
    assert fastest_alone_hz(z, o) == o.points_hz[steepest]


def furthest(o: Observation) -> int:
    """A point of the line in which an axis swings furthest."""
    return int(np.abs(o.Y[:, o.fundamental]).max(axis=1).argmax())


def test_of_a_plant_the_line_in_which_the_rotor_swings_furthest_shows_a_stop(
    quiet: tuple[Observation, np.ndarray], limited: tuple[Experiment, Datasheet]
) -> None:
    o, z = quiet
    plant = next(p for p in parts(nuisance(limited[1]), (o,)) if p.path == "plant")
    assert furthest_alone_hz(z, o) is None
    far, f = furthest(o), o.fundamental
    swing = np.abs(o.Y[far, f]).max()
    near = next(k for k in range(len(o.line)) if np.abs(o.Y[o.line == o.line[k], f]).max() < 0.5 * swing)
    z[near, f] = 1000.0
    assert furthest_alone_hz(z, o) is None, "a mode's peak looks the same in any other line"
    z[far, f] = 0.03 * swing * np.sqrt(2) / o.sd_y[far, f]
    assert furthest_alone_hz(z, o) == o.points_hz[far]
    assert alone_hz(plant, z, o) == o.points_hz[far]


def test_what_another_program_s_peak_may_be_off_by_is_no_stop_however_little_noise(
    quiet: tuple[Observation, np.ndarray],
) -> None:
    o, z = quiet
    o = replace(o, sd_y=o.sd_y / 1000)
    far, f = furthest(o), o.fundamental
    z[far, f] = 0.005 * np.abs(o.Y[far, f]).max() * np.sqrt(2) / o.sd_y[far, f]
    assert np.abs(z[far, f]).min() > 100
    assert furthest_alone_hz(z, o) is None


@pytest.fixture(scope="module")
def stopped() -> tuple[Experiment, Datasheet]:
    """Two axes with a stop that the rotor reaches in the lowest line of the other, larger sweep alone."""
    datasheet, truth = known_datasheet(seed=3)
    plain = true_rig(truth)
    hz = np.array([13.0, 25.0, *np.geomspace(60.0, 900.0, 46)])  # so many that one drowns in a band
    free = sweep(plain, hz, 0.3, 2)
    swing = np.abs(free.Y[:, 0, free.harmonics.index(1), :2]).max(axis=1).reshape(len(hz), -1)[:, :2].max(axis=1)
    clearance = 0.85 * float(swing[0])
    assert clearance > 1.05 * swing[1:].max()
    axes = {f"clearance_{axis}_m": clearance for axis in plain.axes}
    rig = with_effects(plain, {"touchdown_contact": {"stiffness_n_per_m": 6e5, **axes}})
    sweeps = (
        replace(sweep(rig, np.geomspace(10.0, 1000.0, 30), 0.1, 1), comment="main"),
        replace(sweep(rig, hz, 0.3, 2, during=(0.8, 1.0)), comment="other amplitude"),
    )
    return one_plane(Experiment(rig.name, rig.axes, sweeps), datasheet)


def test_a_stop_that_one_line_of_the_louder_sweep_reaches_is_named(stopped: tuple[Experiment, Datasheet]) -> None:
    d = diagnose(*stopped)
    assert d.verdict.effects == ("touchdown_contact",)
    report = gap_document(d)
    found = report["candidates"][0]["parameters"]["stiffness_n_per_m"]
    assert abs(found["value"] - 6e5) < 3 * found["std"]
    assert report["where"]["amplitude_dependent"] is True


def test_a_gap_of_the_furthest_line_that_no_effect_explains_is_no_clean_rig(
    stopped: tuple[Experiment, Datasheet],
) -> None:
    """An answer to one axis' excitation that is late there by what is nothing in any other line."""
    measured, datasheet = stopped
    main, other = measured.sweeps
    plain = true_rig(known_datasheet(seed=3)[1])
    far = float(other.frequency_hz[np.abs(other.Y[:, 0, 1]).max(axis=1).argmax()])
    hz = np.unique(other.frequency_hz)
    free = one_plane(Experiment(plain.name, plain.axes, (sweep(plain, hz, 0.3, 2),)), datasheet)[0].sweeps[0]
    assert free.I is not None
    U, I, Y, f = free.U.copy(), free.I.copy(), free.Y.copy(), free.harmonics.index(1)
    there, model = (free.frequency_hz == far) & (free.axis == 0), linear_model(plain, np.array([far]))
    added = (np.exp(0.06j) - 1) * Y[there, :, f]
    through = model.i_per_u[0, :2, :2]
    Y[there, :, f] += added
    U[there, :, f] -= model.controller[0] * added
    I[there, :, f] -= model.controller[0] * added @ through.T
    late = replace(free, U=U, I=I, Y=Y, comment=other.comment)
    verdict = diagnose(replace(measured, sweeps=(main, late)), datasheet).verdict
    assert verdict.kind == "none_of_these"
    assert verdict.unexplained == "plant"


def test_a_current_that_one_line_of_many_shows_to_be_cut_off_is_no_clean_rig(
    stopped: tuple[Experiment, Datasheet],
) -> None:
    """As an amplifier that takes no larger command does: less current, and no later."""
    measured, datasheet = stopped
    plain = true_rig(known_datasheet(seed=3)[1])
    less = replace(plain, amplifiers=replace(plain.amplifiers, gain=0.97 * plain.amplifiers.gain))
    hz = np.unique(measured.sweeps[1].frequency_hz)
    free, cut = (
        one_plane(Experiment(plain.name, plain.axes, (sweep(rig, hz, 0.3, 2),)), datasheet)[0].sweeps[0]
        for rig in (plain, less)
    )
    assert free.I is not None
    assert cut.I is not None
    there = (free.frequency_hz == hz[30])[:, None, None, None]
    signals = {"U": (cut.U, free.U), "I": (cut.I, free.I), "Y": (cut.Y, free.Y)}
    one = replace(free, comment="other amplitude", **{k: np.where(there, a, b) for k, (a, b) in signals.items()})
    main = sweep(plain, np.geomspace(10.0, 1000.0, 30), 0.1, 1)
    main = one_plane(Experiment(plain.name, plain.axes, (main,)), datasheet)[0].sweeps[0]
    verdict = diagnose(replace(measured, sweeps=(main, one)), datasheet).verdict
    assert verdict.kind == "none_of_these"
    assert f"{hz[30]:.3g} Hz" in verdict.reasons[0]
