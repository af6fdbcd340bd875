"""What a trial withholds: the same for the same seed, every kind of it, and within what rigs and datasheets allow."""

import subprocess
import sys
from collections import Counter

import numpy as np
import pytest

from service.gap.trial.unlisted_laws import UNLISTED
from service.gap.trial.withheld import AT_SPEED, TOLERANCE, base_rig, datasheet_of, draw, strength
from sim.effects import CATALOGUE
from sim.reference import reference_rig


def test_the_same_seed_and_number_give_the_same_case() -> None:
    first, again, other = draw(3, 7), draw(3, 7), draw(3, 8)
    assert first.truth() == again.truth()
    assert first.datasheet == again.datasheet
    assert first.datasheet != other.datasheet


def test_single_mixed_clean_and_unlisted_cases_come_in_their_shares() -> None:
    kinds = Counter(draw(k, 1).kind for k in range(50))
    assert kinds["single"] in range(25, 32)
    assert min(kinds["mixture"], kinds["clean"], kinds["unlisted"]) >= 6


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_is_drawn_within_its_range_and_at_many_strengths(name: str) -> None:
    effect, rig, g = CATALOGUE[name], reference_rig(), np.random.default_rng(0)
    drawn = [strength(effect, rig, g) for _ in range(200)]
    for values in drawn:
        effect.on(rig, **values)  # raises when a value is out of range
        assert any(values[p.name] != p.null for p in effect.parameters if p.strength)
        for p in effect.parameters:  # what no fit can reach would be taken for something else
            assert values[p.name] == p.null or p.low <= values[p.name] <= p.high
    distinct = {tuple(sorted(v.items())) for v in drawn}
    assert len(distinct) >= (3 if name == "logging_offset" else 200)


@pytest.mark.parametrize("name", sorted(UNLISTED))
def test_an_unlisted_law_leaves_a_rig_of_the_same_axes(name: str) -> None:
    rig = reference_rig()
    drawn = UNLISTED[name](rig, np.random.default_rng(1))
    assert drawn.rig.axes == rig.axes
    assert drawn.parameters


def test_the_datasheet_is_off_within_its_tolerances_and_tells_no_effect() -> None:
    g = np.random.default_rng(2)
    rig = base_rig(g)
    sheets = [datasheet_of(rig, g) for _ in range(200)]
    for name, true, sigma in (
        ("current_stiffness_n_per_a", rig.magnets.ki, TOLERANCE.current_stiffness),
        ("position_stiffness_n_per_m", rig.magnets.ks, TOLERANCE.position_stiffness),
    ):
        error = np.array([getattr(s, name) for s in sheets]) / true - 1
        assert 0.4 * sigma < error.std() < sigma
        assert abs(error).max() < 2 * sigma
    assert all(s.effects == () for s in sheets)
    assert len({s.current_stiffness_n_per_a for s in sheets}) == 200


def test_some_rigs_turn_and_most_do_not() -> None:
    g = np.random.default_rng(3)
    turning = sum(base_rig(g).speed_rad_s > 0 for _ in range(300)) / 300
    assert abs(turning - AT_SPEED) < 0.06


def test_the_diagnosis_imports_nothing_that_knows_a_truth() -> None:
    code = "import sys, service.gap.diagnose; print(*(m for m in sys.modules if m.startswith('service.gap.')))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "service.gap.diagnose" in found
    assert not [m for m in found if m.startswith("service.gap.trial")]
