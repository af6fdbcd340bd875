"""How strong what is withheld is: within an effect's range, at many strengths."""

import numpy as np
import pytest

from sim.effects import CATALOGUE
from sim.reference import reference_rig
from sim.withheld.rigs import base_rig
from sim.withheld.strength import strength


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_is_drawn_within_its_range_and_at_many_strengths(name: str) -> None:
    effect, rig, g = CATALOGUE[name], reference_rig(), np.random.default_rng(0)
    drawn = [strength(effect, rig, g) for _ in range(200)]
    for values in drawn:
        effect.on(rig, **values)  # raises when a value is out of range
        assert any(values[p.name] != p.null for p in effect.parameters if p.strength)
        for p in effect.parameters:  # what no fit can reach would be taken for something else
            assert values[p.name] == p.null or p.low <= values[p.name] <= p.high
    if "end_imbalance" in drawn[0]:
        assert 0.1 < np.mean([v["end_imbalance"] != 0 or v.get("plane_imbalance", 0) != 0 for v in drawn]) < 0.4
    distinct = {tuple(sorted(v.items())) for v in drawn}
    assert len(distinct) >= (3 if name == "logging_offset" else 180)  # the weakest of one range end meet there


def test_a_rotor_turns_from_x_to_y_with_the_whole_of_its_polar_inertia() -> None:
    g = np.random.default_rng(1)
    plain = base_rig(g)
    assert plain.rotor.whole_polar_inertia_kgm2 == 0.0
    inertias = [strength(CATALOGUE["gyroscopic_coupling"], plain, g)["polar_inertia_kgm2"] for _ in range(300)]
    assert min(inertias) > 0.1
    assert max(inertias) > 1.9


def test_a_quarter_of_other_controllers_have_a_notch_that_the_datasheet_does_not_know() -> None:
    effect, rig, g = CATALOGUE["controller_mismatch"], base_rig(np.random.default_rng(2)), np.random.default_rng(3)
    drawn = [strength(effect, rig, g) for _ in range(200)]
    notched = [v["filter_mid_change"] < 0 for v in drawn]
    assert 0.15 < np.mean(notched) < 0.35
    held = {p.name: p.null for p in effect.parameters if p.name.startswith("filter")}
    assert all(has or held.items() <= v.items() for has, v in zip(notched, drawn, strict=True))
