"""The exact derivatives of the twin's answer, against differences of it."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.jacobian import answer_jacobian, residue_columns
from service.gap.fitting.nuisance import Nuisance, nuisance
from service.gap.fitting.predict import linear_answer
from service.gap.measured.observation import Observation, observe
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

EFFECTS = [
    {},
    {"loop_delay": {"delay_s": 3e-5}, "channel_crosstalk": {"share_ab": 0.03}},
    {"support_resonance": {"frequency_hz": 300.0}, "magnetic_cross_coupling": {"rotation_rad": 0.03}},
    {"eddy_currents": {"time_constant_s": 1e-5, "corner_rad_s": 1e4}, "logging_offset": {"samples": 1.0}},
    {"magnetic_cross_coupling": {"rotation_rad": 0.1, "symmetric_share": 0.0, "turned_whole": 1.0}},
]
OF_ITS_OWN = [
    {"extra_flexible_mode": {"frequency_hz": 310.0}},
    {"off_centre_rotor": {f"offset_{axis}_m": 6e-5 for axis in ("xA", "xB", "yA", "yB")}},
    {"cross_coupled_stiffness": {"stiffness_n_per_m": 3e5, "end_imbalance": 0.5}},
    {"cross_coupled_stiffness": {"stiffness_n_per_m": 3e5, "between": 1.0, "mode1_bow_per_sqrt_kg": -0.2}},
    {"support_resonance": {"frequency_hz": 300.0, "rocking": 3.0, "plane_frequency_ratio": 1.2}},
    {"internal_damping": {}},
    {"magnetic_saturation": {"flux_share": 0.5}},
    {
        "eddy_currents": {"time_constant_s": 1e-5, "displacement_share": 0.8},
        "magnetic_cross_coupling": {"rotation_rad": 0.1},
    },
]
"""Effects by which the datasheet's values act in another way than without."""


@pytest.mark.parametrize("effects", EFFECTS + OF_ITS_OWN, ids=lambda e: "+".join(e) or "plain")
def test_every_column_is_the_derivative_of_the_answer(effects: dict[str, dict[str, float]]) -> None:
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), lines(14), 0.1, seed=1), nu.rig)
    _holds(nu, with_effects(nu.rig, effects), o)


def test_it_is_that_of_a_shaft_that_turns_and_damps_and_of_a_rotor_that_weighs() -> None:
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), lines(14), 0.1, seed=1), nu.rig)
    _holds(nu, with_effects(nu.rig, {"internal_damping": {}}), replace(o, speed_rad_s=300.0))
    seal = {"stiffness_n_per_m": 3e5, "inverse_whirl_ratio": 0.8, "between": 0.4, "end_imbalance": 0.5}
    _holds(nu, with_effects(nu.rig, {"cross_coupled_stiffness": seal}), replace(o, speed_rad_s=300.0))
    _holds(nu, replace(nu.rig, gravity_m_per_s2=2.0), o)
    held = replace(with_effects(nu.rig, OF_ITS_OWN[1]), static_current_a=np.array([0.8, -0.5, 1.5, 0.0]))
    _holds(nu, held, o)


def test_a_damping_that_an_effect_gives_to_amplifiers_is_no_value_of_the_datasheet() -> None:
    """Stated as of first order, they have none that its tolerance could move."""
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(replace(datasheet, amplifier_damping_ratio=None))
    o = observe(sweep(true_rig(truth), lines(14), 0.1, seed=1), nu.rig)

    def at(theta: np.ndarray) -> Rig:
        return with_effects(nu.at(theta), {"amplifier_bandwidth": {"second_order_term": 0.6}})

    theta, step = np.zeros(len(nu)), 1e-4
    J = answer_jacobian(nu, at(theta), o)
    for j in (k for k, name in enumerate(nu.names) if name.startswith("amplifier")):
        e = step * np.eye(len(nu))[j]
        difference = (linear_answer(at(e), o) - linear_answer(at(-e), o)) / (2 * step)
        assert np.linalg.norm(J[:, :, j] - difference) <= 2e-3 * np.linalg.norm(difference), nu.names[j]


def _holds(nu: Nuisance, base: Rig, o: Observation) -> None:
    theta = 0.3 * np.random.default_rng(5).standard_normal(len(nu))
    J = answer_jacobian(nu, nu.at(theta, base), o)
    step = 1e-4
    for j, name in enumerate(nu.names):
        e = np.zeros(len(nu))
        e[j] = step
        ahead = linear_answer(nu.at(theta + e, base), o)
        difference = (ahead - linear_answer(nu.at(theta - e, base), o)) / (2 * step)
        size = np.linalg.norm(difference)
        assert np.linalg.norm(J[:, :, j] - difference) < 2e-3 * size, name


@pytest.mark.parametrize("effects", EFFECTS[1:], ids="+".join)
def test_residues_are_the_change_that_a_light_mode_makes(effects: dict[str, dict[str, float]]) -> None:
    datasheet, truth = known_datasheet(seed=3)
    rig = with_effects(nuisance(datasheet).rig, effects)
    o = observe(sweep(true_rig(truth), lines(14), 0.1, seed=1), rig)
    shape, w, zeta = 1e-3 * np.array([1.0, -0.7]), 2 * np.pi * 310.0, 0.02
    named = dict(zip("AB", shape, strict=True))
    values = {f"{at}_{end}_per_sqrt_kg": v for at in ("bearing", "sensor") for end, v in named.items()}
    light = with_effects(
        rig, {"extra_flexible_mode": {"frequency_hz": w / (2 * np.pi), "damping_ratio": zeta, **values}}
    )
    change = (linear_answer(light, o) - linear_answer(rig, o))[:, rig.n_axes :]
    s = 2j * np.pi * o.points_hz
    told = (residue_columns(rig, o) * np.outer(shape, shape)).sum(axis=(2, 3)) / (s**2 + 2 * zeta * w * s + w**2)[
        :, None
    ]
    np.testing.assert_allclose(told, change, rtol=0, atol=1e-3 * np.abs(change).max())
