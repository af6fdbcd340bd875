"""Hysteresis of a few plays that are far apart, as models of iron have, which no even density describes."""

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from sim.actuator import PLAY_EDGES
from sim.effects.magnetic_hysteresis import DENSITIES
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

BIAS_A = 2.75


def few_plays(*half_widths_a: float, strength_a: float) -> dict[str, float]:
    """Values of hysteresis with plays about these half widths, alike in what each adds, A."""
    edges = BIAS_A * PLAY_EDGES
    at = np.searchsorted(edges, half_widths_a) - 1
    return {
        "loss_angle_rad": 5e-4,
        "widest_inverse_per_a": 50.0,
        **{DENSITIES[k]: strength_a / (edges[k + 1] - edges[k]) for k in at},
    }


def test_plays_far_apart_are_hysteresis_and_close_the_gap_at_another_amplitude() -> None:
    """An even density leaves a twentieth of it, which eddy currents were named for."""
    datasheet, truth = known_datasheet(seed=4)
    iron = few_plays(0.013, 0.07, 0.3, strength_a=0.8)
    rig = with_effects(true_rig(truth), {"magnetic_hysteresis": iron})
    report = gap_document(diagnose(*one_plane(experiment(rig, amplitude_a=0.2), datasheet)))
    assert report["verdict"]["effects"] == ["magnetic_hysteresis"]
    assert report["shrinkage"]["closure"] > 0.95
