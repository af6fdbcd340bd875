"""The controller that runs is not the datasheet's: other gain, integral, derivative, lag or filters, or some axes'."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polydiv
from numpy.typing import NDArray

from sim import control_law
from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Array, ControlLaw, Rig

Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

CANCELS = 1e-9
"""Remainder of the numerator over a factor, relative to its coefficients, up to which the factor is in it."""
OSCILLATES = 1e-6
"""Imaginary part of a pole or zero, over its size, from which it is one of a filter."""
SAME_NOTCH = 3.0
"""Ratio of the frequencies of a notch's zeros and poles, at most."""
INTEGRATES = 0.999
"""Real pole from which it is an integrator's, leaky ones included: 1.6 Hz at 10 kHz."""
OF_FILTERS = {
    "notch_frequency_change": (
        (0.02, -0.02),
        -0.4,
        0.6,
        "frequencies of the notches in C, its complex zeros and their poles",
    ),
    "lowpass_frequency_change": (
        (0.02,),
        -0.4,
        0.6,
        "frequencies of the low-pass filters in C, its other complex poles",
    ),
    "rolloff_frequency_change": (
        (0.02,),
        -0.6,
        2.0,
        "frequencies at which C rolls off, its real poles without integrators",
    ),
    "notch_zero_damping_change": ((0.02,), -0.9, 3.0, "damping ratios of the notches' zeros"),
    "notch_pole_damping_change": ((0.02,), -0.9, 3.0, "damping ratios of the notches' poles"),
    "lowpass_damping_change": ((0.02,), -0.9, 3.0, "damping ratios of the low-pass filters"),
}
"""Relative changes of filters: where fits of each start, its range, and of what it is."""

ADDED = (("filter_low_change", "far below"), ("filter_mid_change", "at"), ("filter_high_change", "far above"))
"""Changes of gain by a filter that is not in C, and where it has each, as seen from its frequency."""


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


def _tuned(law_b: Array, law_a: Array, c: Mapping[str, float]) -> tuple[Array, Array]:
    """Numerator and denominator of C with its filters tuned otherwise; each keeps its value at z = 1.

    By Tustin's rule a root is s = 2/T (z - 1)/(z + 1); its size and its damping ratio change.
    """
    zeros, poles = np.roots(law_b).astype(complex), np.roots(law_a).astype(complex)
    of_notch, rolls_off = _of_notch(zeros, poles), _rolls_off(poles)
    lowpass = _oscillates(poles) & ~of_notch
    notch, low = (c["notch_frequency_change"], c["lowpass_frequency_change"])
    new_zeros = _moved(zeros, _oscillates(zeros), notch, c["notch_zero_damping_change"])
    new_poles = _moved(poles, of_notch, notch, c["notch_pole_damping_change"])
    new_poles = _moved(new_poles, lowpass, low, c["lowpass_damping_change"])
    new_poles = _moved(new_poles, rolls_off, c["rolloff_frequency_change"], 0.0)
    return _polynomial(law_b, zeros, new_zeros), _polynomial(law_a, poles, new_poles)


def _polynomial(former: Array, roots: Complex, moved: Complex) -> Array:
    """A polynomial in z with moved roots, and the value of the former one at z = 1."""
    still = moved == roots
    kept = float(np.prod((1 - roots[~still]) / (1 - moved[~still])).real)
    return np.asarray(former[0] * kept * np.poly(moved).real)


def _oscillates(roots: Complex) -> Mask:
    """Which roots are complex: those of filters."""
    return np.asarray(np.abs(roots.imag) > OSCILLATES * np.abs(roots))


def _of_notch(zeros: Complex, poles: Complex) -> Mask:
    """Which poles belong to notches: to each pair of complex zeros the complex poles that are nearest in frequency."""
    size, taken = np.abs((poles - 1) / (poles + 1)), np.zeros(len(poles), dtype=bool)
    for zero in zeros[_oscillates(zeros) & (zeros.imag > 0)]:
        free = np.flatnonzero(_oscillates(poles) & (poles.imag > 0) & ~taken)
        away = np.abs(np.log(size[free] / np.abs((zero - 1) / (zero + 1))))
        if len(free) and away.min() < np.log(SAME_NOTCH):
            pole = poles[free[away.argmin()]]
            taken |= np.isclose(poles, pole) | np.isclose(poles, pole.conjugate())
    return taken


