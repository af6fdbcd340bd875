"""What must hold whatever the rig: scalings, symmetries, and other rotors than the reference one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from service.identification.fit import identify
from service.identification.joint.refine import refine
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.plane.prediction import Points
from service.identification.steps.rigid import rigid_start
from sim.datasheet import Datasheet
from sim.reference import pid_with_biquad, reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

TRUTH = plane_model_of(reference_rig(), "x")
OMEGA = 2 * np.pi * np.geomspace(10, 1000, 30)
U = np.random.default_rng(0).normal(size=(30, 2)) + 1j * np.random.default_rng(1).normal(size=(30, 2))


def changed(model: PlaneModel, **values: float) -> PlaneModel:
    theta = model.theta.copy()
    for name, value in values.items():
        theta[model.layout.index(name)] = value
    return model.at(theta)


@given(st.floats(0.2, 5.0))
def test_force_against_mass_is_an_exact_alias(factor: float) -> None:
    """Mass, inertia, ki and ks in one proportion, and the shapes of unit modal mass with them: all looks the same."""
    layout = TRUTH.layout
    theta = TRUTH.theta.copy()
    theta[0:4] *= factor
    theta[layout.extended.start : layout.extended.start + 2] *= factor
    for k in range(layout.n_modes):
        at = layout.mode(k)
        theta[at.start + 2 : at.stop] /= np.sqrt(factor)
    assert np.allclose(TRUTH.at(theta).response(OMEGA), TRUTH.response(OMEGA), rtol=1e-9)


@given(st.floats(0.5, 2.0))
def test_a_gain_common_to_all_sensors_is_an_exact_alias_of_ki(gain: float) -> None:
    sensors = changed(TRUTH, sensor_gain_A=gain, sensor_gain_B=gain)
    current = changed(TRUTH, ki_A=gain * TRUTH.ki[0], ki_B=gain * TRUTH.ki[1])
    assert np.allclose(sensors.response(OMEGA), current.response(OMEGA), rtol=1e-9)


@given(st.floats(0.5, 2.0).filter(lambda g: abs(g - 1) > 0.01))
def test_the_gain_of_one_sensor_scales_a_row_and_no_ki_can(gain: float) -> None:
    one = changed(TRUTH, sensor_gain_A=gain).response(OMEGA)
    assert np.allclose(one[:, 0], gain * TRUTH.response(OMEGA)[:, 0])
    assert np.allclose(one[:, 1], TRUTH.response(OMEGA)[:, 1])


@given(st.floats(1e-3, 1e3))
def test_the_small_signal_model_is_linear(scale: float) -> None:
    assert np.allclose(TRUTH.predict(Points(OMEGA, scale * U)).y, scale * TRUTH.predict(Points(OMEGA, U)).y, rtol=1e-9)


def test_swapping_the_bearings_swaps_the_response() -> None:
    layout = TRUTH.layout
    theta = TRUTH.theta.copy()
    theta[[0, 1, 2, 3]] = TRUTH.theta[[1, 0, 3, 2]]
    a, b = layout.amplifiers
    theta[a], theta[b] = TRUTH.theta[b], TRUTH.theta[a]
    for k in range(layout.n_modes):
        at = layout.mode(k).start
        theta[at + 2 : at + 6] = TRUTH.theta[[at + 3, at + 2, at + 5, at + 4]]
    k = TRUTH.known
    swapped = PlaneModel(
        replace(k, bearing_from_cog_m=k.bearing_from_cog_m[::-1], sensor_from_cog_m=k.sensor_from_cog_m[::-1]),
        layout,
        theta,
    )
    assert np.allclose(swapped.response(OMEGA), TRUTH.response(OMEGA)[:, ::-1, ::-1], rtol=1e-9)


@given(st.floats(30, 900), st.floats(30, 900), st.floats(2e5, 8e6), st.floats(2e5, 8e6))
def test_the_rigid_start_needs_no_knowledge_of_the_magnets(ki_a: float, ki_b: float, ks_a: float, ks_b: float) -> None:
    known = Known((0.418, 0.404), (0.484, 0.47), np.array([2.75, 2.75]), 1e-4)
    theta = np.array([ki_a, ki_b, ks_a, ks_b, 1, 9244, 0.8, 1, 9244, 0.8, 0, 280, 10.87, 0, 1, 1, 0, 0])
    model = PlaneModel(known, Layout((2, 2), 0), theta)
    p = model.predict(Points(OMEGA, U))
    guess = changed(model, ki_A=340.0, ki_B=340.0, ks_A=2.3e6, ks_B=2.3e6)
    ki, ks = rigid_start(guess, OMEGA, p.coil, p.y)
    assert np.allclose(ki, [ki_a, ki_b], rtol=1e-6)
    assert np.allclose(ks, [ks_a, ks_b], rtol=1e-6)


# Rotors: mass, inertia, half span, (frequency Hz, damping, bearings, sensors) ...
ROTORS = {
    "light and stiff": (12.0, 0.15, 0.15, [(820.0, 0.003, (0.3, 0.28), (0.34, 0.33))]),
    "heavy and flexible": (
        1500.0,
        420.0,
        0.9,
        [(95.0, 0.002, (0.020, 0.018), (0.024, 0.023)), (310.0, 0.002, (0.03, -0.028), (0.033, -0.030))],
    ),
    "three modes": (
        280.0,
        10.87,
        0.41,
        [
            (310.0, 0.002, (0.08, 0.07), (0.09, 0.08)),
            (560.0, 0.0015, (0.12, -0.10), (0.13, -0.11)),
            (870.0, 0.001, (0.15, 0.12), (0.17, 0.13)),
        ],
    ),
    "close modes": (
        280.0,
        10.87,
        0.41,
        [(490.0, 0.002, (0.10, 0.09), (0.11, 0.10)), (505.0, 0.002, (0.07, -0.08), (0.08, -0.09))],
    ),
    "node at a sensor": (
        280.0,
        10.87,
        0.41,
        [(490.0, 0.002, (0.10, 0.04), (0.11, 0.002)), (900.0, 0.002, (0.15, 0.12), (0.17, 0.13))],
    ),
}


def rig_of(name: str, ki: tuple[float, float], ks: tuple[float, float]) -> tuple[PlaneModel, Datasheet]:
    """A rotor in the reference rig's bearings; the datasheet knows neither magnets nor modes."""
    mass, inertia, span, modes = ROTORS[name]
    scale = mass / 280.0
    ki, ks = (ki[0] * scale, ki[1] * scale), (ks[0] * scale, ks[1] * scale)
    theta = [*ki, *ks, 1, 9244, 0.8068, 1, 9640, 0.83, 0]
    for hz, zeta, bearing, sensor in modes:
        w = 2 * np.pi * hz
        nu = np.sqrt(w**2 - np.square(bearing) @ np.array(ks))
        theta += [nu, zeta * w, *bearing, *sensor]
    theta += [mass, inertia, 0, 1, 1, 0, 0]
    known = Known((span, span), (1.1 * span, 1.1 * span), np.array([2.75, 2.75]), 1e-4)
    b, a = pid_with_biquad()
    sheet = replace(
        reference_datasheet(),
        axes=("xA", "xB"),
        mass_kg=mass,
        transverse_inertia_kgm2=inertia,
        bearing_from_cog_m=(span, span),
        sensor_from_cog_m=(1.1 * span, 1.1 * span),
        current_stiffness_n_per_a=(340.0 * scale,) * 2,
        position_stiffness_n_per_m=(2.3e6 * scale,) * 2,
        bias_current_a=(2.75,) * 2,
        amplifier_gain=(1.0,) * 2,
        amplifier_natural_frequency_hz=(1500.0,) * 2,
        amplifier_damping_ratio=(0.8,) * 2,
        sensor_gain=(1.0,) * 2,
        numerator=tuple(b.tolist()),
        denominator=tuple(a.tolist()),
    )
    return PlaneModel(known, Layout((2, 2), len(modes)), np.array(theta)), sheet


