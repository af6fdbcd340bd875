"""Magnets: the exact differential force law, saturation, hysteresis, eddy currents, and the operating point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.errors import LevitationError
from sim.rig import Array, Contact, Magnets, Rig

Complex = NDArray[np.complex128]

NARROW = 1e-6
"""Width of a band of plays, as a share of their half width, below which they are one."""
_PLAYS, _WIDEST_PLAY_A = 32, 3.0
"""Plays that stand for those of every width, and the half width beyond which no current moves one."""
_PLAYS_OF_A_BAND = 6
"""Plays that stand for those of a band whose widest is twice as wide as its narrowest."""
PLAY_EDGES = 0.002 * 2.0 ** np.arange(9)
"""Half widths over the bias current between which a density of `Magnets.hysteresis_density` is one, (9,): plays as wide
as the currents of an experiment."""
_LARGEST_LAG_RAD = 0.38
"""Largest lag that is told apart: that of a Rayleigh loop comes near atan(4 / (3 pi)) = 0.401 and no farther."""


def saturated(m: Magnets, current_a: Array) -> Array:
    """Magnetically effective control current, i_s tanh(i / i_s), limited to the amplifier's current limit."""
    i = np.clip(current_a, -m.current_limit_a, m.current_limit_a)
    if np.all(np.isinf(m.saturation_current_a)):
        return i
    with np.errstate(invalid="ignore"):
        limited = m.saturation_current_a * np.tanh(i / m.saturation_current_a)
    return np.where(np.isinf(m.saturation_current_a), i, limited)


def force(m: Magnets, current_a: Array, displacement_m: Array) -> Array:
    """Force of the differential pair, N, for current and displacement of shape (..., n).

    f = k ((i0 + i)^2 / (s0 - x)^2 - (i0 - i)^2 / (s0 + x)^2), k = ki s0^2 / (4 i0); a coil carries no negative
    current (Schweitzer and Maslen, Magnetic Bearings, 2009, eq. 4.3). A pole that saturates by its flux pulls less,
    1 / (1 + (B/Bs)^n), relative to its pull at the bias.
    """
    return pull(m, saturated(m, current_a), displacement_m)


def pull(m: Magnets, effective_a: Array, displacement_m: Array) -> Array:
    """`force` of a magnetically effective current, N, (..., n): what `saturated` makes of the coil's."""
    s0, i0, i = m.gap_m, m.bias_current_a, effective_a
    k = m.ki * s0**2 / (4 * i0)
    x = displacement_m + m.offset_m
    upper = np.maximum(i0 + i, 0.0) / (s0 - x)
    lower = np.maximum(i0 - i, 0.0) / (s0 + x)
    if not np.any(m.flux_share):
        return np.asarray(k * (upper**2 - lower**2))
    share, n = m.flux_share * s0 / i0, m.flux_power  # of the pole's current over gap
    pulls = [pole**2 * (1 + m.flux_share**n) / (1 + (share * np.abs(pole)) ** n) for pole in (upper, lower)]
    return np.asarray(k * (pulls[0] - pulls[1]))


@dataclass(frozen=True)
class OperatingPoint:
    """Where the magnets work, and the factors there; all (n,)."""

    current_a: Array
    load_n: Array
    """Constant force on the rotor at each bearing axis that the magnets carry."""
    ki: Array
    """N/A"""
    ks: Array
    """N/m"""


def static_load(rig: Rig) -> Array:
    """Weight on each bearing axis, N, (n,): shared by the lever arms, each axis at 45 degrees."""
    a, b = rig.rotor.bearing_from_cog_m
    weight = rig.rotor.mass_kg * rig.gravity_m_per_s2 / math.sqrt(2)
    return np.tile([-weight * b / (a + b), -weight * a / (a + b)], rig.n_planes)


def force_rotation(rig: Rig) -> Array:
    """How the magnets' forces turn from x to y and share at each bearing, (n, n), identity without coupling."""
    n, angle, share = rig.n_axes, rig.magnets.cross_coupling_rad, rig.magnets.cross_coupling_symmetric
    rotation = np.eye(n)
    if n == 4 and (angle.any() or share.any()):
        x, y, s = np.arange(2), np.arange(2, 4), np.sin(angle)
        rotation[x, x] = rotation[y, y] = np.cos(angle)
        rotation[x, y], rotation[y, x] = share + s, share - s
    return rotation


