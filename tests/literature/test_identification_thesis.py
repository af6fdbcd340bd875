"""Figures of Khader, System Identification of Active Magnetic Bearing for Commissioning, and of ISO 14839-3."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.loop.margins import zone
from service.identification.plane.combine import plant_poles, plant_state_space
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.steps.rigid import bearing_from_sensor, rigid_response
from sim.reference import reference_rig
from tests.support.planes import plane_model_of

BEARINGS, SENSORS = (0.418, 0.404), (0.484, 0.470)


def plane(ki: tuple[float, float], ks: tuple[float, float]) -> PlaneModel:
    """Rigid rotor of Table 5-1 with identified constants."""
    known = Known(BEARINGS, SENSORS, np.array([2.75, 2.75]), 1e-4)
    theta = np.array([*ki, *ks, 1, 9244, 0.8068, 1, 9640, 0.83, 0, 280, 10.87, 0, 1, 1, 0, 0])
    return PlaneModel(known, Layout((2, 2), 0), theta)


X = plane((181.0, 186.0), (1.68e6, 1.73e6))
Y = plane((184.0, 198.0), (1.69e6, 1.88e6))


def inverse_mass() -> np.ndarray:
    """From forces to accelerations at the bearings, of magnets with a newton per ampere and no stiffness."""
    omega = 100.0
    at_sensors = rigid_response(X, np.ones(2), np.zeros(2), np.array([omega]))[0].real
    return bearing_from_sensor(X) @ at_sensors * -(omega**2)


def test_appendix_b_inverse_mass_matrix() -> None:
    assert inverse_mass().round(3).tolist() == [[0.02, -0.012], [-0.012, 0.019]]


def test_appendix_a12_rigid_matrices_with_the_identified_constants() -> None:
    m = inverse_mass()
    assert m[0, 1] == pytest.approx(-0.0119, rel=1e-2)
    # the constants are printed to three digits, the matrix from more
    assert (m @ np.diag([1.68e6, 1.73e6]))[0, 0] == pytest.approx(3.311e4, rel=5e-3)


@pytest.mark.parametrize(("model", "poles"), [(X, (230.4, 110.5)), (Y, (235.6, 112.9))])
def test_rigid_poles_of_appendix_a(model: PlaneModel, poles: tuple[float, float]) -> None:
    found = np.sort(plant_poles(model).real)
    expected = np.sort([s * p for p in poles for s in (1, -1)])
    # printed to four digits from constants printed to three
    assert np.allclose(found, expected, rtol=2e-3)
    assert np.allclose(plant_poles(model).imag, 0, atol=1e-6)


def test_exact_sensor_map_is_not_the_diagonal_one_of_the_thesis() -> None:
    exact = np.linalg.inv(bearing_from_sensor(X))
    assert exact.round(3).tolist() == [[1.08, -0.08], [-0.08, 1.08]]


def test_rigid_response_at_low_frequency_is_minus_ki_over_ks() -> None:
    # quasi-static: the magnets balance, x = -ki i / ks, each bearing by itself
    slow = rigid_response(X, X.ki, X.ks, np.array([1e-3]))[0].real
    at_bearings = bearing_from_sensor(X) @ slow
    assert np.allclose(at_bearings, np.diag(-X.ki / X.ks), rtol=1e-6, atol=1e-12)


def test_flexible_poles_of_appendix_a_lie_below_the_free_rotors_by_the_position_stiffness() -> None:
    model = plane_model_of(reference_rig(), "x")
    poles = plant_poles(model)
    for frequency, damping in ((3097.0, 3.766), (5708.0, 6.071)):
        near = poles[np.argmin(np.abs(poles - (-damping + 1j * frequency)))]
        assert 1e-4 < 1 - abs(near) / frequency < 2e-3
        assert near.real == pytest.approx(-damping, rel=0.01)


def test_modal_form_of_equation_4_9_stacks_rigid_and_flexible_parts() -> None:
    ss = plant_state_space(plane_model_of(reference_rig(), "x"), ("xA", "xB"))
    assert [s.split()[0] for s in ss.states] == ["real"] * 4 + ["mode"] * 4
    assert ss.A.shape == (8, 8)
    assert not ss.D.any()


def test_zones_of_iso_14839_3() -> None:
    # Table 1 of ISO 14839-3: A/B at 9.5 dB, B/C at 12 dB, C/D at 14 dB; peaks of 3, 4, 5
    assert [zone(s) for s in (2.98, 2.995, 3.9, 4.1, 4.9, 5.1)] == ["A", "B", "B", "C", "C", "D"]
