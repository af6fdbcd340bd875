"""The physical model of one plane, from u to i and y, with its exact derivatives.

u is held, delayed, amplified: i = A u, f = Ki i + Ks x_b + (what the force law adds at this amplitude). The rotor is
the free one, rigid and flexible modes with unit modal mass: x_b = H_bb f, y = H_sb f, with
H = Phi diag(1/(s^2 + 2 sigma s + w^2)) Phi_b^T. Eliminating f gives y = H_sb (I - Ks H_bb)^-1 Ki i, the thesis's
eq. 4.9 with the exact sensor map.

Inside, a mode is known by nu, its frequency as levitated to first order (w^2 = nu^2 + phi_b^T Ks phi_b): the peak that
is seen pins nu to parts in a million, while w moves with the shape's scale, which is hard to see. That
keeps the search straight and the Jacobian well conditioned.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification import amplifier
from service.identification.force_law import excess_force, excess_of_many
from service.identification.many_lines import excess_of_products
from service.identification.zoh import Complex, Real

MODE_NAMES = ("nu_rad_s", "sigma_rad_s", "bearing_A", "bearing_B", "sensor_A", "sensor_B")
N_MODE = len(MODE_NAMES)
EXTENDED = ("mass_kg", "transverse_inertia_kgm2", "centre_of_gravity_m", "sensor_gain_A", "sensor_gain_B")
"""Parameters that are known from the datasheet unless they are asked for; the centre of gravity is its shift
towards bearing A."""


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


@dataclass(frozen=True)
class Layout:
    """Where each parameter sits in the vector: ki, ks, amplifiers, delay, modes, extended set."""

    amplifier_orders: tuple[int, int] = (2, 2)
    n_modes: int = 0

    @cached_property
    def amplifiers(self) -> tuple[slice, slice]:
        """Places of the two amplifiers' parameters."""
        a, b = (amplifier.N_PARAMETERS[n] for n in self.amplifier_orders)
        return slice(4, 4 + a), slice(4 + a, 4 + a + b)

    @cached_property
    def delay(self) -> int:
        """Place of the delay."""
        return int(self.amplifiers[1].stop)

    def mode(self, k: int) -> slice:
        """Places of mode ``k``, in the order of `MODE_NAMES`."""
        start = self.delay + 1 + N_MODE * k
        return slice(start, start + N_MODE)

    @cached_property
    def extended(self) -> slice:
        """Places of the extended set, in the order of `EXTENDED`."""
        start = self.delay + 1 + N_MODE * self.n_modes
        return slice(start, start + len(EXTENDED))

    @cached_property
    def size(self) -> int:
        """Length of the parameter vector."""
        return int(self.extended.stop)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        names = ["ki_A", "ki_B", "ks_A", "ks_B"]
        for axis, order in zip("AB", self.amplifier_orders, strict=True):
            names += [f"amplifier_{axis}_{n}" for n in amplifier.PARAMETER_NAMES[: amplifier.N_PARAMETERS[order]]]
        names.append("delay_s")
        for k in range(self.n_modes):
            names += [f"mode_{k + 1}_{n}" for n in MODE_NAMES]
        return (*names, *EXTENDED)

    def index(self, name: str) -> int:
        """Place of a parameter by name."""
        return self.names.index(name)

    def free(self, *extended: str, fixed: tuple[str, ...] = ()) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(size,) True for every parameter that a fit may move: all but the extended set and ``fixed``."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.extended] = [n in extended for n in EXTENDED]
        for name in fixed:
            mask[self.index(name)] = False
        return mask


@dataclass(frozen=True)
class Points:
    """Where the model is evaluated: one row per excited point."""

    omega: Real
    """(P,) rad/s."""
    u: Complex
    """(P, 2) A."""


@dataclass(frozen=True)
class Together:
    """Which points of a multisine excite the rotor at the same time, where its phases are not known."""

    group: NDArray[np.int64]
    """(P,)"""
    kurtosis: Real
    """(n_axes,) of the displacement, 1 for Gaussian."""


