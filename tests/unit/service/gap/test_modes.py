"""A datasheet without modes takes those that its experiment shows, but not what its twin has already."""

from dataclasses import replace

from service.gap.modes import with_identified_modes
from sim.twin import rig_from_datasheet
from tests.support.synthetic import experiment, known_datasheet
from tests.support.two_axes import one_plane

SHEET, TRUTH = known_datasheet()


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
