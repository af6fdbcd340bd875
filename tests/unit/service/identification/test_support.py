"""A support that resonates far below the rotor's first flexible mode is identified with it."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.fit import identify
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
