"""The controller that runs is not the one of the datasheet: other gain, other derivative, other lag."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim import control_law
from sim.effect import Effect, Parameter
from sim.rig import ControlLaw, Rig


def derivative_corner_rad_s(law: ControlLaw) -> float:
    """Frequency where C starts to lead by 45 degrees, that is, where its derivative part equals the proportional.

    A controller that never leads has no derivative part; a hundredth of its sample rate stands in.
    """
    omega = 2 * math.pi * np.geomspace(1e-4, 0.4, 400) / law.sample_time_s
    leads = np.flatnonzero(np.angle(control_law.response(law, omega)) >= math.pi / 4)
    return float(omega[leads[0]]) if len(leads) else 2 * math.pi * 0.01 / law.sample_time_s


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    law = rig.controller
    b, a = np.asarray(law.numerator, dtype=float), np.asarray(law.denominator, dtype=float)
    if p["derivative_change"]:
        # C (1 + d s / (s + wc)) by Tustin's rule: of a PID, this changes the derivative part alone.
        half = derivative_corner_rad_s(law) * law.sample_time_s / 2
        pole = np.array([1.0, -(1 - half) / (1 + half)])
        high_pass = p["derivative_change"] / (1 + half) * np.array([1.0, -1.0])
        b, a = np.polymul(b, pole + high_pass), np.polymul(a, pole)
    if p["lag_samples"]:
        # (1 - d) + d / z: dc gain one, a delay of d samples at low frequency
        b, a = np.polymul(b, [1.0 - p["lag_samples"], p["lag_samples"]]), np.polymul(a, [1.0, 0.0])
    return replace(rig, controller=replace(law, numerator=(1 + p["gain_change"]) * b, denominator=a))


EFFECT = Effect(
    id="controller_mismatch",
    path="controller",
    parameters=(
        Parameter("gain_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the whole C"),
        Parameter("derivative_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the derivative part"),
        Parameter("lag_samples", "samples", -0.5, 0.5, 0.05, 0.0, description="share of the sample before"),
    ),
    apply=_apply,
    law="C'(z) = (1 + g) C(z) (1 + d s/(s + wc)) ((1 - l) + l/z), wc where C leads by 45 degrees",
    signature="U - R + C Y is not nil and is proportional to C Y; i/u and y/i are as before",
    aliases=("logging_offset",),
    separated_by="an offset of the log turns U by exactly n T w at any frequency, a mismatch turns and scales C Y only",
    source="Aström and Murray, Feedback Systems, Princeton 2008, section 10.5 (implementation of PID)",
)
