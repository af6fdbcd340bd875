"""The controller that runs is not the datasheet's: other gain, integral, derivative, lag or filters, or some axes'."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim import control_law
from sim.effect import Effect, Parameter
from sim.imbalance import parameters, shares
from sim.rig import Array, ControlLaw, Rig

CANCELS = 1e-9
"""Remainder of the numerator over a factor, relative to its coefficients, up to which the factor is in it."""
OSCILLATES = 1e-6
"""Imaginary part of a pole or zero, over its size, from which it is one of a filter."""


def corners_rad_s(law: ControlLaw) -> tuple[float, float]:
    """Where C lags by 45 degrees, and where it leads by 45 degrees, rad/s.

    There the integral and the derivative part are as large as the proportional. Of a PID they are nearly the sizes of
    its two zeros, which are taken where they are real. A controller that never leads has no derivative part, one that
    never lags no integral part; a hundredth and a ten-thousandth of its sample rate stand in.
    """
    rate = 2 * math.pi / law.sample_time_s
    omega = rate * np.geomspace(1e-7, 0.4, 1000)
    phase = np.angle(control_law.response(law, omega))
    lags, leads = np.flatnonzero(phase > -math.pi / 4), np.flatnonzero(phase >= math.pi / 4)
    zeros = _real_zeros_rad_s(law)

    def refined(corner: float) -> float:
        """The zero within an octave of a corner, or the corner itself."""
        near = [z for z in zeros if 0.5 < z / corner < 2.0]
        return min(near, key=lambda z: abs(math.log(z / corner)), default=corner)

    lag = refined(float(omega[lags[0]])) if len(lags) and lags[0] > 0 else rate * 1e-4
    return lag, refined(float(omega[leads[0]])) if len(leads) else rate * 1e-2


def _real_zeros_rad_s(law: ControlLaw) -> list[float]:
    """The sizes of the stable real zeros of C, by Tustin's rule."""
    roots = np.roots(law.numerator).astype(complex)
    real = roots.real[np.abs(roots.imag) < OSCILLATES * np.abs(roots)]
    return [float(2 * (1 - z) / (1 + z) / law.sample_time_s) for z in real if 0.0 < z < 1.0]


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


def _parts_changed(
    b: Array, a: Array, half: tuple[float, float], integral: float, derivative: float
) -> tuple[Array, Array]:
    """C (1 + (i wi wd + d s^2) / ((s + wi)(s + wd))) by Tustin's rule; ``half`` holds wi T/2 and wd T/2.

    Of a PID, with its zeros at wi and wd, this changes the integral and the derivative part alone. A pole there cancels
    a zero of C, and neither is written: a loop with both has eigenvalues that coincide.
    """
    factors = [np.array([1.0 + h, h - 1.0]) for h in half]
    more = integral * half[0] * half[1] * np.array([1.0, 2.0, 1.0]) + derivative * np.array([1.0, -2.0, 1.0])
    changed = np.polymul(*factors) + more
    for factor in factors:
        without, rest = np.polydiv(b, factor)
        if np.abs(rest).max() < CANCELS * np.abs(b).max():
            b = without
        else:
            a = np.polymul(a, factor)
    return np.polymul(b, changed) / a[0], a / a[0]


def _changed(law: ControlLaw, half: tuple[float, float], p: Mapping[str, float], share: float) -> tuple[Array, Array]:
    """Numerator and denominator of a controller that changes by a share of the effect."""
    b, a = np.asarray(law.numerator, dtype=float), np.asarray(law.denominator, dtype=float)
    changes = {
        name: share * p[name] for name in ("filter_frequency_change", "zero_damping_change", "pole_damping_change")
    }
    if any(changes.values()):
        frequency_change, of_zeros, of_poles = changes.values()
        b, a = _tuned(b, frequency_change, of_zeros), _tuned(a, frequency_change, of_poles)
    if p["derivative_change"] or p["integral_change"]:
        b, a = _parts_changed(b, a, half, share * p["integral_change"], share * p["derivative_change"])
    if p["lag_samples"]:
        # (1 - d) + d / z: dc gain one, a delay of d samples at low frequency
        late = share * p["lag_samples"]
        b, a = np.polymul(b, [1.0 - late, late]), np.polymul(a, [1.0, 0.0])
    return (1 + share * p["gain_change"]) * b, a


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    law, of_axes = rig.controller, shares(rig, p)
    lag, lead = corners_rad_s(law) if p["derivative_change"] or p["integral_change"] else (0.0, 0.0)
    half = (lag * law.sample_time_s / 2, lead * law.sample_time_s / 2)
    b, a = _changed(law, half, p, 1.0)
    laws = law.apart or ((law.numerator, law.denominator),) * rig.n_axes
    apart = tuple(
        _changed(replace(law, numerator=num, denominator=den), half, p, share)
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
            "integral_change",
            "1",
            -1.0,
            3.0,
            0.0,
            0.0,
            description="relative change of the integral part",
            strength=False,
            optional=True,
            dormant=True,
            wakes=(0.1,),
        ),
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
    law="C'(z) = (1 + g) C(z) (1 + (i wi wd + d s^2)/((s + wi)(s + wd))) ((1 - l) + l/z), C lags by 45 degrees at wi "
    "and leads by 45 degrees at wd; of the filters in C, "
    "its complex poles and zeros, frequencies (1 + f) and damping ratios (1 + za), (1 + zb); where some axes change "
    "more, each change in proportion to (1 +- e)(1 +- p), + at A, + in x",
    signature="U - R + C Y is not nil and is proportional to C Y; i/u and y/i are as before",
    aliases=("logging_offset",),
    separated_by="an offset of the log turns U by exactly n T w at any frequency, a mismatch turns and scales C Y only",
    source="Aström and Murray, Feedback Systems, Princeton 2008, section 10.5 (implementation of PID)",
)
