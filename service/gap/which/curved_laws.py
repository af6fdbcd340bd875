"""Characteristics that may be curved: of a sensor, of a current probe or amplifier, and of a force at the bearings.

For x of complex amplitude X at the excited frequency, x^3 has the amplitude 3/4 |X|^2 X there and 1/4 X^3 at harmonic
3.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.part import Part
from service.gap.fitting.predict import at_speed_of, measured_signal
from service.gap.measured.observation import Observation
from sim.harmonic_balance import bearings_per_sensors
from sim.rig import Rig
from sim.twin import linear_model

Complex = NDArray[np.complex128]

POWERS = (2, 3)
"""Powers whose harmonics are measured."""
NEXT_POWER = 5
"""A further power. Its own harmonic is not measured, but where the cubic term is a third of the signal, this one is a
tenth of it, and shows at the excited frequency."""


class CurvedLaw(ABC):
    """How the curvature of a characteristic changes a part's signal."""

    signal: str
    """output of the part"""
    introduced: str
    """what is curved, in words, followed by `curvature_in_words`"""
    cause: str
    """possible cause, in words, as a rival of an effect"""
    powers: tuple[tuple[int, ...], ...]
    """sets of powers that it may consist of, the smallest first"""

    @abstractmethod
    def change(self, rig: Rig, o: Observation, power: int, harmonic: int) -> Complex:
        """Change of the signals' amplitudes at a harmonic per curvature of each axis, (P, n signals, n axes)."""

    @abstractmethod
    def curvature_in_words(self, axis: str, power: int, value: float, deviation: float) -> str:
        """A curvature and its standard deviation in words."""


@dataclass(frozen=True)
class CurvedSignal(CurvedLaw):
    """A displacement or current x + c x^p, each channel with its own c."""

    signal: str
    unit: str
    introduced: str
    cause: str
    powers = (POWERS, (*POWERS, NEXT_POWER))

    def change(self, rig: Rig, o: Observation, power: int, harmonic: int) -> Complex:
        """Each signal's own power."""
        x = measured_signal(o, self.signal)[:, o.fundamental]
        return np.asarray(_power(x, power, harmonic)[:, :, None] * np.eye(x.shape[1]))

    def curvature_in_words(self, axis: str, power: int, value: float, deviation: float) -> str:
        """As "in xA y = x + c x^3 with c = .."."""
        size = f"{value:.2g} per {self.unit}{'' if power == 2 else '^2'} (standard deviation {deviation:.1g})"
        return f"in {axis} {self.signal} = x + c x^{power} with c = {size}"


@dataclass(frozen=True)
class CurvedForce(CurvedLaw):
    """A force -k x^p at each bearing, x the displacement there as sensors and currents show it."""

    signal = "y"
    introduced = "a force at the bearings is not in proportion to the displacement, as of a ring or an elastic stop:"
    cause = "a ring whose force grows smoothly"
    powers = (POWERS,)  # with more it would approximate a stop

    def change(self, rig: Rig, o: Observation, power: int, harmonic: int) -> Complex:
        """The displacement that the force causes, with the magnets' stiffness closed."""
        rig = at_speed_of(rig, o)
        through = linear_model(rig, harmonic * o.frequency_hz).y_per_force[o.line]
        return np.asarray(-through * _power(_at_bearings(rig, o), power, harmonic)[:, None, :])

    def curvature_in_words(self, axis: str, power: int, value: float, deviation: float) -> str:
        """As "in xA -k x^3 with k = .."."""
        return f"in {axis} -k x^{power} with k = {value:.2g} N/m^{power} (standard deviation {deviation:.1g})"


SENSOR = CurvedSignal(
    "y", "m", "the displacement is curved, as by a sensor that is not linear:", "a sensor that is not linear"
)
PROBE = CurvedSignal(
    "i",
    "A",
    "the current is curved, as by an amplifier or a probe that is not linear:",
    "an amplifier or a probe that is not linear",
)
LAWS: tuple[CurvedLaw, ...] = (SENSOR, CurvedForce(), PROBE)


def curved_laws(part: Part) -> tuple[CurvedLaw, ...]:
    """The characteristics that may be curved in a part of the loop; none in the controller."""
    return tuple(law for law in LAWS if law.signal == part.signal)


def _power(x: Complex, power: int, harmonic: int) -> Complex:
    """Complex amplitude at a harmonic of x(t)^power, where x(t) has the complex amplitude ``x`` at harmonic 1."""
    pairs = (power - harmonic) // 2
    return np.asarray(comb(power, pairs) / 2 ** (power - 1) * np.abs(x) ** (2 * pairs) * x**harmonic)


def _at_bearings(rig: Rig, o: Observation) -> Complex:
    """Displacement at the bearings at the excited frequency, (P, n).

    It is the model's, corrected by the residuals at the sensors as if these were of a rigid rotor.
    """
    m, U = linear_model(rig, o.frequency_hz), o.U[:, o.fundamental, :, None]
    per_signal, to_bearings = bearings_per_sensors(rig, m.omega_rad_s)
    residuals = o.Y[:, o.fundamental] - (m.y_per_u[o.line] @ U)[..., 0]
    return np.asarray((m.bearing_per_u[o.line] @ U)[..., 0] + (residuals * per_signal[o.line]) @ to_bearings)
