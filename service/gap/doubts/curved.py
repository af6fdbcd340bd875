"""Whether displacement or current is curved: a harmonic that goes with a power of the signal itself.

No law of the catalogue bends the characteristic of a sensor, or of an amplifier but at its voltage limit. Line by line
such a harmonic may drown in noise, but one number tells it in all lines of both sweeps: y = x + c2 x^2 + c3 x^3 adds
c2 Y^2 / 2 at harmonic 2 and c3 Y^3 / 4 at harmonic 3 to what the plant answers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_tail, normal_above
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.predict import at_speed_of, measured_signal, weight, whole_displacement
from service.gap.measured.observation import HARMONIC_ERROR, MODEL_FLOOR, Observation
from service.gap.weighing.significance import SIGNIFICANT
from service.gap.which.search import Explained
from sim.effects import CATALOGUE
from sim.harmonic_balance import STATIC_HZ
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Seen = tuple[Observation, Complex]
"""A sweep, and what a twin leaves of it, weighted, (P, H, n)."""

POWERS = (2, 3)
WORDS = {
    "y": ("the displacement is curved, as by a sensor that is not linear:", "m"),
    "i": ("the current is curved, as by an amplifier or a probe that is not linear:", "A"),
}
FLOOR_HZ = 1000.0
"""Frequency at which two programs differ by `MODEL_FLOOR`; of first order at least, they differ in proportion to it."""
OF_THE_MAGNETS = 2 * HARMONIC_ERROR
"""Share of what the twin's own magnets leave at a harmonic that is no proof: it may be their law's error."""


def curved(e: Explained, unseen: Seen) -> str | None:
    """What curvature the best explanation of a part leaves in its displacement or current, in words; None where none.

    ``unseen`` is the sweep that no fit saw and what the explanation leaves there, weighted, (P, H, n).
    """
    return _told(e, e.order[0].candidate, [*zip(e.ground.observations, e.left, strict=True), unseen])[0]


def curved_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """What curvature, in words, explains a part better than the nonlinear effects that are named for it; else None.

    What bends a force makes harmonics, too, and so may stand for what bends a signal. ``plain`` and ``best`` are the
    sweep that no fit saw and what the plain twin and the best explanation leave there.
    """
    null, named = e.null.candidate, e.order[0].candidate
    if not named.effects or not all(CATALOGUE[name].nonlinear for name in named.effects):
        return None
    words, explained = _told(e, null, [*zip(e.ground.observations, e.plain, strict=True), plain])
    on_unseen = float(np.sum(np.abs(plain[1]) ** 2) - np.sum(np.abs(best[1]) ** 2))
    return words if explained > null.fit.chi_square - named.fit.chi_square + on_unseen else None


def _told(e: Explained, twin: Candidate, sweeps: Sequence[Seen]) -> tuple[str | None, float]:
    """The curvature that a twin leaves in a signal, in words where it is sure, and the chi-square that it explains."""
    if e.part.signal not in WORDS:
        return None, 0.0
    words, unit = WORDS[e.part.signal]
    rigs = [at_speed_of(twin.fit.rig, o) for o, _ in sweeps]
    told, explained = [], 0.0
    for power in POWERS:
        value, std = _curvature(sweeps, rigs, power, e.part.signal)
        n, chi_square = int(np.isfinite(std).sum()), float(np.sum((value / std) ** 2))
        explained += chi_square
        if n and float(normal_above(chi2_tail(chi_square, n))) > SIGNIFICANT:
            k = int(np.argmax(np.abs(value / std)))
            axis = e.ground.nuisance.rig.axes[k]
            size = f"{value[k]:.2g} per {unit}{'' if power == 2 else '^2'} (standard deviation {std[k]:.1g})"
            told.append(f"in {axis} {e.part.signal} = x + c x^{power} with c = {size}")
    return (f"{words} {' and '.join(told)}" if told else None), explained


def _curvature(sweeps: Sequence[Seen], rigs: Sequence[Rig], power: int, signal: str) -> tuple[Real, Real]:
    """Curvature c of each channel, (n,), and its standard deviation, infinite where nothing tells it.

    A harmonic of less than `MODEL_FLOOR` of the largest signal is no proof: two programs' integrators bend as much. Of
    the displacement's third that is no more than what such a current moves the rotor by, and integrators err less the
    slower the swing, so what swings far at low frequency shows a small curvature. Its second may also be that of a
    rotor off its centre by less than shows otherwise.
    """
    n = sweeps[0][0].Y.shape[2]
    along, own, size, largest, moved = np.zeros(n), np.zeros(n), np.zeros(n), np.full(n, 1e-30), np.zeros(n)
    for (o, z), rig in zip(sweeps, rigs, strict=True):
        if power not in o.harmonics:
            continue
        k = o.harmonics.index(power)
        w = weight(o, signal)[:, k]
        x = measured_signal(o, signal)[:, o.fundamental]
        law = x**power / 2 ** (power - 1) * w
        largest = np.maximum(largest, np.abs(x).max(axis=0))
        magnets = np.zeros_like(law)
        if signal == "y":
            magnets = _beyond_linear(rig, o, k, power) * w
            moved += np.sum(np.abs(_moved_by_currents(rig, o, power) * w * law), axis=0)
        along += np.sum((z[:, k] * law.conj()).real, axis=0)
        own += np.sum((magnets * law.conj()).real, axis=0)
        size += np.sum(np.abs(law) ** 2, axis=0)
    known = size > 0
    size = np.where(known, size, 1.0)
    floor = moved / size if signal == "y" and power % 2 else MODEL_FLOOR * (2 / largest) ** (power - 1)
    std = np.where(known, np.hypot(np.hypot(1 / np.sqrt(size), OF_THE_MAGNETS * own / size), floor), np.inf)
    return along / size, std


def _beyond_linear(rig: Rig, o: Observation, k: int, power: int) -> Complex:
    """What the twin's own magnets leave in the displacement at a harmonic, (P, n)."""
    through = linear_model(rig, np.maximum(power * o.frequency_hz, STATIC_HZ)).y_per_u[o.line]
    return np.asarray(whole_displacement(rig, o)[:, k] - (through @ o.U[:, k, :, None])[..., 0])


def _moved_by_currents(rig: Rig, o: Observation, power: int) -> Complex:
    """Displacement at a harmonic of currents that have as much of it as an integrator's error makes, (P, n)."""
    share = MODEL_FLOOR * np.minimum(power * o.points_hz / FLOOR_HZ, 1.0)
    currents = linear_model(rig, o.frequency_hz).i_per_u[o.line] @ o.U[:, o.fundamental, :, None]
    through = linear_model(rig, power * o.frequency_hz).y_per_i[o.line]
    return np.asarray(share[:, None] * (through @ currents)[..., 0])
