"""Margins of loops: those of python-control, and where a small change moves them."""

from __future__ import annotations

import control
import numpy as np
import pytest

from service.identification.loop_margins import loop_margins, moved
from service.identification.margins import axis_margins
from service.identification.plane_model import PlaneModel
from service.identification.result import CommissioningResult

OMEGA = np.geomspace(1e-2, 1e2, 4000)
LOOPS = {
    "three lags": control.tf([2.0], [1.0, 3.0, 2.0, 0.0]),
    "an unstable plant under PID": control.tf([6.0, 9.0, 3.0], [1.0, 0.0, -1.0, 0.0]) * control.tf([1.0], [0.05, 1.0]),
}


@pytest.mark.parametrize("name", LOOPS)
def test_margins_are_those_of_python_control(name: str) -> None:
    system = LOOPS[name]
    found = loop_margins(OMEGA, np.asarray(control.frequency_response(system, OMEGA).complex).ravel())
    gains, phases, _, at_gain, at_phase, _ = control.stability_margins(system, returnall=True)
    decibel = 20 * np.log10(gains)
    for crossing, theirs in ((found.gain_up_db, decibel[decibel > 0]), (found.gain_down_db, decibel[decibel < 0])):
        assert (crossing is None) == (len(theirs) == 0)
        if crossing is not None:
            k = int(np.argmin(np.abs(theirs)))
            assert crossing.value == pytest.approx(theirs[k], abs=1e-2)
            assert crossing.omega == pytest.approx(at_gain[np.argmin(np.abs(decibel - theirs[k]))], rel=1e-3)
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


def test_margins_that_a_loop_does_not_have_are_none(
    truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    """Of so weak a law the loop never reaches one: no phase, no delay, and nothing is computed of them."""
    model = truth["x"]
    free = model.layout.free()
    weak = (1e-3 * controller[0], controller[1])
    for axis in axis_margins(model, weak, np.diag((1e-4 * model.theta[free]) ** 2), free, None):
        assert (axis.phase_deg.value, axis.phase_deg.std) == (None, None)
        assert (axis.delay_s.value, axis.delay_s.std) == (None, None)
        assert axis.peak_std > 0
