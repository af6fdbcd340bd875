"""A datasheet without modes takes those that its experiment shows, but not what its twin has already."""

import re
from dataclasses import replace

import numpy as np
import pytest

from service.gap.modes import with_identified_modes
from sim.datasheet import Datasheet
from sim.twin import rig_from_datasheet, with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep
from tests.support.two_axes import one_plane

SHEET, TRUTH = known_datasheet()


@pytest.mark.slow
def test_a_coupling_of_the_planes_makes_no_further_modes_of_the_rotor() -> None:
    """Through it the other plane's closed loop shows, resonant beside each mode."""
    coupled = with_effects(rig_from_datasheet(TRUTH), {"magnetic_cross_coupling": {"rotation_rad": 0.05}})
    peaks = [491, 492.5, 494, 497, 498.5, 499.5, 500.5, 502, 504, 905, 908, 911, 915, 920, 925, 930]
    main = sweep(coupled, np.unique(np.r_[np.geomspace(12, 1000, 40), peaks]), 0.1, seed=1)
    data = replace(experiment(coupled), sweeps=(replace(main, comment="main"),))
    found, _ = with_identified_modes(data, replace(SHEET, modes=()))
    assert [m.frequency_hz for m in found.modes] == pytest.approx([m.frequency_hz for m in TRUTH.modes], rel=2e-3)


def shown_by(truth: Datasheet) -> tuple[list[float], str]:
    """Modes (Hz) that an experiment on one plane of a rig gives a datasheet without any, and the note."""
    data, unknown = one_plane(experiment(rig_from_datasheet(truth)), replace(SHEET, modes=()))
    found, note = with_identified_modes(data, unknown)
    return [m.frequency_hz for m in found.modes], note


def on_a_support(truth: Datasheet, **values: float) -> Datasheet:
    support = {"inverse_mass_per_kg": 1 / 900, **values}
    return replace(truth, effects=(("support_resonance", tuple(support.items())),))


@pytest.mark.parametrize(
    ("values", "left_hz"),
    [
        pytest.param({"frequency_hz": 430.0}, [430.0], id="housing"),
        pytest.param({"frequency_hz": 130.0}, [130.0], id="far below the modes"),
        pytest.param(
            {"frequency_hz": 430.0, "pedestals": 1.0, "frequency_ratio": 0.9}, [0.9 * 430.0, 430.0], id="two pedestals"
        ),
    ],
)
def test_what_moves_bearings_and_sensors_as_a_support_is_no_mode_of_a_lopsided_rotor(
    values: dict[str, float], left_hz: list[float]
) -> None:
    modes_hz, note = shown_by(on_a_support(TRUTH, **values))
    assert modes_hz == pytest.approx([m.frequency_hz for m in TRUTH.modes], rel=2e-3)
    left = note.split("; ")[-1]
    assert "as a support does" in left
    assert [float(f) for f in re.findall(r"([\d.]+) Hz", left)] == pytest.approx(left_hz, rel=2e-3)


def test_what_hardly_moves_the_rotor_is_no_mode_of_it() -> None:
    first = TRUTH.modes[0]
    rim = {"frequency_hz": first.frequency_hz, "damping_ratio": first.damping_ratio, "plane_frequency_ratio": 1.0}
    rim |= {f"{at}_per_sqrt_kg": 0.15 / np.sqrt(TRUTH.mass_kg) for at in ("bearing_A", "bearing_B", "sensor_A")}
    rim["sensor_B_per_sqrt_kg"] = -0.08 / np.sqrt(TRUTH.mass_kg)
    modes_hz, note = shown_by(replace(TRUTH, modes=(), effects=(("extra_flexible_mode", tuple(rim.items())),)))
    assert modes_hz == []
    assert f"{first.frequency_hz:.1f} Hz moves the rotor too little" in note


def test_a_rotor_that_is_even_itself_may_have_such_a_mode() -> None:
    first, second = TRUTH.modes
    even = (
        replace(first, shape_at_bearings=(0.06, 0.06), shape_at_sensors=(0.11, 0.11)),
        replace(second, shape_at_bearings=(0.15, -0.15), shape_at_sensors=(0.11, -0.11)),
    )
    modes_hz, note = shown_by(replace(TRUTH, modes=even))
    assert modes_hz == pytest.approx([m.frequency_hz for m in even], rel=2e-3)
    assert "as a support does" not in note


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_ends_that_move_against_each_other_are_no_less_so_in_two_planes(seed: int) -> None:
    """Noise decides in each plane which of them is the larger, and so which is said to be positive."""
    even = replace(TRUTH.modes[1], shape_at_bearings=(0.11, -0.11), shape_at_sensors=(0.1, -0.1))
    rig = rig_from_datasheet(replace(TRUTH, modes=(even,)))
    peaks = [905, 908, 911, 915, 920]
    main = sweep(rig, np.unique(np.r_[np.geomspace(12, 1000, 30), peaks]), 0.1, seed=seed, noise=4.0)
    data = replace(experiment(rig), sweeps=(replace(main, comment="main"),))
    found, _ = with_identified_modes(data, replace(SHEET, modes=()))
    (mode,) = [m for m in found.modes if abs(m.frequency_hz / even.frequency_hz - 1) < 0.01]
    assert np.abs(mode.shape_at_bearings) == pytest.approx([0.11, 0.11], rel=0.3)
    assert np.prod(mode.shape_at_bearings) < 0


def test_a_support_that_the_twin_names_is_no_mode_of_the_rotor_as_well() -> None:
    named = on_a_support(TRUTH, frequency_hz=430.0)
    data, unknown = one_plane(experiment(rig_from_datasheet(named)), replace(SHEET, modes=()))
    found, note = with_identified_modes(data, replace(unknown, effects=named.effects))
    assert [m.frequency_hz for m in found.modes] == pytest.approx([m.frequency_hz for m in TRUTH.modes], rel=2e-3)
    assert found.effects == named.effects
    assert "as a support does" not in note


@pytest.mark.slow
def test_sensors_elsewhere_do_not_move_a_mode_from_bearings_to_sensors() -> None:
    """Data show the product of both; the ratio follows the stiffness at work, and whatever is not in the model."""
    sheet, truth = known_datasheet(seed=8)
    moved = with_effects(rig_from_datasheet(truth), {"sensor_position": {"shift_A_m": 0.02, "shift_B_m": 0.01}})
    found, _ = with_identified_modes(*one_plane(experiment(moved), replace(sheet, modes=())))
    assert len(found.modes) == len(truth.modes)
    for mode, true in zip(found.modes, truth.modes, strict=True):
        bearings, sensors = (
            np.linalg.norm(getattr(mode, of)) / np.linalg.norm(getattr(true, of))
            for of in ("shape_at_bearings", "shape_at_sensors")
        )
        assert 0.4 < bearings / sensors < 2.5
        assert bearings * sensors == pytest.approx(1, rel=0.3)
