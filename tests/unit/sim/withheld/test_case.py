"""What is withheld: the same for the same seed, every kind of it, on a rig that is drawn or on one that is given."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from sim.datasheet import Datasheet, Mode
from sim.errors import AmbError, EffectError, LevitationError
from sim.reference import reference_datasheet, reference_rig
from sim.withheld.case import draw, redrawn
from sim.withheld.given import Given
from sim.withheld.unlisted_laws import UNLISTED

MODE = Mode(490.0, 0.001, (0.08, 0.05), (0.08, 0.14))


def plane_datasheet() -> Datasheet:
    """The reference rig's, xA and xB alone."""
    d = reference_datasheet()
    halves = {k: v[:2] for k, v in vars(d).items() if isinstance(v, tuple) and len(v) == 4 and k != "modes"}
    return replace(d, **halves)


def test_the_same_seed_and_number_give_the_same_case() -> None:
    first, again, other = draw(3, 7), draw(3, 7), draw(3, 8)
    assert first.truth() == again.truth()
    assert first.datasheet == again.datasheet
    assert first.datasheet != other.datasheet


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(AmbError, match="from 0 on"):
        draw(0, -1)


def test_single_mixed_clean_and_unlisted_cases_come_in_their_shares() -> None:
    kinds = Counter(draw(k, 1).kind for k in range(50))
    assert kinds["single"] in range(25, 32)
    assert min(kinds["mixture"], kinds["clean"], kinds["unlisted"]) >= 6


@pytest.mark.parametrize("name", sorted(UNLISTED))
def test_an_unlisted_law_leaves_a_rig_of_the_same_axes(name: str) -> None:
    rig = reference_rig()
    drawn = UNLISTED[name](rig, np.random.default_rng(1))
    assert drawn.rig.axes == rig.axes
    assert drawn.parameters


def test_on_a_given_rig_only_what_is_withheld_is_drawn() -> None:
    given = Given(reference_datasheet(), noise=False, gravity_m_per_s2=9.8, speed_rad_s=90.0)
    cases = [draw(k, k, given) for k in range(12)]
    assert {c.kind for c in cases} == {"single", "mixture", "clean", "unlisted"}
    for c in cases:
        assert c.datasheet == given.datasheet
        assert repr(c.plain) == repr(given.rig())
        assert (c.plain.gravity_m_per_s2, c.plain.speed_rad_s, c.plain.noise.displacement_m) == (9.8, 90.0, 0.0)
        assert (c.kind == "clean") == (repr(c.rig) == repr(c.plain) and not c.law)


def test_an_effect_that_the_datasheet_tells_is_not_withheld() -> None:
    given = Given(reference_datasheet())
    hidden = {name for k in range(60) for name, _ in draw(k, 5, given).effects}
    told = tuple((name, ()) for name in sorted(hidden) if name in ("loop_delay", "sensor_lag", "sensor_gain", "runout"))
    assert told
    twin = Given(replace(given.datasheet, effects=told))
    assert not {n for n, _ in told} & {name for k in range(60) for name, _ in draw(k, 5, twin).effects}


def test_a_rig_of_two_axes_gets_what_it_can_have() -> None:
    given = Given(replace(plane_datasheet(), modes=(MODE,)))
    cases = [draw(k, 3, given) for k in range(30)]
    assert all(c.rig.axes == ("xA", "xB") for c in cases)
    assert "unequal_planes" not in {c.law for c in cases}


@pytest.mark.parametrize("sheet", [reference_datasheet(), replace(plane_datasheet(), modes=(MODE,))])
def test_planes_are_not_unequal_where_nothing_could_be(sheet: Datasheet) -> None:
    """A law that leaves the rig as it is would be a clean rig that counts as one with a law."""
    with pytest.raises(EffectError, match="no modes in a second plane"):
        UNLISTED["unequal_planes"](Given(sheet).rig(), np.random.default_rng(0))


def test_a_given_rig_that_does_not_levitate_is_told_as_that() -> None:
    sheet = replace(reference_datasheet(), numerator=tuple(0.1 * b for b in reference_datasheet().numerator))
    with pytest.raises(LevitationError):
        draw(1, 1, Given(sheet))


@pytest.mark.parametrize("given", [None, Given(replace(reference_datasheet(), modes=(MODE,)), speed_rad_s=70.0)])
def test_a_case_comes_out_of_its_sealed_truth_again(given: Given | None) -> None:
    for number in range(8):
        case = draw(number, 11, given)
        again = redrawn(json.loads(json.dumps(case.truth())))
        assert (repr(again.rig), repr(again.plain)) == (repr(case.rig), repr(case.plain))
        assert (type(again.tampering), vars(again.tampering)) == (type(case.tampering), vars(case.tampering))
        assert again.datasheet == case.datasheet


def test_a_truth_of_another_version_is_not_taken_for_its_redrawn_case() -> None:
    truth = draw(0, 2).truth()
    with pytest.raises(AmbError, match="comes out otherwise"):
        redrawn(truth | {"parameters": {}})
    with pytest.raises(AmbError, match="seed"):
        redrawn({k: v for k, v in truth.items() if k != "seed"})


def test_a_simulation_keeps_its_law_to_itself() -> None:
    """Two campaigns on one case meet the same law from its beginning."""
    case = next(c for c in (draw(k, 1) for k in range(100)) if c.law == "held_log")
    one, other = case.simulation(0), case.simulation(0)
    r = np.zeros((50, 4))
    one.advance(r[:7])
    np.testing.assert_array_equal(other.advance(r).y, case.simulation(0).advance(r).y)
