"""Eddy currents that hold back the flux of the changing gaps, too: one law in linear model, balance and time."""

from dataclasses import replace

import numpy as np
import pytest

from sim import actuator, rotor
from sim.harmonic_balance import Responder
from sim.measured import measured_responses
from sim.reference import reference_rig
from sim.rig import Noise, Rig
from sim.stepping import Simulation
from sim.twin import linear_model, with_effects

FLEXIBLE = reference_rig(noise=Noise())
QUIET = replace(FLEXIBLE, rotor=replace(FLEXIBLE.rotor, modes=((), ())))
"""Rigid, so that no mode takes the loop's stability however much the flux lags."""
TONES_HZ = np.array([11.0, 47.0, 173.0, 489.0, 991.0])
LAW = {"time_constant_s": 2e-5, "corner_rad_s": 300.0}
TURNED = {"rotation_rad": 0.03, "symmetric_share": 0.03, "turned_whole": 1.0}
UNEVEN = {"end_imbalance": 1.0, "plane_imbalance": 0.4}


def with_share(share: float, rig: Rig = QUIET, **more: float) -> Rig:
    return with_effects(rig, {"eddy_currents": {**LAW, "displacement_share": share, **more}})


def differences(a: np.ndarray, b: np.ndarray) -> float:
    return float((np.linalg.norm(a - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2))).max())


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("load", [0.0, 3.0])
def test_the_force_is_ki_e_i_and_ks_with_the_share_of_e_at_the_operating_point(share, load):
    rig = with_share(share, replace(QUIET, gravity_m_per_s2=load), **UNEVEN)
    model, m, point = linear_model(rig, TONES_HZ), rotor.mechanics(rig), actuator.operating_point(rig)
    s, E = 2j * np.pi * TONES_HZ[:, None, None], actuator.eddy_factor(rig.magnets, 2 * np.pi * TONES_HZ)
    ks = (point.ks * (1 - share + share * E))[:, :, None] * np.eye(4)
    dynamic = m.mass * s**2 + m.damping * s + m.stiffness - m.force_map @ ks @ m.bearing_map
    y_per_i = (
        rig.sensors.gain[:, None]
        * m.sensor_map
        @ np.linalg.solve(dynamic, m.force_map @ ((point.ki * E)[:, :, None] * np.eye(4)))
    )
    np.testing.assert_allclose(model.plant, y_per_i, atol=1e-9 * np.abs(y_per_i).max())


@pytest.mark.parametrize(
    "rig",
    [
        with_share(1.0, **UNEVEN),
        with_share(1.0, FLEXIBLE, time_constant_s=1e-5),
        with_effects(with_share(0.5), {"magnetic_cross_coupling": TURNED}),
    ],
    ids=["uneven", "flexible", "turned magnets"],
)
def test_the_linear_model_is_what_the_rig_shows_in_time(rig):
    found, model = measured_responses(rig, TONES_HZ), linear_model(rig, TONES_HZ)
    of_current = replace(rig, magnets=replace(rig.magnets, eddy_displacement_share=0.0))
    assert differences(linear_model(of_current, TONES_HZ).y_per_u, model.y_per_u) > 5e-3
    assert differences(found.y_per_u, model.y_per_u) < 6e-4


@pytest.mark.parametrize(
    "effects",
    [
        {"magnetic_saturation": {"saturation_inverse_per_a": 1.0}},
        {"off_centre_rotor": {f"offset_{axis}_m": 1e-4 for axis in ("xA", "xB", "yA", "yB")}},
    ],
    ids="+".join,
)
@pytest.mark.parametrize("seen", [False, True])
def test_what_displacements_make_of_the_flux_is_in_the_balance_as_it_is_in_time(effects, seen):
    """Up to the third harmonic, from the measured control signal, whether or not the displacement is measured."""
    rig = with_effects(with_share(1.0, time_constant_s=1e-4), effects)
    hz, amplitude_a = 37.0, 0.5
    t = np.arange(40_000) * 1e-4
    r = np.zeros((len(t), 4))
    r[:, 0] = amplitude_a * np.sin(np.pi / 2 * np.minimum(t / 2.5, 1.0)) ** 2 * np.cos(2 * np.pi * hz * t)
    record = Simulation(rig).advance(r, check_limits=False)
    basis = np.exp(-2j * np.pi * hz * np.outer(np.arange(4), t[-10_000:])) * np.array([1, 2, 2, 2])[:, None] / 10_000
    U, Y = (np.asarray(basis @ x[-10_000:])[None] for x in (record.u, record.y))

    answer = Responder(rig, np.array([hz]), np.array([0])).displacement(U, None, Y if seen else None)
    size = np.abs(Y[0, :, 0])
    error = np.abs(answer - Y)[0].max(axis=1)
    assert error[0] < 1e-4 * size[1]
    assert error[1] < 5e-4 * size[1]
    assert error[2:].max() < 0.01 * size[2:].max()


def test_a_rig_at_rest_under_a_load_stays_there():
    rig = with_share(1.0, replace(QUIET, gravity_m_per_s2=3.0))
    record = Simulation(rig).advance(np.zeros((2000, 4)))
    assert np.abs(record.y).max() < 1e-7
