"""A support that resonates is identified beside the rotor's modes, and told from them by how it moves."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.result.supports import move_as_supports
from sim.twin import rig_from_datasheet, with_effects
from tests.support.synthetic import known_datasheet, lines, sweep
from tests.support.two_axes import one_plane

SHEET, TRUTH = known_datasheet()
NOMINAL = replace(SHEET, modes=(), current_stiffness_n_per_a=(340.0,) * 4, position_stiffness_n_per_m=(2.3e6,) * 4)


@pytest.mark.parametrize("hz", [15.0, 25.0, 38.0])
def test_a_support_below_every_flexible_mode_leaves_the_stiffnesses_right(hz: float) -> None:
    support = {"inverse_mass_per_kg": 5e-4, "frequency_hz": hz, "damping_ratio": 0.01}
    rig = with_effects(rig_from_datasheet(TRUTH), {"support_resonance": support})
    main = replace(sweep(rig, lines(64), 0.1, seed=1), comment="main")
    plane = identify(*one_plane(Experiment("rig", SHEET.axes, (main,)), NOMINAL)).planes["x"]
    found = [m.natural_frequency_rad_s.value / (2 * np.pi) for m in plane.modes]
    assert found == pytest.approx([hz, *(m.frequency_hz for m in TRUTH.modes)], rel=1e-3)
    magnets = (*TRUTH.current_stiffness_n_per_a[:2], *TRUTH.position_stiffness_n_per_m[:2])
    for name, value in zip(("kiA", "kiB", "ksA", "ksB"), magnets, strict=True):
        assert plane.stiffness[name].value == pytest.approx(value, rel=2e-3)
    (told,) = [w for w in plane.warnings if "as a support does" in w]
    assert f" {hz:.1f} Hz" in told


def test_a_support_that_the_datasheet_names_is_not_told() -> None:
    support = {"inverse_mass_per_kg": 5e-4, "frequency_hz": 38.0, "damping_ratio": 0.01}
    named = replace(SHEET, effects=(("support_resonance", tuple(support.items())),))
    rig = with_effects(rig_from_datasheet(TRUTH), {"support_resonance": support})
    main = replace(sweep(rig, lines(64), 0.1, seed=1), comment="main")
    plane = identify(*one_plane(Experiment("rig", SHEET.axes, (main,)), named)).planes["x"]
    assert not [w for w in plane.warnings if "as a support does" in w]


SUPPORTS = [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]
BENT = ((0.0806, 0.0457), (0.080, 0.1416))


@pytest.mark.parametrize("moves", SUPPORTS)
@pytest.mark.parametrize("scale", [0.01, -3.0])
@pytest.mark.parametrize("sensors", [1.0, 0.7], ids=["as the bearings", "of another gain"])
def test_only_a_support_moves_bearings_and_sensors_so(moves: tuple[float, float], scale: float, sensors: float) -> None:
    support = scale * np.array([moves, np.multiply(moves, sensors)])
    np.testing.assert_array_equal(move_as_supports(np.array([BENT, support])), [False, True])


@pytest.mark.parametrize(
    "other",
    [
        pytest.param([(1.0, 1.0), (-1.0, -1.0)], id="a node between bearings and sensors"),
        pytest.param([(1.0, -1.0), (1.0, -1.0)], id="ends against each other"),
        pytest.param([(1.0, 1.0), (1.0, 0.9)], id="sensors unlike"),
        pytest.param([(0.9, 1.0), (1.0, 1.0)], id="bearings unlike"),
    ],
)
def test_a_rotor_moves_otherwise(other: list[tuple[float, float]]) -> None:
    assert not move_as_supports(np.array([BENT, other])).any()


def test_nothing_is_said_of_a_rotor_that_is_even() -> None:
    even = [[(1.0, 1.0), (2.0, 2.0)], [(1.0, -1.0), (0.5, -0.5)]]
    assert not move_as_supports(np.array(even)).any()
    assert not move_as_supports(np.array(even[:1])).any()
    assert not move_as_supports(np.empty((0, 2, 2))).any()
