"""The controller that runs is not the one of the datasheet: other gain, derivative, lag or filters, or in some axes."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim import control_law
from sim.effect import Effect, Parameter
from sim.imbalance import parameters, shares
from sim.rig import Array, ControlLaw, Rig

OSCILLATES = 1e-6
"""Imaginary part of a pole or zero, over its size, from which it is one of a filter."""


def derivative_corner_rad_s(law: ControlLaw) -> float:
    """Frequency where C starts to lead by 45 degrees, that is, where its derivative part equals the proportional.

    A controller that never leads has no derivative part; a hundredth of its sample rate stands in.
    """
    omega = 2 * math.pi * np.geomspace(1e-4, 0.4, 400) / law.sample_time_s
    leads = np.flatnonzero(np.angle(control_law.response(law, omega)) >= math.pi / 4)
    return float(omega[leads[0]]) if len(leads) else 2 * math.pi * 0.01 / law.sample_time_s


def _tuned(polynomial: Array, frequency_change: float, damping_change: float) -> Array:
    """A polynomial in z whose complex roots are those of filters tuned otherwise; its value at z = 1 stays.

    By Tustin's rule a root is s = 2/T (z - 1)/(z + 1); its size and its damping ratio change.
    """
    roots = np.roots(polynomial).astype(complex)
    filters = np.abs(roots.imag) > OSCILLATES * np.abs(roots)
    s = (roots[filters] - 1) / (roots[filters] + 1)
    damping = np.minimum(-s.real / np.abs(s) * (1 + damping_change), 1.0)
    turned = -damping + 1j * np.sign(s.imag) * np.sqrt(1 - damping**2)
    moved = (1 + frequency_change) * np.abs(s) * turned
    tuned = roots.copy()
    tuned[filters] = (1 + moved) / (1 - moved)
    kept = float(np.prod((1 - roots[filters]) / (1 - tuned[filters])).real)
    return np.asarray(polynomial[0] * kept * np.poly(tuned).real)


def _changed(law: ControlLaw, corner_rad_s: float, p: Mapping[str, float], share: float) -> tuple[Array, Array]:
    """Numerator and denominator of a controller that changes by a share of the effect."""
    b, a = np.asarray(law.numerator, dtype=float), np.asarray(law.denominator, dtype=float)
    changes = {
        name: share * p[name] for name in ("filter_frequency_change", "zero_damping_change", "pole_damping_change")
    }
    if any(changes.values()):
        frequency_change, of_zeros, of_poles = changes.values()
        b, a = _tuned(b, frequency_change, of_zeros), _tuned(a, frequency_change, of_poles)
    if p["derivative_change"]:
        # C (1 + d s / (s + wc)) by Tustin's rule: of a PID, this changes the derivative part alone.
        half = corner_rad_s * law.sample_time_s / 2
        pole = np.array([1.0, -(1 - half) / (1 + half)])
        high_pass = share * p["derivative_change"] / (1 + half) * np.array([1.0, -1.0])
        b, a = np.polymul(b, pole + high_pass), np.polymul(a, pole)
    if p["lag_samples"]:
        # (1 - d) + d / z: dc gain one, a delay of d samples at low frequency
        late = share * p["lag_samples"]
        b, a = np.polymul(b, [1.0 - late, late]), np.polymul(a, [1.0, 0.0])
    return (1 + share * p["gain_change"]) * b, a


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    law, of_axes = rig.controller, shares(rig, p)
    corner = derivative_corner_rad_s(law) if p["derivative_change"] else 0.0
    b, a = _changed(law, corner, p, 1.0)
    laws = law.apart or ((law.numerator, law.denominator),) * rig.n_axes
    apart = tuple(
        _changed(replace(law, numerator=num, denominator=den), corner, p, share)
        for (num, den), share in zip(laws, of_axes.tolist(), strict=True)
    )
    even = not law.apart and np.all(of_axes == of_axes[0])
    return replace(rig, controller=replace(law, numerator=b, denominator=a, apart=() if even else apart))


EFFECT = Effect(
    id="controller_mismatch",
    path="controller",
    parameters=(
        Parameter(
            "gain_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the whole C, mean of all axes"
        ),
        Parameter("derivative_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the derivative part"),
        Parameter("lag_samples", "samples", -0.5, 0.5, 0.05, 0.0, description="share of the sample before"),
        Parameter(
            "filter_frequency_change",
            "1",
            -0.4,
            0.6,
            0.0,
            0.0,
            description="relative change of the frequencies of the filters in C, its complex poles and zeros",
            strength=False,
            optional=True,
            dormant=True,
            wakes=(0.02, -0.02),
        ),
        *(
            Parameter(
                f"{one}_damping_change",
                "1",
                -0.9,
                3.0,
                0.0,
                0.0,
                description=f"relative change of the damping ratios of the filters' {one}s",
                strength=False,
                optional=True,
                dormant=True,
                wakes=(0.02,),
            )
            for one in ("zero", "pole")
        ),
        *parameters("controllers", dormant=True),
    ),
    apply=_apply,
    law="C'(z) = (1 + g) C(z) (1 + d s/(s + wc)) ((1 - l) + l/z), wc where C leads by 45 degrees; of the filters in C, "
    "its complex poles and zeros, frequencies (1 + f) and damping ratios (1 + za), (1 + zb); where some axes change "
    "more, each change in proportion to (1 +- e)(1 +- p), + at A, + in x",
    signature="U - R + C Y is not nil and is proportional to C Y; i/u and y/i are as before",
    aliases=("logging_offset",),
    separated_by="an offset of the log turns U by exactly n T w at any frequency, a mismatch turns and scales C Y only",
    source="Aström and Murray, Feedback Systems, Princeton 2008, section 10.5 (implementation of PID)",
)
