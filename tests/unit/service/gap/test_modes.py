"""A datasheet without modes takes those that its experiment shows, but not what its twin has already."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.modes import with_identified_modes
from sim.twin import rig_from_datasheet, with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep
from tests.support.two_axes import one_plane

SHEET, TRUTH = known_datasheet()


def test_a_coupling_of_the_planes_makes_no_further_modes_of_the_rotor():
    """Through it the other plane's closed loop shows, resonant beside each mode."""
    coupled = with_effects(rig_from_datasheet(TRUTH), {"magnetic_cross_coupling": {"rotation_rad": 0.05}})
    peaks = [491, 492.5, 494, 497, 498.5, 499.5, 500.5, 502, 504, 905, 908, 911, 915, 920, 925, 930]
    main = sweep(coupled, np.unique(np.r_[np.geomspace(12, 1000, 40), peaks]), 0.1, seed=1)
    data = replace(experiment(coupled), sweeps=(replace(main, comment="main"),))
    found, _ = with_identified_modes(data, replace(SHEET, modes=()))
    assert [m.frequency_hz for m in found.modes] == pytest.approx([m.frequency_hz for m in TRUTH.modes], rel=2e-3)


def test_a_support_that_the_twin_names_is_no_mode_of_the_rotor_as_well():
    effects = (("support_resonance", (("inverse_mass_per_kg", 1 / 900), ("frequency_hz", 430.0))),)
    data = experiment(rig_from_datasheet(replace(TRUTH, effects=effects)))
    data, unknown = one_plane(data, replace(SHEET, modes=()))
    with_it, _ = with_identified_modes(data, unknown)
    assert any(abs(m.frequency_hz - 430) < 10 for m in with_it.modes)
    named, _ = with_identified_modes(data, replace(unknown, effects=effects))
    assert not any(abs(m.frequency_hz - 430) < 10 for m in named.modes)
    assert any(abs(m.frequency_hz - 493) < 2 for m in named.modes)
    assert named.effects == effects
