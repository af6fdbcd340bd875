"""What noise keeps ringing in loops with many modes."""

from __future__ import annotations

import numpy as np

from service.identification.measured.points import plane_points
from service.identification.ringing.leakage import leakage
from tests.support.planes import plane_model_of, synthetic_sweep
from tests.support.whole_rigs import levitating

AXES = ("xA", "xB")


def test_it_is_a_covariance() -> None:
    """Six modes at 25 kHz, one of which the loop hardly damps: its powers keep no digit of the small states."""
    _, rig, _, _ = next(levitating([69]))
    law = (rig.controller.numerator, rig.controller.denominator)
    truth = plane_model_of(rig, "x")
    theta = truth.theta.copy()
    theta[truth.layout.mode(5).start + 1] = 10.0
    sweep = synthetic_sweep({"x": truth}, AXES, law, np.geomspace(10, 1000, 60), 0.05)
    points = plane_points(sweep, AXES, "x")
    found = leakage(points, truth.at(theta), law, np.full(len(points.omega), 0.3), np.full(2, 20e-9))
    assert found is not None
    flat = found.reshape(len(found), found.shape[1] * found.shape[2], -1)
    size = np.sqrt(np.einsum("pnn->pn", flat).real)
    correlation = flat / size[:, :, None] / size[:, None, :]
    assert np.allclose(correlation, correlation.conj().transpose(0, 2, 1))
    assert np.linalg.eigvalsh(correlation).min() > -1e-6
