"""Whether a displacement or a current is curved, by a matched filter over all lines.

A curved signal y = x + c2 x^2 + c3 x^3 has c2 X^2 / 2 at harmonic 2 and c3 X^3 / 4 at harmonic 3 beside what the plant
puts there. At a single line noise may hide that; a regression of the residuals of all lines on it gives c2 and c3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_tail, normal_above
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.predict import TINY_SIGNAL, at_speed_of, measured_signal, weight, whole_displacement
from service.gap.measured.observation import HARMONIC_ERROR, MODEL_FLOOR, Observation
from service.gap.weighing.significance import SIGNIFICANT
from service.gap.which.curved_laws import POWERS, PROBE, SENSOR, CurvedLaw
from service.gap.which.explained import Explained
from sim.harmonic_balance import STATIC_HZ
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Seen = tuple[Observation, Complex]
"""A sweep and the weighted residuals of a twin there, (P, H, n)."""

FLOOR_HZ = 1000.0
"""Frequency at which two programs differ by `MODEL_FLOOR`; below, integrators of first order at least differ in
proportion to frequency."""
OF_THE_MAGNETS = 2 * HARMONIC_ERROR
"""Share of the harmonic of the twin's own magnets that counts as uncertain, as the error of their law."""


def curved_signal(e: Explained, unseen: Seen) -> str | None:
    """The significant curvature in the best explanation's residuals of displacement or current, in words; or None.

    ``unseen`` is the unseen sweep with that explanation's residuals.
    """
    law = {"y": SENSOR, "i": PROBE}.get(e.part.signal)
    if law is None:
        return None
    sweeps = [*zip(e.ground.observations, e.left, strict=True), unseen]
    twin = e.order[0].candidate
    correlation, power = _matched(sweeps, law, twin.fit.rig)
    known = power > 0
    value = correlation / np.where(known, power, 1.0)
    random = np.where(known, 1 / np.sqrt(np.where(known, power, 1.0)), np.inf)
    std = np.hypot(random, systematic(sweeps, twin, law))
    return curvatures_in_words(law, e.ground.nuisance.rig.axes, value, std)


def curvatures_in_words(law: CurvedLaw, axes: Sequence[str], value: Real, std: Real) -> str | None:
    """Significant curvatures of `POWERS` in words, or None, from values and standard deviations (powers, n)."""
    sentences = []
    for power, c, sd in zip(POWERS, value, std, strict=True):
        n, chi_square = int(np.isfinite(sd).sum()), float(np.sum((c / sd) ** 2))
        if n and float(normal_above(chi2_tail(chi_square, n))) > SIGNIFICANT:
            k = int(np.argmax(np.abs(c / sd)))
            sentences.append(law.curvature_in_words(axes[k], power, float(c[k]), float(sd[k])))
    return f"{law.introduced} {' and '.join(sentences)}" if sentences else None


def _matched(sweeps: Sequence[Seen], law: CurvedLaw, rig: Rig) -> tuple[Real, Real]:
    """Correlation of the residuals with the harmonic of a unit curvature, and that harmonic's power, (powers, n) each.

    Their ratio is the regression of the residuals on each curvature by itself. Both are weighted.
    """
    n = sweeps[0][0].Y.shape[2]
    correlation, total = np.zeros((len(POWERS), n)), np.zeros((len(POWERS), n))
    for o, z in sweeps:
        for row, power in enumerate(POWERS):
            if power in o.harmonics:
                k = o.harmonics.index(power)
                own = _harmonic(law, rig, o, power)
                correlation[row] += np.sum((z[:, k, :, None] * own.conj()).real, axis=(0, 1))
                total[row] += np.sum(np.abs(own) ** 2, axis=(0, 1))
    return correlation, total


def _harmonic(law: CurvedLaw, rig: Rig, o: Observation, power: int) -> Complex:
    """Weighted amplitude of the power p at harmonic p per unit curvature, (P, n signals, n axes)."""
    w = weight(o, law.signal)[:, o.harmonics.index(power)]
    return np.asarray(law.change(rig, o, power, power) * w[..., None])


def systematic(sweeps: Sequence[Seen], twin: Candidate, law: CurvedLaw) -> Real:
    """Systematic standard deviation of the curvatures, however little noise there is, (powers, n).

    - A harmonic of `MODEL_FLOOR` of the largest signal, by which two programs' integrators differ. For harmonic 3 of
    the
      displacement it is smaller: what a current with such a harmonic moves the rotor by. Integrators err less at low
      frequency, where displacements are large, so that small curvatures can be detected. For harmonic 2 of the
      displacement it is not reduced, as a rotor slightly off its centre makes one, too.
    - A share of what the twin's own magnets put at the harmonic of a displacement.
    """
    _, size = _matched(sweeps, law, twin.fit.rig)
    of_magnets, moved = np.zeros_like(size), np.zeros_like(size)
    largest_harmonic = np.full_like(size, TINY_SIGNAL)  # per unit curvature
    largest = np.max([np.abs(measured_signal(o, law.signal)[:, o.fundamental]).max(axis=0) for o, _ in sweeps], axis=0)
    for o, _ in sweeps:
        rig = at_speed_of(twin.fit.rig, o)
        for row, power in enumerate(POWERS):
            if power not in o.harmonics:
                continue
            k = o.harmonics.index(power)
            harmonic, w = law.change(rig, o, power, power), weight(o, law.signal)[:, k]
            largest_harmonic[row] = np.maximum(largest_harmonic[row], np.abs(harmonic).max(axis=(0, 1)))
            if law.signal == "y":
                weighted, beyond = harmonic * w[..., None], _beyond_linear(rig, o, k, power) * w
                of_magnets[row] += np.sum((beyond[..., None] * weighted.conj()).real, axis=(0, 1))
                moved[row] += np.sum(
                    np.abs(_moved_by_currents(rig, o, power) * w)[..., None] * np.abs(weighted), axis=(0, 1)
                )
    size = np.where(size > 0, size, 1.0)
    floor = MODEL_FLOOR * largest / largest_harmonic
    if law.signal == "y":
        odd = np.array(POWERS) % 2 == 1
        floor[odd] = (moved / size)[odd]
    return np.asarray(np.hypot(OF_THE_MAGNETS * of_magnets / size, floor))


def _beyond_linear(rig: Rig, o: Observation, k: int, power: int) -> Complex:
    """Harmonic of the displacement, index ``k``, that the twin's own magnets make, (P, n)."""
    through = linear_model(rig, np.maximum(power * o.frequency_hz, STATIC_HZ)).y_per_u[o.line]
    return np.asarray(whole_displacement(rig, o)[:, k] - (through @ o.U[:, k, :, None])[..., 0])


def _moved_by_currents(rig: Rig, o: Observation, power: int) -> Complex:
    """Displacement at a harmonic, (P, n), of currents that have as much of it as an integrator's error makes."""
    share = MODEL_FLOOR * np.minimum(power * o.points_hz / FLOOR_HZ, 1.0)
    currents = linear_model(rig, o.frequency_hz).i_per_u[o.line] @ o.U[:, o.fundamental, :, None]
    through = linear_model(rig, power * o.frequency_hz).y_per_i[o.line]
    return np.asarray(share[:, None] * (through @ currents)[..., 0])
