"""What the magnets and the stops do beyond their linearisation, in time, over a period."""

from __future__ import annotations

import numpy as np

from sim import actuator, loops, periodic
from sim.actuator import OperatingPoint
from sim.kernel import NONE, excess_force
from sim.rig import Array, Magnets, Rig
from sim.twin import force_rotation


def law_rows(m: Magnets, point: OperatingPoint) -> Array:
    """Rows of the force law as compiled code takes it, (14, n), in SI units.

    k (N m2/A2), i0 (A), s0 and offset (m), ki (N/A), ks (N/m), load (N), i_s and i_max (A), alpha (1/A), i at rest (A),
    B0/Bs and the power n (1), `played_per_displacement` (A/m); as of `sim.rig.Magnets`, ki and ks at the operating
    point.
    """
    n = len(m.ki)
    return np.vstack(
        [
            m.ki * m.gap_m**2 / (4 * m.bias_current_a),
            m.bias_current_a,
            m.gap_m,
            m.offset_m,
            point.ki,
            point.ks,
            point.load_n,
            np.minimum(m.saturation_current_a, NONE),
            np.full(n, m.current_limit_a),
            actuator.rayleigh_coefficient(m),
            point.current_a,
            m.flux_share,
            np.full(n, m.flux_power),
            played_per_displacement(m, point),
        ]
    )


def played_per_displacement(m: Magnets, point: OperatingPoint) -> Array:
    """Current that makes as much flux as a displacement, A/m, (n,), of which the iron's plays follow a share."""
    return np.asarray(m.hysteresis_displacement_share * point.ks / point.ki)


def effective(m: Magnets, i_t: Array, many_turns: bool = False, beside_t: Array | None = None) -> Array:
    """What of a coil current is magnetically effective, A, (P, T, n), where eddy currents are off it.

    Parameters
    ----------
    i_t
        (P, T, n) samples of a period, A.
    many_turns
        Whether it has more than one maximum and one minimum, so that the iron's plays have to be stepped.
    beside_t
        (P, T, n) what the iron's plays follow beside the current, A: displacements times `played_per_displacement`;
        None where they follow the current alone.
    """
    if np.any(m.hysteresis_rad > 0):
        followed = i_t if beside_t is None else i_t + beside_t
        if many_turns:
            strength, weights, half_widths = actuator.plays(m)
            i_t = i_t + 2 * strength * periodic.played(np.ascontiguousarray(followed), weights, half_widths)
        else:
            i_t = i_t + loops.lag(m, followed)
    return actuator.saturated(m, i_t)


def beyond_linear(
    rig: Rig,
    point: OperatingPoint,
    i_t: Array,
    effective_t: Array,
    x_t: Array,
    passed: Array | None = None,
    at_stops_t: Array | None = None,
) -> Array:
    """Bearing force beyond ki i + ks x and the static load, on the rotor, N, (P, T, n).

    Parameters
    ----------
    i_t, effective_t
        (P, T, n) current that makes flux and what of it is effective, A.
    x_t
        (P, T, n) displacement at the bearings, m.
    passed
        Share of the campaign at which each was measured, (P, 1, 1), for rigs that drift.
    at_stops_t
        (P, T, n) displacement by which the rotor touches its stops, m, where that is not ``x_t``.
    """
    n, points = rig.n_axes, x_t.shape[0]
    drifted = np.stack([np.ones((n, points)), np.zeros((n, points))])
    if rig.drift and passed is not None:
        gone = rig.drift.progress(np.broadcast_to(passed.ravel(), points))
        ki, ks = (np.outer(change, gone) for change in (rig.drift.ki_change, rig.drift.ks_change))
        drifted = np.stack([1 + ki, ks - ki])
    law = law_rows(rig.magnets, point)
    by_axis = (np.ascontiguousarray(v.transpose(2, 0, 1)) for v in (i_t, effective_t, x_t))
    excess = excess_force(law, drifted, *by_axis).transpose(1, 2, 0)
    if np.any(rig.magnets.cross_coupling_rad) or np.any(rig.magnets.cross_coupling_symmetric):
        excess = excess @ force_rotation(rig).T
    if np.any(point.load_n):
        excess = excess + point.load_n
    if rig.contact:
        stops = actuator.stop_rows(rig.contact, n, rig.n_planes)
        excess = excess + actuator.stop_force(stops, x_t if at_stops_t is None else at_stops_t)
    return np.asarray(excess)
