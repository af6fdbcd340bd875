"""Any shares that four axes may have of an effect are told by its three shapes, and those of two by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.imbalance import DIAGONAL, NAMES, of_shares, shares
from sim.reference import reference_rig

RIG = reference_rig()
SHAPE = st.floats(-1.0, 1.0)
SHARE = st.one_of(st.just(0.0), st.floats(0.01, 1.0))


@given(of_axes=st.lists(SHARE, min_size=4, max_size=4).filter(any))
def test_shares_of_four_axes_are_told_and_found_again(of_axes: list[float]) -> None:
    found = shares(RIG, of_shares(dict(zip(RIG.axes, of_axes, strict=True))))
    assert found == pytest.approx(np.array(of_axes) / np.mean(of_axes), abs=1e-6)


@given(end=SHAPE, plane=SHAPE, diagonal=SHAPE)
def test_no_axis_has_a_negative_share_and_their_mean_is_one(end: float, plane: float, diagonal: float) -> None:
    of_axes = shares(RIG, {NAMES[0]: end, NAMES[1]: plane, DIAGONAL: diagonal})
    assert of_axes.min() >= 0
    assert of_axes.mean() == pytest.approx(1.0)


@given(end=SHAPE, plane=SHAPE)
def test_without_a_diagonal_the_ends_are_alike_in_both_planes(end: float, plane: float) -> None:
    of_axes = dict(zip(RIG.axes, shares(RIG, dict(zip(NAMES, (end, plane), strict=True))), strict=True))
    assert of_axes["xA"] * of_axes["yB"] == pytest.approx(of_axes["xB"] * of_axes["yA"], abs=1e-12)


def test_a_plane_that_is_alone_has_ends_only() -> None:
    assert of_shares({"xA": 3.0, "xB": 1.0}) == {NAMES[0]: 0.5, NAMES[1]: 0.0, DIAGONAL: 0.0}