@pytest.mark.parametrize("name", sorted(ROTORS))
@settings(
    max_examples=2,
    derandomize=True,
    phases=(Phase.explicit, Phase.generate),  # shrinking would take longer than it tells
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    ki=st.tuples(st.floats(150, 220), st.floats(150, 220)),
    ks=st.tuples(st.floats(1.4e6, 2.0e6), st.floats(1.4e6, 2.0e6)),
    seed=st.integers(0, 1000),
)
def test_other_rotors_are_identified(name: str, ki: tuple[float, float], ks: tuple[float, float], seed: int) -> None:
    model, sheet = rig_of(name, ki, ks)
    near = [hz * (1 + np.linspace(-0.02, 0.02, 13)) for hz, *_ in ROTORS[name][3]]
    f = np.unique(np.concatenate([np.geomspace(10, 1000, 90), *near]))
    controller = (np.array(sheet.numerator), np.array(sheet.denominator))
    # any u serves: the estimator does not ask whether this loop would hold the rotor
    sweep = synthetic_sweep(
        {"x": model},
        sheet.axes,
        controller,
        f,
        0.05,
        relative_noise=1e-3,
        current_noise_a=2e-5,
        displacement_noise_m=1e-10,
        seed=seed,
    )
    plane = identify(synthetic_experiment(sweep, axes=sheet.axes), sheet).planes["x"]
    found = plane.stiffness
    for key, value in zip(("ksA", "ksB", "kiA", "kiB"), [*model.ks, *model.ki], strict=True):
        assert found[key].value == pytest.approx(value, rel=5e-3), key
    rotor = [m for m in plane.modes if m.kind == "rotor"]
    assert len(rotor) == model.layout.n_modes
    for mode, w, zeta in zip(rotor, model.natural_frequencies, model.damping_ratios, strict=True):
        # the plant's pole is sharp; the free rotor's frequency hangs on how the shape splits, and says so
        away = abs(mode.natural_frequency_rad_s.value - w)
        assert away < max(2e-4 * w, 4 * mode.natural_frequency_rad_s.std)
        assert away < 0.01 * w
        assert mode.damping_ratio.value == pytest.approx(zeta, rel=0.1)


def test_amplitude_of_the_excitation_does_not_change_the_stiffness() -> None:
    """With the force law in the model, ki and ks are those of zero amplitude whatever the experiment's."""
    sheet = reference_datasheet()
    controller = (np.array(sheet.numerator), np.array(sheet.denominator))
    truth = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    found = []
    for size in (0.02, 0.25):
        sweep = synthetic_sweep(
            truth,
            sheet.axes,
            controller,
            np.geomspace(10, 1000, 50),
            size,
            current_noise_a=1e-7,
            displacement_noise_m=1e-12,
        )
        data = Data(plane_points(sweep, sheet.axes, "x"))
        held = ("mode_1_sensor_B", "mode_2_sensor_B")  # the shapes' split, which these data do not tell
        model = refine(truth["x"], data, TRUTH.layout.free(fixed=held)).model
        found.append(np.concatenate([model.ki, model.ks]))
    assert np.allclose(found[0], found[1], rtol=2e-5)