def operating_point(rig: Rig) -> OperatingPoint:
    """Current that carries the weight at the sensors' centre, and ki, ks there.

    The pull of an off-centre rotor at zero current is taken as balanced by the static load that moved it, so an
    offset changes ki and ks and makes even harmonics, but asks for no current of its own. Where the current that holds
    the rotor is known, its load is what that balances, wherever it comes from.

    Raises
    ------
    LevitationError
        The magnets cannot carry the weight within the current limit.
    """
    m, n = rig.magnets, rig.n_axes
    if rig.static_current_a is not None:
        return _at(m, rig.static_current_a, -force_rotation(rig) @ force(m, rig.static_current_a, np.zeros(n)))
    if not rig.gravity_m_per_s2 and not np.any(m.offset_m):
        # centred, unloaded: the magnets' own factors, less what a pole's pull grows more slowly with its flux
        saturated_share = m.flux_share**m.flux_power
        slope = 1 - m.flux_power * saturated_share / (2 * (1 + saturated_share))
        return OperatingPoint(np.zeros(n), np.zeros(n), m.ki * slope, m.ks * slope)
    from scipy.optimize import brentq  # takes a while, and only a rig with a static load needs it

    weight, turned = static_load(rig), force_rotation(rig)
    pull = force(m, np.zeros(n), np.zeros(n))
    load = weight - turned @ pull
    asked = pull - np.linalg.solve(turned, weight)  # of each pair, before its force turns
    current = np.zeros(n)
    for axis in range(n):

        def excess(i: float, axis: int = axis) -> float:
            vector = np.zeros(n)
            vector[axis] = i
            return float(force(m, vector, np.zeros(n))[axis] - asked[axis])

        low, high = -m.current_limit_a, m.current_limit_a
        if abs(excess(0.0)) < 1e-12:
            continue
        if excess(low) * excess(high) > 0:
            raise LevitationError(
                f"rig {rig.name}: the magnets of axis {rig.axes[axis]} cannot carry {-weight[axis]:.0f} N within "
                f"{m.current_limit_a:g} A; raise the bias current or the current limit"
            )
        current[axis] = brentq(excess, low, high, xtol=1e-12)
    return _at(m, current, load)


def _at(m: Magnets, current: Array, load: Array) -> OperatingPoint:
    # Central differences: the law is smooth to well below these steps.
    di, dx = 1e-5, 1e-10
    zero = np.zeros(len(current))
    ki = (force(m, current + di, zero) - force(m, current - di, zero)) / (2 * di)
    ks = (force(m, current, zero + dx) - force(m, current, zero - dx)) / (2 * dx)
    return OperatingPoint(current, load, ki, ks)


def stop_rows(contact: Contact | None, n_axes: int, n_planes: int) -> Array:
    """Rows of the stops as compiled code takes them, (5, n).

    Clearance (m), inf without stops, stiffness above and below (N/m), middle (m), and the share of a ring (1), which
    one plane alone has none of.
    """
    if contact is None:
        return np.vstack([np.full(n_axes, np.inf), np.zeros((4, n_axes))])
    k = contact.stiffness_n_per_m
    above, below = k * min(1.0, 1.0 + contact.side), k * min(1.0, 1.0 - contact.side)
    ring = contact.ring if n_planes > 1 else 0.0
    return np.vstack(
        [np.broadcast_to(row, n_axes) for row in (contact.clearance_m, above, below, contact.centre_m, ring)]
    )


def stop_force(rows: Array, x: Array) -> Array:
    """Force of stops on the rotor, N, (..., n), at displacements x of the bearings, m; ``rows`` as of `stop_rows`.

    Each axis has f = -k (|d| - c) sign d beyond its clearance c, d from the middle; a ring f = -k (1 - 1/rho) d in both
    planes, rho = |(d_x/c_x, d_y/c_y)|, beyond rho = 1 (Black 1968), which in one axis alone is the same.
    """
    clearance, above, below, middle, ring = rows
    away = x - middle
    stiffness = np.where(away > 0, above, below)
    depth = np.maximum(np.abs(away) - clearance, 0.0)
    apart = -stiffness * np.copysign(depth, away)
    if not np.any(ring):
        return np.asarray(apart)
    in_planes = (away / clearance).reshape(*x.shape[:-1], 2, -1)
    rho = np.maximum(np.tile(np.hypot(in_planes[..., 0, :], in_planes[..., 1, :]), 2), 1.0)
    return np.asarray(apart + ring * (-stiffness * (1 - 1 / rho) * away - apart))


def rayleigh_coefficient(m: Magnets) -> Array:
    """alpha of the Rayleigh loop b = (1 + alpha A) i +- alpha/2 (A^2 - i^2), 1/A, (n,).

    The loss angle of that loop's fundamental is 4 alpha A / (3 pi (1 + alpha A)) (Rayleigh 1887).
    """
    tangent = np.tan(np.minimum(m.hysteresis_rad, _LARGEST_LAG_RAD))
    return np.asarray(tangent / ((4 / (3 * math.pi) - tangent) * m.hysteresis_reference_a))


def play_band(m: Magnets) -> tuple[float, float, float]:
    """Half widths of the narrowest and of the widest play, A, and how dense they are over those of a Rayleigh loop.

    b = i + 2 alpha integral play_r(i) dr, r from 0 to infinity, is Lord Rayleigh's loop (Krasnosel'skii and Pokrovskii,
    Systems with Hysteresis, 1989, chapter 2). Plays from r1 to r2 have the weight that all up to r2 have there, so that
    one play, r1 = r2, has some too.
    """
    low, inverse = m.hysteresis_narrowest_a, m.hysteresis_widest_inverse_per_a
    if not inverse:
        return low, math.inf, 1.0
    high = max(low, 1 / inverse)
    return low, high, high / (high - low) if high - low > NARROW * high else math.inf


