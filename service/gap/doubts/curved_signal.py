"""Whether displacement or current is curved: a harmonic that goes with a power of the signal itself.

Line by line such a harmonic may drown in noise, but one number tells it in all lines of both sweeps: a curved signal
y = x + c2 x^2 + c3 x^3 adds c2 Y^2 / 2 at harmonic 2 and c3 Y^3 / 4 at harmonic 3 to what the plant answers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_tail, normal_above
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.predict import NOTHING_SEEN, at_speed_of, measured_signal, weight, whole_displacement
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
"""A sweep, and what a twin leaves of it, weighted, (P, H, n)."""

FLOOR_HZ = 1000.0
"""Frequency at which two programs differ by `MODEL_FLOOR`; of first order at least, they differ in proportion to it."""
OF_THE_MAGNETS = 2 * HARMONIC_ERROR
"""Share of what the twin's own magnets leave at a harmonic that is no proof: it may be their law's error."""


def curved_signal(e: Explained, unseen: Seen) -> str | None:
    """What curvature the best explanation of a part leaves in its displacement or current, in words; None where none.

    ``unseen`` is the sweep that no fit saw and what the explanation leaves there, weighted, (P, H, n).
    """
    law = {"y": SENSOR, "i": PROBE}.get(e.part.signal)
    if law is None:
        return None
    sweeps = [*zip(e.ground.observations, e.left, strict=True), unseen]
    twin = e.order[0].candidate
    along, size = _along(sweeps, law, twin.fit.rig)
    allowed = systematic(sweeps, twin, law)
    known = size > 0
    value = along / np.where(known, size, 1.0)
    std = np.hypot(np.where(known, 1 / np.sqrt(np.where(known, size, 1.0)), np.inf), allowed)
    return curvatures_in_words(law, e.ground.nuisance.rig.axes, value, std)


def curvatures_in_words(law: CurvedLaw, axes: Sequence[str], value: Real, std: Real) -> str | None:
    """Curvatures of `POWERS`, (powers, n), and their standard deviations in words; None where none of them is sure."""
    told = []
    for power, c, sd in zip(POWERS, value, std, strict=True):
        n, chi_square = int(np.isfinite(sd).sum()), float(np.sum((c / sd) ** 2))
        if n and float(normal_above(chi2_tail(chi_square, n))) > SIGNIFICANT:
            k = int(np.argmax(np.abs(c / sd)))
            told.append(law.told(axes[k], power, float(c[k]), float(sd[k])))
    return f"{law.introduced} {' and '.join(told)}" if told else None


def _along(sweeps: Sequence[Seen], law: CurvedLaw, rig: Rig) -> tuple[Real, Real]:
    """What is left along the harmonic of each curvature, and that harmonic's own square, both weighted, (powers, n)."""
    n = sweeps[0][0].Y.shape[2]
    along, size = np.zeros((len(POWERS), n)), np.zeros((len(POWERS), n))
    for o, z in sweeps:
        for row, power in enumerate(POWERS):
            if power in o.harmonics:
                k = o.harmonics.index(power)
                own = _harmonic(law, rig, o, power)
                along[row] += np.sum((z[:, k, :, None] * own.conj()).real, axis=(0, 1))
                size[row] += np.sum(np.abs(own) ** 2, axis=(0, 1))
    return along, size


def _harmonic(law: CurvedLaw, rig: Rig, o: Observation, power: int) -> Complex:
    """Weighted harmonic that a power makes by the same number, (P, n signals, n axes), per curvature."""
    w = weight(o, law.signal)[:, o.harmonics.index(power)]
    return np.asarray(law.change(rig, o, power, power) * w[..., None])


def systematic(sweeps: Sequence[Seen], twin: Candidate, law: CurvedLaw) -> Real:
    """Curvature that is no proof however little noise there is, (powers, n).

    A harmonic of less than `MODEL_FLOOR` of the largest signal is none: two programs' integrators bend as much. Of
    the displacement's third that is no more than what such a current moves the rotor by, and integrators err less the
    slower the swing, so what swings far at low frequency shows a small curvature. Its second may also be that of a
    rotor off its centre by less than shows otherwise.
    """
    _, size = _along(sweeps, law, twin.fit.rig)
    own, moved, bends = np.zeros_like(size), np.zeros_like(size), np.full_like(size, NOTHING_SEEN)
    largest = np.max([np.abs(measured_signal(o, law.signal)[:, o.fundamental]).max(axis=0) for o, _ in sweeps], axis=0)
    for o, _ in sweeps:
        rig = at_speed_of(twin.fit.rig, o)
        for row, power in enumerate(POWERS):
            if power not in o.harmonics:
                continue
            k = o.harmonics.index(power)
            own_harmonic, w = law.change(rig, o, power, power), weight(o, law.signal)[:, k]
            bends[row] = np.maximum(bends[row], np.abs(own_harmonic).max(axis=(0, 1)))
            if law.signal == "y":
                bent, beyond = own_harmonic * w[..., None], _beyond_linear(rig, o, k, power) * w
                own[row] += np.sum((beyond[..., None] * bent.conj()).real, axis=(0, 1))
                moved[row] += np.sum(
                    np.abs(_moved_by_currents(rig, o, power) * w)[..., None] * np.abs(bent), axis=(0, 1)
                )
    size = np.where(size > 0, size, 1.0)
    floor = MODEL_FLOOR * largest / bends
    if law.signal == "y":
        odd = np.array(POWERS) % 2 == 1
        floor[odd] = (moved / size)[odd]
    return np.asarray(np.hypot(OF_THE_MAGNETS * own / size, floor))


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
