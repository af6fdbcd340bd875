"""How well the closed loop of an identified plane and its controller predicts the measured one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Real
from service.identification.loop.margins import computed_response, sensitivity
from service.identification.measured.etfe import SingularInputError, etfe
from service.identification.measured.known import computed
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel
from service.identification.statistics.validation import nrmse_percent


@dataclass(frozen=True)
class Predicted:
    """The measured closed loop against the one that model and controller predict: NRMSE, percent, (2, 2) each.

    Rows are outputs, columns excited axes. The published figure of a real rig is 97.9 %.
    """

    u_percent: Real
    """r -> u, the sensitivity."""
    y_percent: Real
    """r -> y."""


def predicted_closed_loop(model: PlaneModel, controller: tuple[Real, Real], points: PlanePoints) -> Predicted | None:
    """Fit of the predicted closed loop; None where r cannot tell the axes apart.

    Parameters
    ----------
    points
        Measured with ``controller`` running; best of a sweep that the model was not made from.
    """
    points = computed(points, model.known.chain)
    try:
        u, y = etfe(points, "r->u"), etfe(points, "r->y")
    except SingularInputError:
        return None
    s = sensitivity(model, controller, u.omega)
    t = np.asarray(computed_response(model, u.omega) @ s)
    fits = [
        np.array([[nrmse_percent(m.value[:, a, b], p[:, a, b]) for b in range(2)] for a in range(2)])
        for m, p in ((u, s), (y, t))
    ]
    return Predicted(fits[0], fits[1])
