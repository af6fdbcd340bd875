"""What a turning rotor shows in one line near a mode, each plane moving the other, is found there."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.gap.fitting.predict import weight
from service.gap.measured.observation import Observation, observe
from service.gap.weighing.significance import significance, whirling_alone_hz
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

DATASHEET, TRUTH = known_datasheet(seed=63)
RIG = true_rig(TRUTH)
SPEED_RAD_S = 600.0
LINES_HZ = np.array([*np.geomspace(15.0, 400.0, 12), 488.0, *np.geomspace(560.0, 800.0, 5)])
"""Of the lines of a quick check one comes near a mode."""
DAMPED = {"internal_damping": {"damping_ratio": 4e-3}}


def seen(rig: Rig, noise: float = 1.0, speed_rad_s: float = SPEED_RAD_S) -> tuple[np.ndarray, Observation]:
    """A sweep of a rig against the twin without its effects, weighted residuals (P, H, n), and its observation."""
    turning = replace(rig, speed_rad_s=speed_rad_s)
    o = observe(replace(sweep(turning, LINES_HZ, 0.15, 7, noise), speed_rad_s=speed_rad_s), RIG)
    expected = observe(sweep(RIG, LINES_HZ, 0.15, 7, 0.0), RIG)
    return (o.Y - expected.Y) * weight(o, "y"), o


def test_one_line_in_which_planes_move_one_another_oppositely_shows_alone() -> None:
    z, o = seen(with_effects(RIG, DAMPED))
    assert whirling_alone_hz(z, o) == pytest.approx(488.0)
    assert whirling_alone_hz(z, replace(o, speed_rad_s=0.0)) is None, "a rotor that stands still does not whirl"


def test_noise_and_a_peak_that_is_shifted_show_none() -> None:
    assert whirling_alone_hz(*seen(RIG)) is None
    modes = tuple(
        tuple(replace(m, natural_frequency_rad_s=1.004 * m.natural_frequency_rad_s) for m in p) for p in RIG.rotor.modes
    )
    z, o = seen(replace(RIG, rotor=replace(RIG.rotor, modes=modes)))
    assert np.abs(z).max() > 20.0, "the peak is somewhere else"
    assert whirling_alone_hz(z, o) is None


def test_planes_that_move_one_another_alike_are_no_whirl() -> None:
    """As sensors that are turned against the magnets by a little, or a shaft's stiffer plane between the axes."""
    z, o = seen(with_effects(RIG, {"magnetic_cross_coupling": {"rotation_rad": 0.0, "symmetric_share": 0.01}}))
    assert significance(z, o) > 5.0
    assert whirling_alone_hz(z, o) is None


@pytest.mark.slow
def test_the_shaft_s_own_damping_that_one_line_of_a_turning_check_shows_is_named() -> None:
    """The mean of its band hides it, and there was no gap."""
    rig = with_effects(RIG, DAMPED)
    fast = replace(rig, speed_rad_s=SPEED_RAD_S)
    main = replace(sweep(rig, np.sort([*LINES_HZ * 1.03, 491.0, 493.0, 495.0]), 0.15, 8), comment="main")
    other = replace(sweep(fast, LINES_HZ, 0.15, 9, during=(0.8, 1.0)), speed_rad_s=SPEED_RAD_S, comment="another speed")
    d = diagnose(Experiment(rig.name, rig.axes, (main, other)), DATASHEET)
    assert d.verdict.effects == ("internal_damping",)
    assert d.chosen.fit.values[0]["damping_ratio"] == pytest.approx(4e-3, rel=0.15)
