"""A plane measured alone does not show what couples it to the other; what looks like it is not named for certain."""

import pytest

from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.doubts.across import across_alike
from service.gap.judged import with_across
from service.gap.weighing.verdict import Verdict
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane
from tests.unit.service.gap.where.test_dependence import plant

DATASHEET, TRUTH = known_datasheet(seed=3)


def test_a_coupling_of_the_planes_is_among_the_causes_that_one_plane_cannot_tell_apart() -> None:
    coupled = with_effects(true_rig(TRUTH), {"magnetic_cross_coupling": {"rotation_rad": 0.04}})
    report = gap_document(diagnose(*one_plane(experiment(coupled), DATASHEET)))
    verdict = report["verdict"]
    assert any("magnetic_cross_coupling" in group for group in verdict["indistinguishable"]), verdict
    assert "magnetic cross coupling" in verdict["sentence"]


def test_four_axes_show_what_couples_them() -> None:
    assert across_alike(plant("linear")[0]) == []


@pytest.mark.parametrize("kind", ["none_of_these", "no_gap", "effect"])
def test_nothing_is_added_where_nothing_looks_alike(kind: str) -> None:
    verdict = Verdict(kind, (), (), 0.9, ())
    assert with_across(verdict, []) is verdict
