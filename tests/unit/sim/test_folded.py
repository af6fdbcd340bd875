"""What a twin's effects make of its datasheet's values, and of the known blocks beside them."""

from dataclasses import replace

import numpy as np
import pytest

from sim.chain import Chain
from sim.errors import EffectError
from sim.folded import folded
from sim.rig import Amplifiers
from tests.support.synthetic import known_datasheet

SHEET = known_datasheet()[1]


def twin(**effects: dict[str, float]):
    return folded(replace(SHEET, effects=tuple((name, tuple(values.items())) for name, values in effects.items())))


def test_a_datasheet_without_effects_stays_as_it_is():
    found = twin()
    assert found.datasheet == SHEET
    assert found.effects == ()
    chain, omega = found.chain, np.array([10.0, 6000.0])
    assert [chain.is_in_log, chain.is_before_flux, chain.is_behind_sensor] == [False] * 3
    np.testing.assert_array_equal(chain.flux(omega), 1.0)
    np.testing.assert_array_equal(chain.sensor(omega), 1.0)


def test_values_that_the_datasheet_has_a_field_for_are_changed_in_it():
    found = twin(
        rotor_inertia={"mass_change": 0.1, "inertia_change": 0.2},
        sensor_position={"shift_A_m": 0.01, "shift_B_m": -0.01},
        loop_delay={"delay_s": 2e-5},
        internal_damping={"damping_ratio": 0.002},
    ).datasheet
    assert found.effects == ()
    assert found.mass_kg == pytest.approx(1.1 * SHEET.mass_kg)
    assert found.transverse_inertia_kgm2 == pytest.approx(1.2 * SHEET.transverse_inertia_kgm2)
    assert found.sensor_from_cog_m == pytest.approx((0.494, 0.460))
    assert found.computing_delay_s == pytest.approx(SHEET.computing_delay_s + 2e-5)
    assert [m.damping_ratio for m in found.modes] == pytest.approx([m.damping_ratio + 0.002 for m in SHEET.modes])
    assert found.polar_inertia_kgm2 == SHEET.polar_inertia_kgm2


def test_an_off_centre_rotor_has_the_factors_of_its_place():
    found = twin(off_centre_rotor={"offset_xA_m": 4e-5, "offset_xB_m": 0.0, "offset_yA_m": 0.0, "offset_yB_m": 0.0})
    gap = SHEET.bias_current_a[0] * SHEET.current_stiffness_n_per_a[0] / SHEET.position_stiffness_n_per_m[0]
    xi2 = (4e-5 / gap) ** 2
    ki, ks = found.datasheet.current_stiffness_n_per_a, found.datasheet.position_stiffness_n_per_m
    assert ki[0] == pytest.approx(SHEET.current_stiffness_n_per_a[0] * (1 + xi2) / (1 - xi2) ** 2, rel=1e-5)
    assert ks[0] == pytest.approx(SHEET.position_stiffness_n_per_m[0] * (1 + 3 * xi2) / (1 - xi2) ** 3, rel=1e-5)
    assert ki[1:] == pytest.approx(SHEET.current_stiffness_n_per_a[1:], rel=1e-5)


def test_a_housing_with_pedestals_is_three_modes_among_those_of_the_rotor():
    found = twin(support_resonance={"inverse_mass_per_kg": 1e-3, "frequency_hz": 430.0, "pedestals": 0.4}).datasheet
    assert [round(m.frequency_hz) for m in found.modes] == [430, 430, 430, 493, 908]
    residues = sum(np.outer(m.shape_at_sensors, m.shape_at_bearings) for m in found.modes[:3])
    np.testing.assert_allclose(residues, [[1e-3, 6e-4], [6e-4, 1e-3]], rtol=1e-9)


def test_a_housing_that_leans_is_a_mode_that_moves_one_end_farther():
    leaning = {"inverse_mass_per_kg": 1e-3, "frequency_hz": 430.0, "pedestals": 0.0, "end_imbalance": 0.6}
    mode = twin(support_resonance=leaning).datasheet.modes[0]
    assert np.outer(mode.shape_at_sensors, mode.shape_at_bearings) == pytest.approx(
        1e-3 * np.array([[1.6, 0.8], [0.8, 0.4]]), rel=1e-9
    )


def test_an_effect_that_the_catalogue_does_not_have_is_refused():
    with pytest.raises(EffectError, match="loop_lag"):
        twin(loop_lag={"delay_s": 1e-5})


@pytest.mark.parametrize(("lag_s", "free_share"), [(0.0, 0.0), (5e-6, 0.0), (5e-6, 0.8)])
def test_states_of_the_chain_have_its_response(lag_s, free_share):
    one = np.ones(2)
    amplifiers = Amplifiers(one, 9e3 * one, 0.8 * one, 0 * one, np.eye(2), np.inf * one, lag_s)
    eddy = {"eddy_time_constant_s": np.array([2e-6, 0.0]), "eddy_corner_rad_s": 100.0, "eddy_free_share": free_share}
    chain = Chain(amplifiers=amplifiers, **eddy)
    a, b, c, d = chain.flux_states()
    omega = 2 * np.pi * np.geomspace(1.0, 3000.0, 40)
    states = c @ np.linalg.solve(1j * omega[:, None, None] * np.eye(len(a)) - a, b[None] + 0j) + d
    diagonal = np.einsum("faa->fa", states)
    np.testing.assert_allclose(diagonal, chain.flux(omega), rtol=5e-4)
    assert np.abs(states[:, 0, 1]).max() == 0.0
    assert chain.of([1]).is_before_flux == (lag_s > 0)


def test_what_eddy_currents_do_to_the_flux_of_the_gaps_is_told_and_the_currents_part_is_in_the_chain():
    (effect,) = twin(eddy_currents={"time_constant_s": 1e-6, "displacement_share": 1.0}).effects
    assert any("per flux-making current" in clause for clause in effect.in_model)
    assert effect.not_in_model[0].startswith("the model's position stiffness is a spring")
    assert twin(eddy_currents={"time_constant_s": 1e-6}).effects[0].not_in_model == ()
