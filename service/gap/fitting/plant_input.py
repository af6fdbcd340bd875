"""What drives the plant, and what is not known of it: that is uncertainty of the displacement.

The displacement is measured so much better than the current that an error of the amplifiers' model, which the current
hardly shows, would be an effect of the plant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.predict import current
from service.gap.measured.observation import Observation
from sim.harmonic_balance import STATIC_HZ
from sim.rig import Rig
from sim.twin import LinearModel, axis_current_per_control, linear_model

Real = NDArray[np.float64]

BETWEEN_SAMPLES = 3.0
"""What may hide between the samples of a current, over the images of the hold that a model of its amplifiers has there:
regulators in discrete time, at twice the controller's rate, had 2.6 times those of the model fitted to them."""


@dataclass(frozen=True)
class LawError:
    """By how much effects of the amplifiers miss their current: a share of all that they change of it.

    The rig's law may be another than the catalogue's: a regulator in discrete time, a voltage that ends in a clamp.
    """

    plain: Rig
    """the plain twin, fitted to the amplifiers"""
    found: Rig
    """the twin with their effects"""
    share: float
    """of the gap's chi-square that the effects leave"""

    def on(self, o: Observation) -> Observation:
        """The sweep with that error of the current as uncertainty of its displacement."""
        missed = self.share * np.abs(current(self.found, o) - current(self.plain, o)) ** 2
        return _with_uncertain_current(self.found, o, missed)


def driven_by_current(rig: Rig, o: Observation) -> Observation:
    """The observation with u replaced by the one from which ``rig`` would make the measured current.

    Fitting y to it is fitting the plant alone, whatever the amplifiers do. The noise of the current then adds to that
    of y, so where a model explains the amplifiers it is better to predict the current from u, which has no noise. So
    does what may hide between the current's samples: only a model of the amplifiers tells that, and none is known.
    """
    assert o.I is not None
    U, uncertain = o.U.copy(), o.sd_i**2
    for k, h in enumerate(o.harmonics):
        model, frequency_hz = _model(rig, o, h)
        U[:, k] = np.linalg.solve(model.i_per_u[o.line], o.I[:, k, :, None])[..., 0]
        baseband = model.held * model.log_phase[:, None]
        images = axis_current_per_control(rig, frequency_hz) / baseband - 1
        uncertain[:, k] += np.abs(BETWEEN_SAMPLES * images[o.line] * o.I[:, k]) ** 2
    return replace(_with_uncertain_current(rig, o, uncertain), U=U)


def _with_uncertain_current(rig: Rig, o: Observation, power: Real) -> Observation:
    """The observation whose displacement is uncertain by an error of the current, of mean square ``power``, A2.

    ``power`` has the shape of the current, (P, H, n).
    """
    sd_y = o.sd_y.copy()
    for k, h in enumerate(o.harmonics):
        of_current = np.abs(_model(rig, o, h)[0].y_per_i[o.line]) ** 2 @ power[:, k, :, None]
        sd_y[:, k] = np.sqrt(sd_y[:, k] ** 2 + of_current[..., 0])
    return replace(o, sd_y=sd_y)


def _model(rig: Rig, o: Observation, harmonic: int) -> tuple[LinearModel, Real]:
    """Responses at a harmonic of the lines, and its frequencies, Hz, (F,)."""
    frequency_hz = np.maximum(harmonic * o.frequency_hz, STATIC_HZ)
    return linear_model(rig, frequency_hz), frequency_hz