@dataclass(frozen=True)
class Amplitude:
    """Amplitudes at the bearings about which the force law's excess is taken."""

    current: Complex
    """(P, 2) A."""
    displacement: Complex
    """(P, 2) m."""
    together: Together | None = None
    """Of a multisine without phases; None for tones."""
    products: Complex | None = None
    """(B, 3, P, 2) of a multisine, whose lines are there at once: `many_lines.ManyLines.products`; None for tones."""


@dataclass(frozen=True)
class Prediction:
    """What a model says at each point; n is 2 for a plane and 4 for a rotor. Gradients are None when not asked for."""

    i: Complex
    """(P, n) sampled current, A."""
    y: Complex
    """(P, n) sampled displacement at the sensors, m."""
    coil: Complex
    """(P, n) base-band current, A."""
    x: Complex
    """(P, n) displacement at the bearings, m."""
    d_i: Complex | None = None
    """(P, n, size)"""
    d_y: Complex | None = None
    """(P, n, size)"""


@dataclass(frozen=True)
class PlaneModel:
    """A plane: what is known, where the parameters sit, and their values."""

    known: Known
    layout: Layout
    theta: Real
    """(size,)"""

    def at(self, theta: Real) -> PlaneModel:
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
    def rigid_shapes(self) -> tuple[Real, Real]:
        """Shapes of the two rigid modes at the bearings and at the sensors, (2, 2) each: [axis, mode]."""
        mass, inertia, shift = self.theta[self.layout.extended][:3]
        (a, b), (sa, sb) = self.known.bearing_from_cog_m, self.known.sensor_from_cog_m
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
        t = self.theta
        positive = [t[0:4] > 0, t[self.layout.extended][:2] > 0]
        positive += [t[s] > 0 for s in self.layout.amplifiers]
        positive += [
            np.delete(t[s][1:], 1) * self.known.sample_time_s < 20 for s in self.layout.amplifiers if len(t[s]) > 2
        ]
        m = self.modes
        ok = bool(np.all(np.concatenate(positive)) and np.all((m[:, 1] > -0.2 * m[:, 0]) & (m[:, 1] < m[:, 0])))
        # a mode far beyond what is sampled is a constant, and its frequency runs away
        ok = ok and bool(np.all((m[:, 0] > 0) & (m[:, 0] * self.known.sample_time_s < 20)))
        return ok and bool(np.all(np.isfinite(t))) and abs(self.delay_s) < 20 * self.known.sample_time_s

    def sensor_response(self, omega: Real) -> Complex:
        """Gain and pole of the sensors, (P, 2)."""
        return np.asarray(self.sensor_gain / (1.0 + 1j * omega[:, None] / self.known.sensor_bandwidth_rad_s))

    def predict(self, points: Points, amplitude: Amplitude | None = None, gradient: bool = False) -> Prediction:
        """Currents and displacements at the excited lines.

        Parameters
        ----------
        points
            Frequencies and control currents.
        amplitude
            Where the force law's excess is taken; None for a linear magnet.
        gradient
            Whether to return the derivatives to every parameter.
        """
        theta, layout = self.theta, self.layout
        s: Complex = np.asarray(1j * points.omega, dtype=np.complex128)
        delay = self.delay_s + self.known.computing_delay_s
        ki, ks = self.ki, self.ks

        i = np.empty_like(points.u)
        coil = np.empty_like(points.u)
        currents = []
        for j, place in enumerate(layout.amplifiers):
            now, d_now = amplifier.sampled(points.omega, theta[place], delay, self.known.sample_time_s)
            base, d_base = amplifier.base_band(points.omega, theta[place], delay, self.known.sample_time_s)
            i[:, j], coil[:, j] = now * points.u[:, j], base * points.u[:, j]
            currents.append((d_now, d_base))

        rotor = self._rotor(points.omega)
        h_bb, h_sb = rotor.h_bb, rotor.h_sb
        force = ki * coil
        excess = None
        if amplitude is not None:
            i0 = self.known.bias_current_a
            at, many = (ki, ks, i0, amplitude.current, amplitude.displacement), amplitude.together
            if amplitude.products is not None:
                excess = excess_of_products(ki, ks, i0, amplitude.products.mean(axis=0))
            else:
                excess = excess_force(*at) if many is None else excess_of_many(*at, many.group, many.kurtosis)
            force = force + excess[0]
        # (I - H_bb Ks)^-1, a closed form for two axes
        d = -h_bb * ks
        d[:, 0, 0] += 1.0
        d[:, 1, 1] += 1.0
        inverse = _inverse(d)
        x = np.einsum("pab,pb->pa", inverse, np.einsum("pab,pb->pa", h_bb, force))
        total = force + ks * x
        sensor = self.sensor_response(points.omega)
        y = sensor * np.einsum("pab,pb->pa", h_sb, total)
        if not gradient:
            return Prediction(i, y, coil, x)

        feedback: Complex = np.asarray((h_sb * ks) @ inverse)  # dy per change of x_b, loop closed through ks
        through = h_sb + feedback @ h_bb  # dy per force
        d_i = np.zeros((*points.u.shape, layout.size), dtype=complex)
        d_y = np.zeros((*points.u.shape, layout.size), dtype=complex)
        for j, place in enumerate(layout.amplifiers):
            d_now, d_base = currents[j]
            u = points.u[:, j, None]
            to_force = through[:, :, j] * ki[j]
            d_i[:, j, place] = d_now[:, :-1] * u
            d_i[:, j, layout.delay] = d_now[:, -1] * u[:, 0]
            d_y[:, :, place] = to_force[:, :, None] * (d_base[:, :-1] * u)[:, None, :]
            d_y[:, :, layout.delay] += to_force * (d_base[:, -1] * u[:, 0])[:, None]
            d_y[:, :, j] = through[:, :, j] * (coil[:, j] + (0 if excess is None else excess[1][:, j]))[:, None]
            d_y[:, :, 2 + j] = through[:, :, j] * (x[:, j] + (0 if excess is None else excess[2][:, j]))[:, None]
        for k, mode in enumerate(self.modes):
            self._mode_gradient(k, mode, rotor.mode_gain[:, k], s, total, feedback, d_y)
        self._extended_gradient(s, total, feedback, h_sb, y, sensor, d_y)
        d_y[:, :, : layout.extended.start + 3] *= sensor[:, :, None]
        return Prediction(i, y, coil, x, d_i, d_y)

    def _mode_gradient(
        self, k: int, mode: Real, gain: Complex, s: Complex, total: Complex, feedback: Complex, d_y: Complex
    ) -> None:
        """Fill the derivatives to one mode's parameters, and its share in those to ks."""
        nu, bearing, sensor = mode[0], mode[2:4], mode[4:6]
        driven = total @ bearing  # modal force
        seen = sensor + feedback @ bearing  # closed-loop shape at the sensors, (P, 2)
        at = self.layout.mode(k).start
        d_square = seen * (-(gain**2) * driven)[:, None]
        d_y[:, :, at] = 2 * nu * d_square
        d_y[:, :, at + 1] = d_square * (2 * s)[:, None]
        for j in range(2):
            d_y[:, :, at + 2 + j] = (
                seen * (gain * total[:, j])[:, None]
                + feedback[:, :, j] * (gain * driven)[:, None]
                + 2 * self.ks[j] * bearing[j] * d_square
            )
            d_y[:, j, at + 4 + j] = gain * driven
            d_y[:, :, 2 + j] += bearing[j] ** 2 * d_square

    def _extended_gradient(
        self, s: Complex, total: Complex, feedback: Complex, h_sb: Complex, y: Complex, sensor: Complex, d_y: Complex
    ) -> None:
        """Fill the derivatives to mass, inertia, centre of gravity and sensor gains."""
        mass, inertia, _ = self.theta[self.layout.extended][:3]
        bearings, sensors = self.rigid_shapes
        gain = 1.0 / s**2
        at = self.layout.extended.start
        for k, value in enumerate((mass, inertia)):
            seen = sensors[:, k] + feedback @ bearings[:, k]
            d_y[:, :, at + k] = seen * (-gain * (total @ bearings[:, k]) / value)[:, None]
        arm = bearings[:, 1] * np.sqrt(inertia)
        arm_s = sensors[:, 1] * np.sqrt(inertia)
        turn, push = gain * (total @ arm) / inertia, gain * total.sum(axis=1) / inertia
        # arms shrink by the shift: d(phi_s phi_b^T)/dshift = -(1 arm_b^T + arm_s 1^T)/I
        d_y[:, :, at + 2] = -((1.0 + feedback.sum(axis=2)) * turn[:, None] + (arm_s + feedback @ arm) * push[:, None])
        for j in range(2):
            d_y[:, j, at + 3 + j] = y[:, j] / self.sensor_gain[j]

    def _rotor(self, omega: Real) -> _Rotor:
        """Receptances of the free rotor."""
        m = self.modes
        rigid_b, rigid_s = self.rigid_shapes
        phi_b = np.hstack([rigid_b, m[:, 2:4].T])
        phi_s = np.hstack([rigid_s, m[:, 4:6].T])
        s = 1j * omega[:, None]
        gain = np.empty((len(omega), phi_b.shape[1]), dtype=complex)
        gain[:, :2] = 1.0 / s**2
        square = m[:, 0] ** 2 + m[:, 2:4] ** 2 @ self.ks
        gain[:, 2:] = 1.0 / (s**2 + 2 * m[:, 1] * s + square)
        pairs_b = np.einsum("ak,bk->kab", phi_b, phi_b).reshape(-1, 4)
        pairs_s = np.einsum("ak,bk->kab", phi_s, phi_b).reshape(-1, 4)
        return _Rotor((gain @ pairs_b).reshape(-1, 2, 2), (gain @ pairs_s).reshape(-1, 2, 2), gain[:, 2:])

    def plant_response(self, omega: Real) -> Complex:
        """Small-signal plant from coil current to sensed displacement, (P, 2, 2)."""
        rotor = self._rotor(omega)
        d = -rotor.h_bb * self.ks
        d[:, 0, 0] += 1.0
        d[:, 1, 1] += 1.0
        closed = rotor.h_sb + (rotor.h_sb * self.ks) @ _inverse(d) @ rotor.h_bb
        return np.asarray(self.sensor_response(omega)[:, :, None] * closed * self.ki)

    def amplifier_response(self, omega: Real, base_band: bool = True) -> Complex:
        """Held amplifiers with delay, base-band or sampled, (P, 2)."""
        of = amplifier.base_band if base_band else amplifier.sampled
        delay = self.delay_s + self.known.computing_delay_s
        return np.stack(
            [of(omega, self.theta[p], delay, self.known.sample_time_s)[0] for p in self.layout.amplifiers], axis=1
        )

    def response(self, omega: Real) -> Complex:
        """Small-signal response from held u to sampled y, (P, 2, 2)."""
        return np.asarray(self.plant_response(omega) * self.amplifier_response(omega)[:, None, :])


@dataclass(frozen=True)
class _Rotor:
    h_bb: Complex
    h_sb: Complex
    mode_gain: Complex
    """(P, n_modes) 1/(s^2 + 2 sigma s + w^2)."""


def _inverse(d: Complex) -> Complex:
    """Inverse of (P, 2, 2)."""
    determinant = d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0]
    inverse = np.empty_like(d)
    inverse[:, 0, 0], inverse[:, 1, 1] = d[:, 1, 1], d[:, 0, 0]
    inverse[:, 0, 1], inverse[:, 1, 0] = -d[:, 0, 1], -d[:, 1, 0]
    return np.asarray(inverse / determinant[:, None, None])
