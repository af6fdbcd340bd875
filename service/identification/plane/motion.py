"""What moves in a plane: receptances as sums over the modes, the loop through the position stiffness, forces.

Everything is written out for two bearings, with the points last, so that each operation runs along memory: a fit asks
for this at every step. Matrices (2, 2, P) are [output, input].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane import amplifier
from service.identification.plane.force_law import excess_of_many, excess_of_waves, force_beyond_linear
from service.identification.plane.many_lines import excess_of_products
from service.identification.plane.parameters import PlaneParameters
from service.identification.plane.prediction import Amplitude, Folding, Points


@dataclass(frozen=True)
class Loop:
    """The rotor on its magnets: free receptances, and the loop that ks closes about them."""

    omega: Real
    """(P,) rad/s."""
    gain: Complex
    """(K, P) of each mode, the two rigid ones first: 1/(s^2 + 2 sigma s + w^2)."""
    bearings: Real
    """(K, 2) shapes."""
    sensors: Real
    """(K, 2) shapes, without the sensors' gains."""
    sensor: Complex
    """(2, P) gain and pole of the sensors."""
    h_bb: Complex
    """(3, P) from force to displacement at the bearings: AA, AB, BB."""
    through: Complex
    """(2, 2, P) from force to the sensors' signals, closed loop."""
    closed: Complex
    """(2, 2, P) (I - Ks H_bb)^-1: all force per force that is not the position stiffness's."""


def loop_of(plane: PlaneParameters, omega: Real) -> Loop:
    """Receptances and closed loop of a plane at frequencies (P,), rad/s."""
    m, ks = plane.modes, plane.ks
    rigid_b, rigid_s = plane.rigid_shapes
    bearings, sensors = np.concatenate([rigid_b.T, m[:, 2:4]]), np.concatenate([rigid_s.T, m[:, 4:6]])
    square = omega * omega
    gain = np.empty((len(bearings), len(omega)), dtype=np.complex128)
    gain[:2] = -1.0 / square
    if len(m):
        dynamic = np.empty((len(m), len(omega)), dtype=np.complex128)
        dynamic.real = (m[:, 0] ** 2 + m[:, 2:4] ** 2 @ ks)[:, None] - square
        dynamic.imag = (2 * m[:, 1])[:, None] * omega
        np.reciprocal(dynamic, out=gain[2:])
    a, b = bearings[:, 0], bearings[:, 1]
    sa, sb = sensors[:, 0], sensors[:, 1]
    h = combined(np.stack([a * a, a * b, b * b, sa * a, sa * b, sb * a, sb * b]), gain)
    h_bb, h_sb = h[:3], h[3:].reshape(2, 2, -1)
    back = ks[[0, 1, 1], None] * h_bb  # kA h_AA, kB h_AB, kB h_BB
    closed = np.empty((2, 2, len(omega)), dtype=np.complex128)
    closed[0, 0], closed[1, 1] = 1.0 - back[2], 1.0 - back[0]
    closed[1, 0] = back[1]
    closed[0, 1] = ks[0] * h_bb[1]
    with np.errstate(divide="ignore", invalid="ignore"):  # a fit may try a plant that is singular: it costs too much
        closed /= closed[0, 0] * closed[1, 1] - closed[0, 1] * closed[1, 0]
    sensor = np.ascontiguousarray(plane.sensor_response(omega).T)
    h_sb = h_sb * sensor[:, None]
    with np.errstate(invalid="ignore"):
        through = h_sb[:, :1] * closed[0] + h_sb[:, 1:] * closed[1]
    return Loop(omega, gain, bearings, sensors, sensor, h_bb, through, closed)


def combined(weights: Real, rows: Complex) -> Complex:
    """Sums (k, P) of rows (n, P) with real weights (k, n)."""
    return np.asarray((weights @ rows.view(np.float64)).view(np.complex128))


