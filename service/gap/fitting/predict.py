"""Predictions of u, i and y by a rig for an observation, and weighted residuals in units of noise.

u is predicted from r and y through the controller, i and y from u through amplifiers and plant, so that an error in one
part of the loop does not spread to the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.measured.observation import Observation
from sim import control_law
from sim.at_points import responses
from sim.harmonic_balance import STATIC_HZ, Responder
from sim.rig import Rig
from sim.twin import axis_current_per_control, linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

TINY_WEIGHT, TINY_SIGNAL = 1e-100, 1e-30
"""Substitutes for a weight (1/m or 1/A) and a signal (m or A) of zero in a denominator: far below any other, and their
squares are finite."""


def at_speed_of(rig: Rig, o: Observation) -> Rig:
    """The rig at the speed of the observation."""
    return rig if rig.speed_rad_s == o.speed_rad_s else replace(rig, speed_rad_s=o.speed_rad_s)


def answer(rig: Rig, o: Observation) -> Complex:
    """Twin's response [i, y] to the measured control signal, all harmonics, (P, H, 2 n)."""
    if o.together:
        return np.concatenate([current(rig, o), whole_displacement(rig, o)], axis=2)
    a = _plant(rig, o).answer(o.U, seen=o.Y, seen_current=o.I)
    return np.concatenate([a.I, a.Y], axis=2)


def whole_displacement(rig: Rig, o: Observation) -> Complex:
    """y of `answer` alone, (P, H, n), in half the time."""
    if o.together:
        return displacement(rig, o)[:, None] + beyond_linear(rig, o)
    return _plant(rig, o).displacement(o.U, seen=o.Y, seen_current=o.I)


def beyond_linear(rig: Rig, o: Observation) -> Complex:
    """y of `answer` less its small-signal fundamental, (P, H, n)."""
    if o.together:
        return o.together.displacement(at_speed_of(rig, o), o.points_hz, o.axis)[:, None]
    return _plant(rig, o).beyond_linear(o.U, seen=o.Y, seen_current=o.I)


def _plant(rig: Rig, o: Observation) -> Responder:
    return Responder(at_speed_of(rig, o), o.frequency_hz, o.line, o.harmonics, o.progress)


def linear_answer(rig: Rig, o: Observation) -> Complex:
    """Small-signal [i, y] at the fundamental, (P, 2 n): the cheap part of `answer`."""
    model = linear_model(at_speed_of(rig, o), o.frequency_hz)
    return np.concatenate([responses(G, o.line, o.U[:, o.fundamental]) for G in (model.i_per_u, model.y_per_u)], axis=1)


def displacement(rig: Rig, o: Observation) -> Complex:
    """Small-signal y at the fundamental, (P, n)."""
    model = linear_model(at_speed_of(rig, o), o.frequency_hz)
    return responses(model.y_per_u, o.line, o.U[:, o.fundamental])


def current(rig: Rig, o: Observation) -> Complex:
    """Twin's coil current for the measured control signal, all harmonics, (P, H, n)."""
    if np.any(np.isfinite(rig.amplifiers.slew_limit_a_per_s)):
        return Responder(rig, o.frequency_hz, o.line, o.harmonics).current(o.U, o.I)
    grid = np.maximum(np.outer(o.harmonics, o.frequency_hz), STATIC_HZ)
    own = axis_current_per_control(rig, grid.ravel()).reshape(*grid.shape, rig.n_axes)
    return np.asarray(own[:, o.line].swapaxes(0, 1) * (o.U @ rig.amplifiers.crosstalk.T))


def control(rig: Rig, o: Observation) -> Complex:
    """Twin's logged control signal for the measured displacement, R - C Y, all harmonics, (P, H, n).

    Harmonic 0 is taken as measured: the mean of an integrator's output tells nothing.
    """
    out = o.U.copy()
    for k, h in enumerate(o.harmonics):
        if h == 0:
            continue
        omega = 2 * np.pi * h * o.points_hz
        early = np.exp(1j * omega * rig.controller.sample_time_s * rig.logging_offset_samples)
        C = control_law.responses(rig.controller, omega, rig.n_axes)
        out[:, k] = (o.R[:, k] - C * o.Y[:, k]) * early[:, None]
    return out


def measured_signal(o: Observation, signal: str) -> Complex:
    """u, i or y of all harmonics, (P, H, n)."""
    if signal == "i":
        assert o.I is not None
        return o.I
    return o.U if signal == "u" else o.Y


def weight(o: Observation, signal: str) -> Real:
    """1 / sd of the real and of the imaginary part of u, i or y, (P, H, n)."""
    w = np.asarray(np.sqrt(2) / {"u": o.sd_u, "i": o.sd_i, "y": o.sd_y}[signal])
    if signal == "u" and 0 in o.harmonics:
        w[:, o.harmonics.index(0)] = 0.0  # the mean of an integrator's output tells nothing
    return w


def measured(o: Observation) -> Complex:
    """[u, i, y] of all harmonics, (P, H, 3 n); i is zero where it was not logged."""
    current = np.zeros_like(o.Y) if o.I is None else o.I
    return np.concatenate([o.U, current, o.Y], axis=2)


def weights(o: Observation) -> Real:
    """1 / sd of the real and of the imaginary part of [u, i, y], (P, H, 3 n); 0 where nothing was logged."""
    w_i = np.zeros_like(o.sd_y) if o.I is None else weight(o, "i")
    return np.concatenate([weight(o, "u"), w_i, weight(o, "y")], axis=2)


def centred(e: Complex, w: Real, o: Observation) -> Complex:
    """``e`` (P, H, channels, ...) with the weighted mean over each line's points taken off harmonic 0.

    No effect predicts the static load, which wanders with the magnets' remanence and as rigs warm up. Only its
    differences between the points of a line, with one axis excited and with another, are judged.
    """
    if 0 not in o.harmonics:
        return e
    k = o.harmonics.index(0)
    power = w[:, k] ** 2
    power = power.reshape(*power.shape, *(1,) * (e.ndim - 3))
    total = np.zeros((len(o.frequency_hz), *e.shape[2:]), dtype=e.dtype)
    weight_of_line = np.zeros((len(o.frequency_hz), *power.shape[1:]))
    np.add.at(total, o.line, e[:, k] * power)
    np.add.at(weight_of_line, o.line, power)
    e = e.copy()
    e[:, k] -= (total / np.maximum(weight_of_line, 1e-300))[o.line]
    return e


def residual(rig: Rig, o: Observation) -> Complex:
    """Weighted residual of [u, i, y], all harmonics, (P, H, 3 n): unit variance when the twin is right."""
    predicted = np.concatenate([control(rig, o), answer(rig, o)], axis=2)
    w = weights(o)
    return np.asarray(centred(measured(o) - predicted, w, o) * w)
