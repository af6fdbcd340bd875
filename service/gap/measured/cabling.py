"""Do the channels of a log belong to the axes that they are written for: by the controller's law, and the amplifiers'.

u = r - C y is arithmetic, and i = A u is known to a few per cent. Where they fail with the channels as they are written
and hold with others, with another sign, or with conjugates, no effect is the cause, and nothing that is fitted is of
the rig.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from sim.harmonic_balance import time_points
from sim.rig import Rig
from sim.twin import LinearModel, linear_model

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

BROKEN, HOLDS = 0.2, 0.02
"""Share of a signal's power that a law leaves from which it does not hold, and up to which it does. A log that is a
sample off leaves 0.12 on rigs of two other programs, channels that are swapped or conjugate 0.3 and more; put in order
they leave less than 1e-6, and an amplifier's law 1e-4."""
FAR_BETTER = 0.05
"""Ratio of what conjugates leave to what the signals as written do, up to which these are conjugates."""
UNIT = 30.0
"""Factor from which a signal is not off, but in another unit, or is not there."""
ALIKE = (0.5, 2.0)
"""Ratio of two factors within which they are one."""
PRESENT = 0.01
"""Share of the power of u that r, or what the controller makes of y, must have to be told by it."""
OFF = 0.01
"""Relative error from which a scale is off: a controller computes, and converters are calibrated better than that."""
TINY = 1e-300
"""Power of a signal that is none, as a divisor."""
SAMPLES_OFF = range(-3, 4)
"""Samples that a logged u may be late."""
FEWEST = 8
"""Points that laws are held against."""


def wrong_channels(sweep: Sweep, rig: Rig, axes: Sequence[str], name: str) -> str | None:
    """Which channels of a sweep are swapped, have another sign or unit, or are conjugates, and by which law; or None.

    Parameters
    ----------
    sweep
        Excited points.
    rig
        The twin: its controller and its amplifiers count.
    """
    if sweep.n_points < FEWEST:
        return None
    wrong = next(_wrong(_log(sweep, rig, axes)), None)
    return None if wrong is None else f"{name}: {wrong}"


def other_law(sweep: Sweep, rig: Rig, axes: Sequence[str], name: str) -> list[str]:
    """That u of no axis is near what the datasheet's controller makes, in a sentence: it has another law, or lines.

    A log that is whole samples off is near it.
    """
    if sweep.n_points < FEWEST:
        return []
    log, each = _log(sweep, rig, axes), range(len(axes))
    left = [min(log.by_controller(k, k, k, samples_late=s)[1] for s in SAMPLES_OFF) for k in each]
    if min(left) < BROKEN:
        return []
    return [
        f"{name}: u of no axis is near what the datasheet's controller makes of r and y ({100 * min(left):.0f} % of "
        "its power is left): check frequency_hz, and the datasheet's sample_time_s, numerator and denominator"
    ]


def odd_scales(sweep: Sweep, rig: Rig, axes: Sequence[str], name: str) -> list[str]:
    """Channels that a factor brings in line with the law that they miss, a sentence each.

    An effect misses it otherwise at each frequency; a controller's gain alone looks like the scale of y. Factors that
    only a unit or a sign makes are for `wrong_channels`.
    """
    if sweep.n_points < FEWEST:
        return []
    return [f"{name}: {words}" for words in _scales(_log(sweep, rig, axes))]


def _log(sweep: Sweep, rig: Rig, axes: Sequence[str]) -> _Log:
    frequency, line = time_points(sweep.frequency_hz)
    return _Log(sweep, linear_model(rig, frequency), line, axes, rig.controller.sample_time_s)


