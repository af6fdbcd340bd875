"""Rigs of the reference rig's kind: some turn, and their datasheets are off as far as tolerances allow."""

import numpy as np

from sim.withheld.rigs import AT_SPEED, TOLERANCE, base_rig, datasheet_of


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