def plays(m: Magnets) -> tuple[Array, Array, Array]:
    """Strength of each axis, (n,), and weights and half widths of the plays, b = i + 2 strength sum w_j play_j(i)."""
    low, high, density = play_band(m)
    if math.isinf(density):
        weights, widths = np.array([high]), np.array([high])
    else:
        # Graded, so that small currents see several of them, and in the middle of their share of the current, so that
        # the sum of plays is the loop to second order.
        edges = low + (max(min(high, _WIDEST_PLAY_A), low) - low) * (np.arange(_PLAYS + 1) / _PLAYS) ** 2
        weights, widths = density * np.diff(edges), (edges[1:] + edges[:-1]) / 2
    for more, inner, outer in denser_bands(m):
        edges = np.linspace(inner, outer, _PLAYS_OF_A_BAND + 1)
        weights, widths = np.r_[weights, more * np.diff(edges)], np.r_[widths, (edges[1:] + edges[:-1]) / 2]
    return rayleigh_coefficient(m), weights, widths


def denser_bands(m: Magnets) -> list[tuple[float, float, float]]:
    """Plays beside `play_band`: how dense over those of a Rayleigh loop, and from and to which half width, A."""
    edges = PLAY_EDGES * float(m.bias_current_a.mean())
    bands = zip(m.hysteresis_density, edges[:-1].tolist(), edges[1:].tolist(), strict=False)
    return [band for band in bands if band[0]]


def eddy_factor(m: Magnets, omega_rad_s: Array) -> Complex:
    """Flux per current, l + (1 - l) / (1 + (sqrt(tau (s + wc)) - sqrt(tau wc)) / (1 - l)), (F, n).

    Half-order above wc, where the skin depth is smaller than the sheets are thick, a first-order lag of
    sqrt(tau / wc) / 2 below it; wc = 0 is solid iron (Zhu, Knospe and Maslen 2005; Stoll 1974 for sheets). A share l of
    the flux has a path without eddy currents, and is all that is left far above.
    """
    s = np.asarray(1j * np.asarray(omega_rad_s)[:, None])
    return np.asarray(eddy_response(m.eddy_time_constant_s, m.eddy_corner_rad_s, s, m.eddy_free_share))


def gap_factor(m: Magnets, omega_rad_s: Array) -> Complex | Array:
    """Pull per displacement over that of a rotor at rest, 1 + g (E - 1), (F, n), or (1, n) ones where it is that.

    A rotor that moves changes the flux of the bias, which passes the iron as that of the coils does: of iron that lags
    by E = `eddy_factor`, both lag alike with g = 1, and f = E (ki i + ks x) (Meeker, Maslen and Noh 1996, where gap and
    iron are reluctances in series). It acts on the linear ks x; what is nonlinear sees the displacement itself.
    """
    if not m.eddy_displacement_share:
        return np.ones((1, len(m.ki)))
    return np.asarray(1 + m.eddy_displacement_share * (eddy_factor(m, omega_rad_s) - 1))


def eddy_response(time_constant_s: Array | float, corner_rad_s: float, s: Complex, free_share: float = 0.0) -> Complex:
    """The same for time constants by themselves, at s = jw, broadcast against them."""
    shifted = np.sqrt(time_constant_s * (s + corner_rad_s)) - np.sqrt(time_constant_s * corner_rad_s)
    return np.asarray(free_share + (1 - free_share) / (1.0 + shifted / (1 - free_share)))


def eddy_states(
    time_constant_s: float, corner_rad_s: float, free_share: float = 0.0, n_states: int = 12
) -> tuple[Array, Array]:
    """Poles p (rad/s) and weights r of the diffusive realisation sum r_k / (1 + s / p_k) of the eddy factor.

    The exact kernel over real poles is a density (Montseny 1998: sqrt(p tau) / (pi p (1 + p tau)) without corner);
    poles are spaced evenly in log p, the weights fitted to the exact factor over 0.5 to 8000 Hz.
    """
    poles = np.geomspace(2 * math.pi * 0.3, 2 * math.pi * 3e5, n_states)
    omega = 2 * math.pi * np.geomspace(0.5, 8000.0, 200)
    basis = np.column_stack([np.ones(len(omega), dtype=complex), 1 / (1 + 1j * omega[:, None] / poles)])
    target = eddy_response(time_constant_s, corner_rad_s, np.asarray(1j * omega), free_share)
    real = np.concatenate([basis.real, basis.imag])
    weights, *_ = np.linalg.lstsq(real, np.concatenate([target.real, target.imag]), rcond=1e-12)
    return np.concatenate([[np.inf], poles]), weights