class _Log:
    """Fundamentals (P, n) of a sweep, and what the laws make of them."""

    def __init__(
        self, sweep: Sweep, model: LinearModel, line: NDArray[np.int64], axes: Sequence[str], sample_time_s: float
    ) -> None:
        f = sweep.harmonic(1)
        self.axes = axes
        self.r, self.u, self.y = (x[:, :, f].mean(axis=1) for x in (sweep.R, sweep.U, sweep.Y))
        self.i = None if sweep.I is None else sweep.I[:, :, f].mean(axis=1)
        self.late = model.log_phase[line]
        self.one_sample_late = np.exp(-2j * np.pi * sweep.frequency_hz * sample_time_s)
        self.controllers = -model.controllers[line]
        self.amplifiers = np.diagonal(model.i_per_u, axis1=1, axis2=2)[line]

    def by_controller(
        self, k: int, of_r: int, of_y: int, conjugate: str = "", samples_late: int = 0
    ) -> tuple[Real, float]:
        """Factors of r and of what the controller makes of y that make u of axis ``k``, and the share that is left.

        ``conjugate`` has the signals that are taken as conjugates; u is taken ``samples_late`` later than logged.
        """
        late = self.late * self.one_sample_late**samples_late
        u = late * (self.u[:, k].conj() if "u" in conjugate else self.u[:, k])
        y = self.y[:, of_y].conj() if "y" in conjugate else self.y[:, of_y]
        return _made_of(u, np.stack([self.r[:, of_r], self.controllers[:, of_y] * y], axis=1))

    def by_amplifier(self, k: int, of_u: int, conjugate: bool = False) -> tuple[float, float]:
        """The same of what the amplifier of axis ``k`` makes of u, for i."""
        assert self.i is not None
        i = self.i[:, k].conj() if conjugate else self.i[:, k]
        factors, left = _made_of(i, (self.amplifiers[:, k] * self.u[:, of_u])[:, None])
        return float(factors[0]), left


def _made_of(x: Complex, columns: Complex) -> tuple[Real, float]:
    """Real factors, (c,), with which columns, (P, c), come nearest to x, (P,), and the share of its power left."""
    power = float(np.sum(np.abs(x) ** 2))
    sizes = np.linalg.norm(columns, axis=0)
    if not power or not np.isfinite(power) or not np.isfinite(sizes).all():
        return np.ones(columns.shape[1]), 0.0
    scaled = columns / np.where(sizes, sizes, 1.0)
    real = np.concatenate([scaled.real, scaled.imag])
    factors = np.linalg.lstsq(real, np.concatenate([x.real, x.imag]), rcond=None)[0]
    left = float(np.sum(np.abs(x - scaled @ factors) ** 2)) / power
    return factors / np.where(sizes, sizes, 1.0), left


def _wrong(log: _Log) -> Iterator[str]:
    """What is wrong with the channels, a sentence each, the likeliest first."""
    each = range(len(log.axes))
    if conjugates := _conjugates(log):
        yield conjugates
    for k in each:
        factors, left = log.by_controller(k, k, k)
        if left > BROKEN:
            yield from _others(log, k)
        elif left < HOLDS:
            yield from _odd(log, k, factors)
    if log.i is None:
        return
    for k in each:
        factor, left = log.by_amplifier(k, k)
        axis = log.axes[k]
        if left > BROKEN:
            best, b = min((log.by_amplifier(k, b)[1], b) for b in each)
            if best < HOLDS:
                yield (
                    f"i of {axis} follows u of {log.axes[b]}, and not its own: channels of i or of u are swapped or "
                    "doubled, in the log or at the amplifiers; put them in order"
                )
        elif left < HOLDS and factor < 0:
            yield f"i of {axis} is the negative of what the amplifier makes of u: turn its sign in the log"
        elif left < HOLDS and max(factor, 1 / factor) > UNIT:
            yield (
                f"i of {axis} is {factor:.2g} times what the amplifier makes of u: is one of them in mA? Both hold A, "
                "and the datasheet's amplifier.gain is in A/A"
            )


def _scales(log: _Log) -> Iterator[str]:
    """Which factors, of r and y in u or of what the amplifier makes of u, bring which axes in line, in words."""
    told: dict[tuple[str, str, str], list[str]] = {}
    """axes by signal, factors and remedy"""
    for k, axis in enumerate(log.axes):
        (of_r, of_y), left = log.by_controller(k, k, k)
        made = np.stack([log.r[:, k], log.controllers[:, k] * log.y[:, k]], axis=1)
        missed = _missed(log.late * log.u[:, k], made.sum(axis=1))
        off = max(abs(of_r - 1), abs(of_y - 1)) > OFF and all(1 / UNIT < f < UNIT for f in (of_r, of_y))
        if off and left < FAR_BETTER * missed:
            factors, remedy = _in_words(of_r, of_y)
            told.setdefault(("u", factors, remedy), []).append(axis)
        if log.i is None:
            continue
        factor, left = log.by_amplifier(k, k)
        missed = _missed(log.i[:, k], log.amplifiers[:, k] * log.u[:, k])
        if left < FAR_BETTER * missed and abs(factor - 1) > OFF and 1 / UNIT < factor < UNIT:
            factors = f"is {factor:.3g} times what the amplifier makes of u"
            told.setdefault(("i", factors, "the scale of i, and amplifier.gain"), []).append(axis)
    for (signal, factors, remedy), axes in told.items():
        yield f"{signal} of {', '.join(axes)} {factors}: check in the log and in the datasheet {remedy}"