def _rolls_off(poles: Complex) -> Mask:
    """Which poles are real and no integrator's: those at which the derivative part rolls off."""
    return np.asarray(~_oscillates(poles) & (poles.real > 0.0) & (poles.real < INTEGRATES))


def _moved(roots: Complex, which: Mask, frequency_change: float, damping_change: float) -> Complex:
    """The roots, some of them with another frequency and another damping ratio."""
    if not (frequency_change or damping_change):
        return roots
    s = (roots[which] - 1) / (roots[which] + 1)
    damping = np.minimum(-s.real / np.abs(s) * (1 + damping_change), 1.0)
    turned = -damping + 1j * np.sign(s.imag) * np.sqrt(1 - damping**2)
    moved = (1 + frequency_change) * np.abs(s) * turned
    out = roots.copy()
    out[which] = (1 + moved) / (1 - moved)
    return out


def _parts_changed(
    b: Array, a: Array, half: tuple[float, float], integral: float, derivative: float
) -> tuple[Array, Array]:
    """C (1 + (i wi wd + d s^2) / ((s + wi)(s + wd))) by Tustin's rule; ``half`` holds wi T/2 and wd T/2.

    Of a PID, with its zeros at wi and wd, this changes the integral and the derivative part alone. A pole there cancels
    a zero of C, and neither is written: a loop with both has eigenvalues that coincide.
    """
    factors = [np.array([1.0 + h, h - 1.0]) for h in half]
    more = integral * half[0] * half[1] * np.array([1.0, 2.0, 1.0]) + derivative * np.array([1.0, -2.0, 1.0])
    lag, lead = factors
    changed = np.convolve(lag, lead) + more
    for factor in factors:
        without, rest = polydiv(b[::-1], factor[::-1])
        if np.abs(rest).max() < CANCELS * np.abs(b).max():
            b = without[::-1]
        else:
            a = np.convolve(a, factor)
    return np.convolve(b, changed) / a[0], a / a[0]


def _filtered(b: Array, a: Array, period_s: float, p: Mapping[str, float], share: float) -> tuple[Array, Array]:
    """C behind 1 + (h s^2 + 2 z w m s + l w^2)/(s^2 + 2 z w s + w^2) by Tustin's rule.

    Notches, low-pass filters, leads and lags are of this form: a notch has l = h = 0, a low-pass filter m = h = -1.
    """
    k, w = 2 / period_s, 2 * math.pi * p["filter_frequency_hz"]
    parts = (
        w**2 * np.array([1.0, 2.0, 1.0]),
        2 * p["filter_damping_ratio"] * w * k * np.array([1.0, 0.0, -1.0]),
        k**2 * np.array([1.0, -2.0, 1.0]),
    )
    below = sum(parts, np.zeros(3))
    above = below + sum((share * p[name] * part for (name, _), part in zip(ADDED, parts, strict=True)), np.zeros(3))
    return np.convolve(b, above) / below[0], np.convolve(a, below) / below[0]


