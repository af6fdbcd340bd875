"""The parameters of a plane: what is known of it, the values of the rest, and what each of its parts alone does.

Inside, a mode is known by nu, its frequency as levitated to first order (w^2 = nu^2 + phi_b^T Ks phi_b): the peak that
is seen pins nu to parts in a million, while w moves with the shape's scale, which is hard to see. That
keeps the search straight and the Jacobian well conditioned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane import amplifier
from service.identification.plane.layout import N_MODE, Layout
from sim.chain import Chain

FASTEST = 20.0
"""Frequency times the sample time, and delay over it, beyond which the data tell nothing of either."""
AT_ONCE = 1e14
"""The same of an amplifier that is one lag: a datasheet may tell it as fast as it likes, but a fit has to end."""


@dataclass(frozen=True)
class Known:
    """What the datasheet tells of a plane and no fit changes."""

    bearing_from_cog_m: tuple[float, float]
    sensor_from_cog_m: tuple[float, float]
    bias_current_a: Real
    """(2,)"""
    sample_time_s: float
    computing_delay_s: float = 0.0
    sensor_bandwidth_rad_s: Real = field(default_factory=lambda: np.full(2, np.inf))
    """(2,) inf for none."""
    chain: Chain = field(default_factory=Chain)
    """What else is known of the plane's chain: effects that the twin names."""

    def with_sensors_at(self, shifts_m: Real) -> Known:
        """The same with sensors that are so much farther from the centre, (2,) m."""
        a, b = (float(z + by) for z, by in zip(self.sensor_from_cog_m, shifts_m, strict=True))
        return replace(self, sensor_from_cog_m=(a, b))


@dataclass(frozen=True)
class PlaneParameters:
    """What is known of a plane, where its parameters sit, and their values."""

    known: Known
    layout: Layout
    theta: Real
    """(size,)"""

    def at(self, theta: Real) -> Self:
        """The same plane with other parameters."""
        return replace(self, theta=theta)

    @property
    def ki(self) -> Real:
        """(2,) N/A."""
        return self.theta[0:2]

    @property
    def ks(self) -> Real:
        """(2,) N/m."""
        return self.theta[2:4]

    @property
    def amplifiers(self) -> tuple[amplifier.Amplifier, amplifier.Amplifier]:
        """The amplifiers A and B."""
        a, b = (amplifier.Amplifier(tuple(self.theta[s].tolist())) for s in self.layout.amplifiers)
        return a, b

    @property
    def delay_s(self) -> float:
        """Delay between u and the coil beyond the controller's computing delay, s."""
        return float(self.theta[self.layout.delay])

    @property
    def modes(self) -> Real:
        """(n, 6) nu, sigma, shape at bearings, shape at sensors."""
        start = self.layout.delay + 1
        return self.theta[start : start + N_MODE * self.layout.n_modes].reshape(-1, N_MODE)

    @property
    def natural_frequencies(self) -> Real:
        """(n,) rad/s, of the free rotor."""
        m = self.modes
        return np.sqrt(np.maximum(m[:, 0] ** 2 + m[:, 2:4] ** 2 @ self.ks, 0.0))

    @property
    def damping_ratios(self) -> Real:
        """(n,) of the free rotor."""
        return self.modes[:, 1] / np.maximum(self.natural_frequencies, 1e-300)

    @property
    def sensor_shifts_m(self) -> Real:
        """How much farther from the centre the sensors are than the datasheet says, (2,)."""
        return self.theta[self.layout.shifts]

    @property
    def rigid_shapes(self) -> tuple[Real, Real]:
        """Shapes of the two rigid modes at the bearings and at the sensors, (2, 2) each: [axis, mode]."""
        mass, inertia, shift = self.theta[self.layout.extended][:3]
        a, b = self.known.bearing_from_cog_m
        sa, sb = np.array(self.known.sensor_from_cog_m) + self.sensor_shifts_m
        scale = np.array([1 / np.sqrt(mass), 1 / np.sqrt(inertia)])
        bearings = np.array([[1.0, a - shift], [1.0, -(b + shift)]]) * scale
        sensors = np.array([[1.0, sa - shift], [1.0, -(sb + shift)]]) * scale
        return bearings, sensors

    @property
    def sensor_gain(self) -> Real:
        """Gains of the sensors, (2,)."""
        return self.theta[self.layout.extended][3:5]

    @property
    def is_physical(self) -> bool:
        """Whether every parameter that must be positive is, and the delay is within reason."""
        layout, period = self.layout, self.known.sample_time_s
        t = self.theta.tolist()  # a handful of numbers, asked for at every step of a fit
        extended = layout.extended.start
        if not (all(math.isfinite(v) for v in t) and min(t[0:4]) > 0 and min(t[extended : extended + 2]) > 0):
            return False
        for place in layout.amplifiers:
            gain_and_poles = t[place]
            if min(gain_and_poles) <= 0:
                return False
            fastest = AT_ONCE if len(gain_and_poles) == 2 else FASTEST
            if any(w * period >= fastest for w in (*gain_and_poles[1:2], *gain_and_poles[3:])):
                return False
        for k in range(layout.n_modes):
            nu, sigma = t[layout.mode(k)][:2]
            # a mode far beyond what is sampled is a constant, and its frequency runs away
            if not (-0.2 * nu < sigma < nu and 0 < nu * period < FASTEST):
                return False
        return bool(abs(t[layout.delay]) < FASTEST * period)

    def sensor_response(self, omega: Real) -> Complex:
        """Gain and pole of the sensors, and what else is known of them, (P, 2)."""
        bandwidth, chain = self.known.sensor_bandwidth_rad_s, self.known.chain
        if np.isinf(bandwidth).all():
            own = np.broadcast_to(self.sensor_gain.astype(np.complex128), (len(omega), 2))
        else:
            own = np.asarray(self.sensor_gain / (1.0 + 1j * omega[:, None] / bandwidth))
        return np.asarray(own * chain.sensor(omega)) if chain.is_behind_sensor else own

    def base_band(self, axis: int, omega: Real) -> tuple[Complex, Complex]:
        """Flux-making current at the excited line per ampere of held u, and its derivatives, as `amplifier.base_band`.

        It is the coil current but for what is known to stand between amplifier and flux.
        """
        place, known = self.layout.amplifiers[axis], self.known
        delay = self.delay_s + known.computing_delay_s
        response, gradient = amplifier.base_band(omega, self.theta[place], delay, known.sample_time_s)
        if not known.chain.is_before_flux:
            return response, gradient
        flux = known.chain.flux(omega)[:, axis]
        return np.asarray(response * flux), np.asarray(gradient * flux[:, None])

    def amplifier_response(self, omega: Real, base_band: bool = True) -> Complex:
        """Held amplifiers with delay, (P, 2): base-band up to the flux-making current, or sampled coil current."""
        if base_band:
            return np.stack([self.base_band(axis, omega)[0] for axis in range(2)], axis=1)
        delay, period = self.delay_s + self.known.computing_delay_s, self.known.sample_time_s
        return np.stack(
            [amplifier.sampled(omega, self.theta[p], delay, period)[0] for p in self.layout.amplifiers], axis=1
        )