@dataclass(frozen=True)
class Motion:
    """Currents, forces and displacements at the points, and behind them at their aliases, (2, P + 2 K) each.

    There only the part of the held u is that lies there: small, so the magnets are linear.
    """

    plane: PlaneParameters
    folding: Folding
    loop: Loop
    amplitude: Amplitude | None
    i: Complex
    """(2, P) sampled current, A."""
    coils: Complex
    """Base-band current that makes flux, A."""
    force: Complex
    """Of the currents, N."""
    total: Complex
    """The same with that of the position stiffness, N."""
    moved: Complex
    """Displacement at the bearings, m."""
    excess_slopes: tuple[Complex, Complex] | None = None
    """(2, P) of the force law's excess to ki and ks, where they were asked for."""

    @staticmethod
    def of(plane: PlaneParameters, points: Points, amplitude: Amplitude | None, slopes: bool = False) -> Motion:
        """At the points; ``amplitude``: see `PlaneModel.predict`; ``slopes``: with those of its excess."""
        delay, period = plane.delay_s + plane.known.computing_delay_s, plane.known.sample_time_s
        folding = points.folding(period)
        i, coils = np.empty_like(points.u_rows), np.empty_like(folding.u_rows)
        for j, place in enumerate(plane.layout.amplifiers):
            np.multiply(amplifier.sampled(points.omega, plane.theta[place], delay, period)[0], points.u_rows[j], i[j])
            np.multiply(plane.base_band(j, folding.omega)[0], folding.u_rows[j], coils[j])
        loop = loop_of(plane, folding.omega)
        if amplitude is None or not slopes:
            return Motion(plane, folding, loop, amplitude, i, coils, *_driven(plane, loop, coils, amplitude))
        more, *by = excess(plane, amplitude)
        return Motion(plane, folding, loop, amplitude, i, coils, *_moved(plane, loop, coils, more), (by[0], by[1]))

    def about(self, amplitude: Amplitude) -> Motion:
        """The same with the force law's excess at another amplitude."""
        force, total, moved = _driven(self.plane, self.loop, self.coils, amplitude)
        return replace(self, amplitude=amplitude, force=force, total=total, moved=moved, excess_slopes=None)

    @property
    def coil(self) -> Complex:
        """(2, P) A."""
        return self.coils[:, : self.folding.n]

    @property
    def x(self) -> Complex:
        """Displacement at the bearings, (2, P) m."""
        return self.moved[:, : self.folding.n]

    @cached_property
    def seen(self) -> Complex:
        """Displacement at the sensors, m."""
        return np.asarray(self.loop.through[:, 0] * self.force[0] + self.loop.through[:, 1] * self.force[1])

    @cached_property
    def y(self) -> Complex:
        """Sampled displacement at the sensors, (2, P) m."""
        return self.folding.folded(self.seen.copy())

    @property
    def x_of_modes(self) -> Complex:
        """What each flexible mode adds to the displacement at the bearings, (n, 2, P)."""
        shapes, n = self.loop.bearings[2:], self.folding.n
        return np.asarray(shapes[:, :, None] * (self.loop.gain[2:, :n] * (shapes @ self.total[:, :n]))[:, None])


def _driven(
    plane: PlaneParameters, loop: Loop, coils: Complex, amplitude: Amplitude | None
) -> tuple[Complex, Complex, Complex]:
    """Force of the currents, all force, and the displacement at the bearings."""
    return _moved(plane, loop, coils, _excess(plane, amplitude))


def _moved(
    plane: PlaneParameters, loop: Loop, coils: Complex, excess: Complex | None
) -> tuple[Complex, Complex, Complex]:
    """The same from the force law's excess at the points, (2, P)."""
    force = plane.ki[:, None] * coils
    if excess is not None:
        force[:, : excess.shape[1]] += excess
    total = loop.closed[:, 0] * force[0] + loop.closed[:, 1] * force[1]
    x = loop.h_bb[:2] * total[0] + loop.h_bb[1:] * total[1]
    return force, total, x


def _excess(plane: PlaneParameters, amplitude: Amplitude | None) -> Complex | None:
    if amplitude is None:
        return None
    if amplitude.products is None and amplitude.together is None:
        return force_beyond_linear(plane.ki, plane.ks, plane.known.bias_current_a, amplitude.waves)
    return excess(plane, amplitude)[0]


def excess(plane: PlaneParameters, amplitude: Amplitude) -> tuple[Complex, Complex, Complex]:
    """The force law's excess and its derivatives to ki and ks at held amplitudes, (2, P) each."""
    ki, ks, bias = plane.ki, plane.ks, plane.known.bias_current_a
    if amplitude.products is not None:
        found = excess_of_products(ki, ks, bias, amplitude.products.mean(axis=0))
    elif amplitude.together is not None:
        many = amplitude.together
        found = excess_of_many(ki, ks, bias, amplitude.current, amplitude.displacement, many.group, many.kurtosis)
    else:
        return excess_of_waves(ki, ks, bias, amplitude.waves)
    force, d_ki, d_ks = (f.T for f in found)
    return force, d_ki, d_ks
