"""Margins of loops: those of python-control, and where a small change moves them."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from service.identification.loop.closed_loop import (
    block_diagonal,
    closed_loop_poles,
    controller_states,
    sampled,
)
from service.identification.loop.loop_margins import REST, loop_margins, moved
from service.identification.loop.margins import axis_margins, heights, sensitivity, sensitivity_peaks, zone
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from service.identification.statistics.derivatives import central_differences
from sim.reference import pid_with_biquad
from tests.support.planes import plane_model_of
from tests.support.whole_rigs import levitating

OMEGA = np.geomspace(REST, 1e2, 5000)
LOOPS = {
    "three lags": control.tf([2.0], [1.0, 3.0, 2.0, 0.0]),
    "an unstable plant under PID": control.tf([6.0, 9.0, 3.0], [1.0, 0.0, -1.0, 0.0]) * control.tf([1.0], [0.05, 1.0]),
    "a lead": control.tf([2.0, 0.0], [1.0, 1.0]),
    "an unstable plant under PD": control.tf([9.0, 3.0], [1.0, 0.0, -1.0]) * control.tf([1.0], [0.05, 1.0]),
}


@pytest.mark.parametrize("name", LOOPS)
def test_margins_are_those_of_python_control(name: str) -> None:
    system = LOOPS[name]
    found = loop_margins(OMEGA, np.asarray(control.frequency_response(system, OMEGA).complex).ravel())
    gains, phases, _, at_gain, at_phase, _ = control.stability_margins(system, returnall=True)
    at_gain = at_gain[np.isfinite(gains)]
    decibel = 20 * np.log10(gains[np.isfinite(gains)])
    for crossing, theirs in ((found.gain_up_db, decibel[decibel > 0]), (found.gain_down_db, decibel[decibel < 0])):
        assert (crossing is None) == (len(theirs) == 0)
        if crossing is not None:
            k = int(np.argmin(np.abs(theirs)))
            assert crossing.value == pytest.approx(theirs[k], abs=1e-2)
            where = at_gain[np.argmin(np.abs(decibel - theirs[k]))]
            assert crossing.omega == pytest.approx(where, rel=1e-3, abs=REST)
    assert found.phase_deg is not None
    assert found.phase_deg.value == pytest.approx(np.min(np.abs(phases)), abs=1e-2)
    assert found.delay_s is not None
    late = np.deg2rad(phases % 360) / at_phase
    assert found.delay_s.value == pytest.approx(late.min(), rel=1e-3)


def test_a_little_more_gain_moves_margins_by_as_much() -> None:
    system = LOOPS["three lags"]

    def at(omega: np.ndarray) -> np.ndarray:
        return np.array([complex(system(1j * w)) for w in omega.ravel()]).reshape(omega.shape)

    before = loop_margins(OMEGA, at(OMEGA))
    places = before.places()
    known = np.isfinite(places)
    loop = np.full(places.shape, np.nan, dtype=complex)
    loop[known] = 1.01 * at(places[known])
    after = loop_margins(OMEGA, 1.01 * at(OMEGA))
    for value, crossing in zip(moved(places, loop), after.crossings(), strict=True):
        assert np.isnan(value) if crossing is None else value == pytest.approx(crossing.value, rel=2e-3)


def test_a_gain_margin_at_a_sharp_mode_is_that_of_eigenvalues() -> None:
    """A rotor of four sharp modes whose loop turns by a quarter between two lines about one of them."""
    ((_, rig, sheet, _),) = levitating([21])
    model, law = plane_model_of(rig, "x"), (np.array(sheet.numerator), np.array(sheet.denominator))
    free = model.layout.free()
    found = axis_margins(model, law, np.zeros((free.sum(), free.sum())), free, None)
    for j, axis in enumerate(found):
        for margin in (axis.gain_down_db.value, axis.gain_up_db.value):
            assert margin is not None
            within, beyond = (fastest_growth(model, law, j, margin * share) for share in (0.99, 1.01))
            assert within < 0 < beyond


def fastest_growth(model: PlaneModel, law: tuple[np.ndarray, np.ndarray], j: int, gain_db: float) -> float:
    """Of the sampled loop with more gain in one axis, 1/s."""
    gains = [1.0, 1.0]
    gains[j] = 10 ** (gain_db / 20)
    plant = sampled(model)
    louder = replace(plant, B=plant.B @ np.diag(gains))
    ca, cb, cc, cd = (block_diagonal([x, x]) for x in controller_states(law))
    top = np.hstack([louder.A - louder.B @ cd @ louder.C, louder.B @ cc])
    poles = np.linalg.eigvals(np.vstack([top, np.hstack([-cb @ louder.C, ca])]))
    return float(np.log(np.abs(poles).max()) / model.known.sample_time_s)


def test_margins_of_a_plane_have_deviations_and_their_measured_counterparts(result: CommissioningResult) -> None:
    for plane in result.planes.values():
        told = plane.document()["margins"]
        for axis in "AB":
            value, std = told["phase_margin_deg"][axis], told["phase_margin_deg_std"][axis]
            assert 0 < std < 0.05 * value
            # lines are a few percent apart: straight in between is a degree off, and a sharp mode may be stepped over
            assert told["measured_phase_margin_deg"][axis] > value - 1.5
            assert told["delay_margin_s_std"][axis] > 0
            assert all(s is None or s > 0 for s in told["gain_margin_db_std"][axis])


def test_margins_that_a_loop_does_not_have_are_none(truth: dict[str, PlaneModel]) -> None:
    """Of so weak a law the loop never reaches one: no phase, no delay, and nothing is computed of them."""
    model = truth["x"]
    free = model.layout.free()
    numerator, denominator = pid_with_biquad(integral_a_per_ms=0.0)
    weak = (1e-3 * numerator, denominator)
    for axis in axis_margins(model, weak, np.diag((1e-4 * model.theta[free]) ** 2), free, None):
        assert (axis.phase_deg.value, axis.phase_deg.std) == (None, None)
        assert (axis.delay_s.value, axis.delay_s.std) == (None, None)
        assert axis.peak_std > 0


STRONG = [
    pytest.param((), id="the reference"),
    pytest.param((34553.0, 69106.0, 89.7, 4435.0, 781.0, (0.59, 0.71)), id="from 907 to 951 Hz"),
    pytest.param((20e3, 40e3, 154.0, 3900.0, 700.0, (0.57, 0.74)), id="from 907 to 982 Hz"),
    pytest.param((18.7e3, 37.4e3, 133.0, 2400.0, 890.0, (0.16, 0.74)), id="from 493 to 507 Hz"),
    pytest.param((22.3e3, 44.6e3, 78.0, 2000.0, 580.0, (0.54, 0.93)), id="from 907 to 936 Hz"),
    pytest.param((45.2e3, 90.4e3, 130.0, 3600.0, 720.0, (0.26, 0.88)), id="from 493 to 503 Hz"),
]


@pytest.mark.parametrize("law", STRONG)
def test_margins_are_those_of_very_many_lines_wherever_a_law_moves_the_modes(law, truth: dict[str, PlaneModel]) -> None:
    """A strong law moves a sharp mode of its loop far from where the plant has it, and |S| peaks there."""
    model, controller = truth["x"], pid_with_biquad(*law)
    free = model.layout.free()
    omega = np.unique(np.concatenate([np.geomspace(REST, 3e4, 20000), np.geomspace(2e3, 8e3, 60000)]))
    s = sensitivity(model, controller, omega)
    for j, axis in enumerate(axis_margins(model, controller, np.zeros((free.sum(), free.sum())), free, None)):
        peak = np.abs(s[:, j, j]).max()
        assert axis.sensitivity_peak == pytest.approx(peak, rel=0.01)
        assert zone(axis.sensitivity_peak) == zone(peak)
        told = [m.value for m in (axis.gain_down_db, axis.gain_up_db, axis.phase_deg, axis.delay_s)]
        down, up, phase, delay = loop_margins(omega, 1 / s[:, j, j] - 1).values()
        assert told[:2] == pytest.approx([down, up], abs=0.2)
        assert told[2:] == pytest.approx([phase, delay], rel=0.03)


@pytest.mark.parametrize("law", [(), *STRONG])
def test_derivatives_of_a_peak_are_those_of_its_height_where_it_is(law, truth: dict[str, PlaneModel]) -> None:
    """Though it moves with the parameters, and fast where a mode is sharp."""
    model, controller = truth["x"], pid_with_biquad(*law)
    peaks = sensitivity_peaks(model, controller)

    def found_anew(theta: np.ndarray) -> np.ndarray:
        return np.array([p.value for p in sensitivity_peaks(model.at(theta), controller)])

    def where_they_are(theta: np.ndarray) -> np.ndarray:
        return heights(model.at(theta), controller, peaks)

    free = model.layout.free()
    steps = 1e-6 * np.abs(model.theta[free]) + 1e-12
    slow, quick = (central_differences(of, model.theta, free, steps) * steps for of in (found_anew, where_they_are))
    np.testing.assert_allclose(quick, slow, atol=1e-3 * np.abs(slow).max())


def quick(slow: PlaneModel) -> PlaneModel:
    """A plane whose axes would swing above 3 kHz: amplifiers of 12 kHz, sampled every 10 us."""
    theta = slow.theta.copy()
    for place in slow.layout.amplifiers:
        theta[place] = [1.0, 2 * np.pi * 12e3, 0.8]
    return replace(slow.at(theta), known=replace(slow.known, sample_time_s=1e-5))


@pytest.mark.parametrize(
    ("rig", "law"),
    [
        pytest.param(lambda m: m, {"integral_a_per_ms": 0.0}, id="down at rest, without an integrator"),
        pytest.param(lambda m: m, {"integral_a_per_ms": 1e3}, id="down below 1 Hz, with a slow one"),
        pytest.param(quick, {"sample_time_s": 1e-5, "filter_hz": 3e4}, id="up above 3 kHz"),
    ],
)
def test_gain_by_a_margin_puts_a_pole_of_the_loop_on_the_circle(rig, law, truth: dict[str, PlaneModel]) -> None:
    model, controller = rig(truth["x"]), pid_with_biquad(**law)
    free = model.layout.free()
    axes = axis_margins(model, controller, np.diag((1e-4 * model.theta[free]) ** 2), free, None)
    for place, axis in zip(model.layout.amplifiers, axes, strict=True):
        for margin in (axis.gain_down_db, axis.gain_up_db):
            assert margin.value is not None
            assert margin.std is not None
            assert margin.std > 0
            growth = []
            for beyond in (-0.1, 0.1):
                theta = model.theta.copy()
                theta[place.start] *= 10 ** ((margin.value + np.sign(margin.value) * beyond) / 20)
                poles = np.abs(closed_loop_poles(model.at(theta), controller)) - 1.0
                growth.append(np.max(poles[np.abs(poles) > 1e-7]))  # apart from an integrator that nothing drives
            assert growth[0] < 0 < growth[1]
