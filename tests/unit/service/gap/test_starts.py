"""Where a fit of a resonance begins."""

import numpy as np

from service.gap.nuisance import nuisance
from service.gap.observation import observe
from service.gap.part import Ground, parts
from service.gap.predict import residual
from service.gap.starts import starts
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig


def test_a_mode_between_two_lines_begins_near_its_frequency_and_shape() -> None:
    """Its ends move against each other, which no housing does, and it is far narrower than the lines are apart."""
    datasheet, truth = known_datasheet(seed=12)
    nu = nuisance(datasheet)
    shape = {"bearing_A": 0.017, "bearing_B": -0.019, "sensor_A": 0.017, "sensor_B": -0.015}
    values = {"frequency_hz": 145.0, "damping_ratio": 0.0016, **{f"{k}_per_sqrt_kg": v for k, v in shape.items()}}
    o = observe(sweep(with_effects(true_rig(truth), {"extra_flexible_mode": values}), lines(), 0.15, seed=1), nu.rig)
    assert np.abs(o.frequency_hz / 145.0 - 1).min() > 0.02
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    left = residual(nu.rig, o)[..., 2 * nu.rig.n_axes :]
    first, *_ = starts(CATALOGUE["extra_flexible_mode"], nu.rig, left, o, ground)
    assert abs(first["frequency_hz"] / 145.0 - 1) < 0.1
    found, true = (np.array([v[f"{k}_per_sqrt_kg"] for k in shape]) for v in (first, values))
    assert abs(found @ true) > 0.8 * np.linalg.norm(found) * np.linalg.norm(true)
