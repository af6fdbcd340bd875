"""A foreign rig's shaft as stations: where its mass is, how its modes bend, and the gyroscopic matrix of all of it.

The rotor is a row of thin slices at ``z`` m from its centre of gravity, A positive. A slice of polar inertia I tilts by
``theta + sum s_j(z) q_j``, so that rigid tilt and modes share one gyroscopic matrix ``G_ij = sum I s_i s_j``, symmetric
and positive semidefinite, with s = 1 of the rigid tilt and the slope of its shape of a mode.
"""

from __future__ import annotations

import numpy as np

from foreign.rig import Truth

STATIONS = 11
DEGREE = 7


def stations(t: Truth) -> tuple[np.ndarray, np.ndarray]:
    """(z m, mass kg) of slices from end to end, a little beyond the sensors.

    Thick in the middle as a motor's rotor is, with the rig's mass, centre of gravity and transverse inertia.
    """
    z = np.linspace(-1.15 * t.s[1], 1.15 * t.s[0], STATIONS)
    powers = np.vander(z, 3, increasing=True)
    bell = t.mass * np.exp(-0.5 * z**2 * t.mass / t.inertia)
    moments = np.array([t.mass, 0.0, t.inertia])
    return z, bell * (powers @ np.linalg.solve(powers.T @ (bell[:, None] * powers), moments))


def bent(t: Truth) -> np.ndarray:
    """(modes, DEGREE + 1) shapes of the first two modes as polynomials of z m, lowest power first.

    Of all that pass through what bearings and sensors see and move neither the centre of gravity nor the angular
    momentum of the stations, as a free shaft's modes do, the one with the least bending energy.
    """
    z, mass = stations(t)
    length = float(abs(z).max())  # powers of z / length: those of z would be badly scaled

    def powers(at: np.ndarray) -> np.ndarray:
        return np.vander(at / length, DEGREE + 1, increasing=True)

    seen = np.array([t.d[0], -t.d[1], t.s[0], -t.s[1]])
    demands = np.vstack([powers(seen), mass @ powers(z) / t.mass, (mass * z) @ powers(z) / t.mass / length])
    k = np.arange(2, DEGREE + 1)
    curvature = np.zeros((201, DEGREE + 1))
    curvature[:, 2:] = powers(np.linspace(z[0], z[-1], 201))[:, :-2] * k * (k - 1) / 201
    stationary = np.block([[curvature.T @ curvature, demands.T], [demands, np.zeros((6, 6))]])
    shapes = [[*at_b, *at_s, 0.0, 0.0] for _, _, at_b, at_s in t.modes[:2]]
    right = np.vstack([np.zeros((DEGREE + 1, len(shapes))), np.array(shapes).T])
    return np.linalg.solve(stationary, right)[: DEGREE + 1].T / length ** np.arange(DEGREE + 1)


def slopes(t: Truth) -> np.ndarray:
    """(7, STATIONS) slope per coordinate of a plane: 1 of the rigid tilt, 1/(m sqrt(kg)) of a mode."""
    z, _ = stations(t)
    out = np.zeros((7, STATIONS))
    out[1] = 1.0
    for j, shape in enumerate(bent(t)):
        out[2 + j] = np.polynomial.polynomial.polyval(z, np.polynomial.polynomial.polyder(shape))
    return out


def gyroscopic_matrix(t: Truth, polar: np.ndarray) -> np.ndarray:
    """(7, 7) of the coordinates of a plane for the polar inertia of each station, kg m^2."""
    s = slopes(t)
    return np.asarray(s * polar @ s.T)
