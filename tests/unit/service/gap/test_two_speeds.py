"""Sweeps at two speeds tell what goes with the speed."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.gap.diagnose import diagnose
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

pytestmark = pytest.mark.slow

LOW_HZ = np.geomspace(10.0, 300.0, 16)


def test_a_seal_whose_fluid_the_rotor_carries_round_is_told_with_what_each_speed_adds() -> None:
    """Held against one stiffness for both speeds it was none of the known effects."""
    datasheet, truth = known_datasheet(seed=61)
    rig = with_effects(
        true_rig(truth), {"cross_coupled_stiffness": {"stiffness_n_per_m": 0.0, "by_speed_ns_per_m": 500.0}}
    )
    fast, slow = (replace(rig, speed_rad_s=speed) for speed in (300.0, 100.0))
    sweeps = (
        replace(sweep(fast, LOW_HZ, 0.15, 1), speed_rad_s=300.0, comment="main"),
        replace(sweep(slow, LOW_HZ * 1.07, 0.15, 2, during=(0.8, 1.0)), speed_rad_s=100.0, comment="another speed"),
    )
    d = diagnose(Experiment(rig.name, rig.axes, sweeps), datasheet)
    assert d.verdict.effects == ("cross_coupled_stiffness",)
    found = d.chosen.fit.values[0]
    assert found["by_speed_ns_per_m"] == pytest.approx(500.0, rel=0.1)
    assert found["stiffness_n_per_m"] == pytest.approx(0.0, abs=5e3)
    assert d.shrinkage.closure == pytest.approx(1.0, abs=0.1)


def with_runout(measured: Sweep, rig: Rig, amplitude_m: float, block_samples: int) -> Sweep:
    """The sweep with a sensors' signal once a turn in its closed loop, its phase going on from block to block."""
    hz, block_s = measured.speed_rad_s / (2 * np.pi), block_samples / measured.sample_rate_hz
    n, blocks = rig.n_axes, measured.Y.shape[1]
    loop = linear_model(rig, np.array([hz]))
    Y = np.linalg.solve(np.eye(n) + loop.y_per_u[0] * loop.controller[0], np.full(n, amplitude_m, dtype=complex))
    U = -loop.controller[0] * Y
    begun = np.exp(2j * np.pi * np.random.default_rng(3).random(measured.n_points))
    turned = begun[:, None] * np.exp(2j * np.pi * hz * block_s * np.arange(blocks))
    leak = np.sinc((measured.frequency_hz[:, None] * np.array(measured.harmonics) - hz) * block_s)
    leak[:, 0] = 0.0
    added = turned[:, :, None, None] * leak[:, None, :, None]
    assert measured.I is not None
    return replace(
        measured,
        U=measured.U + added * U,
        I=measured.I + added * (loop.i_per_u[0] @ U),
        Y=measured.Y + added * Y,
        block_samples=np.full(measured.n_points, block_samples),
    )


def test_runout_of_a_rotor_that_stood_still_in_the_main_sweep_is_named() -> None:
    """It was none of the known effects: what the other sweep alone shows was searched for in the main one."""
    datasheet, truth = known_datasheet(seed=62)
    rig, speed = true_rig(truth), 2 * np.pi * 60.0  # the mains would sound the same
    lines = np.geomspace(20.0, 400.0, 20)
    main = replace(sweep(rig, lines, 0.15, 1), comment="main", block_samples=np.full(80, 630))
    other = replace(sweep(rig, lines * 1.03, 0.15, 2, during=(0.8, 1.0)), speed_rad_s=speed, comment="another speed")
    d = diagnose(Experiment(rig.name, rig.axes, (main, with_runout(other, rig, 5e-7, 630))), datasheet)
    assert (d.verdict.effects, d.where.path) == (("runout",), "additive")
    assert d.chosen.fit.values[-1]["amplitude_m"] == pytest.approx(5e-7, rel=0.05)
    assert d.shrinkage.closure == pytest.approx(1.0, abs=0.1)