def _changed(law: ControlLaw, half: tuple[float, float], p: Mapping[str, float], share: float) -> tuple[Array, Array]:
    """Numerator and denominator of a controller that changes by a share of the effect."""
    b, a = np.asarray(law.numerator, dtype=float), np.asarray(law.denominator, dtype=float)
    changes = {name: share * p[name] for name in OF_FILTERS}
    if any(changes.values()):
        b, a = _tuned(b, a, changes)
    if any(p[name] for name, _ in ADDED):
        b, a = _filtered(b, a, law.sample_time_s, p, share)
    if p["derivative_change"] or p["integral_change"]:
        b, a = _parts_changed(b, a, half, share * p["integral_change"], share * p["derivative_change"])
    if p["lag_samples"]:
        # (1 - d) + d / z: dc gain one, a delay of d samples at low frequency
        late = share * p["lag_samples"]
        b, a = np.convolve(b, [1.0 - late, late]), np.convolve(a, [1.0, 0.0])
    return (1 + share * p["gain_change"]) * b, a


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    law, of_axes = rig.controller, shares(rig, p)
    lag, lead = corners_rad_s(law) if p["derivative_change"] or p["integral_change"] else (0.0, 0.0)
    half = (lag * law.sample_time_s / 2, lead * law.sample_time_s / 2)
    b, a = _changed(law, half, p, 1.0)
    if not law.apart and np.all(of_axes == of_axes[0]):
        return replace(rig, controller=replace(law, numerator=b, denominator=a, apart=()))
    laws = law.apart or ((law.numerator, law.denominator),) * rig.n_axes
    apart = tuple(
        _changed(replace(law, numerator=num, denominator=den), half, p, share)
        for (num, den), share in zip(laws, of_axes.tolist(), strict=True)
    )
    return replace(rig, controller=replace(law, numerator=b, denominator=a, apart=apart))


def _of_filter(name: str, unit: str, low: float, high: float, null: float, description: str) -> Parameter:
    """A parameter of a filter that is not in C, held at ``null`` but where a fit starts with one.

    None is optional beside the others: without one of its gains, that of the whole C would change in its place.
    """
    scale: Literal["log", "linear"] = "log" if low > 0 else "linear"
    shape = rarely_needed(name, unit, low, high, null, scale, description, amount=scale == "linear")
    return replace(shape, optional=False)


EFFECT = Effect(
    id="controller_mismatch",
    path="controller",
    parameters=(
        Parameter(
            "gain_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the whole C, mean of all axes"
        ),
        Parameter("derivative_change", "1", -0.5, 1.0, 0.05, 0.0, description="relative change of the derivative part"),
        Parameter("lag_samples", "samples", -0.5, 0.5, 0.05, 0.0, description="share of the sample before"),
        rarely_needed(
            "integral_change",
            "1",
            -1.0,
            3.0,
            0.0,
            description="relative change of the integral part",
            amount=True,
            wakes=(0.1,),
        ),
        *(
            rarely_needed(
                name,
                "1",
                low,
                high,
                0.0,
                description=f"relative change of the {of_what}",
                amount=True,
                wakes=wakes,
            )
            for name, (wakes, low, high, of_what) in OF_FILTERS.items()
        ),
        *(
            _of_filter(
                name,
                "1",
                -1.0,
                9.0,
                0.0,
                f"relative change of gain by a filter that is not in C, {where} its frequency",
            )
            for name, where in ADDED
        ),
        _of_filter("filter_frequency_hz", "Hz", 0.2, 5e3, 100.0, "of that filter's poles"),
        _of_filter("filter_damping_ratio", "1", 0.03, 30.0, 0.7, "of that filter's poles, real ones above 1"),
        *parameters("controllers", dormant=True),
        of_diagonal("controllers"),
    ),
    apply=_apply,
    law="C'(z) = (1 + g) C(z) (1 + (i wi wd + d s^2)/((s + wi)(s + wd))) ((1 - l) + l/z), C lags by 45 degrees at wi "
    "and leads by 45 degrees at wd; of the notches in C (complex zeros and the poles nearest to them), its low-pass "
    "filters (other complex poles) and its roll-off (real poles), frequencies (1 + f) and damping ratios (1 + z), each "
    "of its own; behind a filter that is not in C, 1 + (h s^2 + 2 z w m s + l w^2)/(s^2 + 2 z w s + w^2); where some "
    "axes change more, each change in proportion to (1 +- e)(1 +- p), + at A, + in x",
    signature="U - R + C Y is not nil and is proportional to C Y; i/u and y/i are as before",
    aliases=("logging_offset",),
    separated_by="an offset of the log turns U by exactly n T w at any frequency, a mismatch turns and scales C Y only",
    source="Aström and Murray, Feedback Systems, Princeton 2008, section 10.5 (implementation of PID)",
)