def _in_words(of_r: float, of_y: float) -> tuple[str, str]:
    """What u has of r and of what the controller makes of y, and what to check."""
    if abs(of_r / of_y - 1) < OFF:
        return f"is {of_r:.3g} times C(z) (-y) + r", "the scale of u"
    terms = [(of_r, "the excitation r"), (of_y, "what the datasheet's controller makes of y")]
    has = " and ".join(f"{factor:.3g} times {term}" for factor, term in terms if abs(factor - 1) > OFF)
    if abs(of_y - 1) < OFF:
        return f"has {has} in it", "the scale of r"
    return f"has {has} in it", f"the scale of y{'' if abs(of_r - 1) < OFF else ' and r'}, and controller.numerator"


def _missed(x: Complex, made: Complex) -> float:
    """Share of the power of a signal that a law leaves."""
    return float(np.sum(np.abs(x - made) ** 2) / max(float(np.sum(np.abs(x) ** 2)), TINY))


def _conjugates(log: _Log) -> str | None:
    """That the controller's law holds on no axis, and far better on all of them with conjugates; in words.

    Where r is most of u, and in phase with its conjugate, conjugates leave less than `BROKEN`.
    """
    each = range(len(log.axes))
    left = [log.by_controller(k, k, k)[1] for k in each]
    if min(left) < HOLDS:
        return None
    for which, words in (("uy", "U and Y are"), ("y", "Y is"), ("u", "U is")):
        if all(log.by_controller(k, k, k, which)[1] < min(HOLDS, FAR_BETTER * left[k]) for k in each):
            return (
                f"{words} the conjugate of what the datasheet's controller makes: are the amplitudes of exp(-j h w t), "
                "and not of exp(+j h w t), or are controller.numerator and denominator written lowest power of z first?"
            )
    return None


def _others(log: _Log, k: int) -> Iterator[str]:
    """Which other channels make the controller's law hold for u of axis ``k``, in words."""
    each = range(len(log.axes))
    left, of_r, of_y = min((log.by_controller(k, a, b)[1], a, b) for a, b in product(each, each))
    if left > HOLDS:
        return
    axis = log.axes[k]
    others = [f"{name} of {log.axes[j]}" for name, j in (("y", of_y), ("r", of_r)) if j != k]
    which = "u, or of y and r," if len(others) > 1 else f"{others[0][0]} or of u"
    yield (
        f"u of {axis} follows {' and '.join(others)} by the datasheet's controller, and not its own: channels of "
        f"{which} are swapped or doubled, in the log or at the controller; put them in order"
    )


def _odd(log: _Log, k: int, factors: Real) -> Iterator[str]:
    """What sign or unit is wrong where the controller's law holds but for the ``factors`` of its terms, in words."""
    axis, power = log.axes[k], float(np.sum(np.abs(log.u[:, k]) ** 2))
    of_r, of_y = (float(f) for f in factors)
    sizes = [float(np.sum(np.abs(x) ** 2)) for x in (log.r[:, k], log.controllers[:, k] * log.y[:, k])]
    # what is too small to be told by u is left alone, unless it would be too large
    told = [size * max(f**2, 1.0) > PRESENT * power for size, f in zip(sizes, (of_r, of_y), strict=True)]
    if all(told) and ALIKE[0] < of_y / of_r < ALIKE[1]:
        if of_r < 0:
            yield f"u of {axis} is the negative of C(z) (-y) + r: turn its sign in the log"
        elif max(of_r, 1 / of_r) > UNIT:
            yield f"u of {axis} is {of_r:.2g} times C(z) (-y) + r: is one of them in mA? u and r hold A"
        return
    if told[1] and of_y < -1 / UNIT:
        yield (
            f"u of {axis} is C(z) (+y) + r, and not C(z) (-y) + r: turn the sign of y in the log, or of "
            "controller.numerator in the datasheet"
        )
    elif told[1] and not 1 / UNIT < of_y < UNIT:
        yield (
            f"u of {axis} has {of_y:.2g} times what the datasheet's controller makes of y: check the units of y, u and "
            "controller.numerator, m, A and A/m, and that u is logged behind the controller"
        )
    if told[0] and of_r < -1 / UNIT:
        yield f"u of {axis} is C(z) (-y) - r, and not C(z) (-y) + r: turn the sign of r in the log"
    elif told[0] and not 1 / UNIT < of_r < UNIT:
        yield (
            f"u of {axis} has {of_r:.2g} times the excitation r in it: check the unit of r, A, and that u is logged "
            "behind the point where r is added"
        )
