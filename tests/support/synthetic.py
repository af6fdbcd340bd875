"""Experiments straight from the frequency-domain model, with noise: quick data for tests of the diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from sim.datasheet import Datasheet, Mode, Tolerance
from sim.harmonic_balance import Responder, respond_to_excitation
from sim.reference import reference_datasheet
from sim.rig import Rig
from sim.twin import rig_from_datasheet

HARMONICS = (0, 1, 2, 3)
BLOCKS = 6


def known_datasheet(seed: int = 0, spread: float = 0.5) -> tuple[Datasheet, Datasheet]:
    """(datasheet, truth): magnets and modes of the reference rig, the datasheet off by ``spread`` tolerances."""
    rng = np.random.default_rng(seed)
    modes = (
        Mode(3097 / 2 / np.pi, 0.001, (0.0806, 0.0457), (0.080, 0.1416)),
        Mode(5708 / 2 / np.pi, 0.001, (0.21, 0.0827), (0.20, 0.0189)),
    )
    tolerance = Tolerance(mode_frequency=0.003, amplifier_frequency=0.01, amplifier_damping=0.02)
    truth = replace(
        reference_datasheet(),
        modes=modes,
        current_stiffness_n_per_a=(181.0, 186.0, 184.0, 198.0),
        position_stiffness_n_per_m=(1.68e6, 1.73e6, 1.69e6, 1.88e6),
        amplifier_natural_frequency_hz=(1471.0, 1534.0, 1471.0, 1534.0),
        amplifier_damping_ratio=(0.807, 0.831, 0.807, 0.831),
        tolerance=tolerance,
        tolerance_stated=True,
    )

    def off(values: tuple[float, ...], sigma: float) -> tuple[float, ...]:
        return tuple(float(v * np.exp(spread * sigma * rng.standard_normal())) for v in values)

    datasheet = replace(
        truth,
        current_stiffness_n_per_a=off(truth.current_stiffness_n_per_a, tolerance.current_stiffness),
        position_stiffness_n_per_m=off(truth.position_stiffness_n_per_m, tolerance.position_stiffness),
        modes=tuple(replace(m, frequency_hz=off((m.frequency_hz,), tolerance.mode_frequency)[0]) for m in modes),
    )
    return datasheet, truth


def sweep(
    rig: Rig,
    frequency_hz: np.ndarray,
    amplitude_a: float,
    seed: int,
    noise: float = 1.0,
    during: tuple[float, float] = (0.0, 0.8),
) -> Sweep:
    """One sweep of every axis: the nonlinear answer in closed loop, with white noise of each block.

    ``during`` is the share of the campaign in which it is measured, for rigs that drift.
    """
    rng = np.random.default_rng(seed)
    n, H, f = rig.n_axes, len(HARMONICS), HARMONICS.index(1)
    line, axis = np.repeat(np.arange(len(frequency_hz)), n), np.tile(np.arange(n), len(frequency_hz))
    responder = Responder(rig, frequency_hz, line, HARMONICS, np.linspace(*during, len(line)))
    R = np.zeros((len(line), H, n), dtype=complex)
    R[np.arange(len(line)), f, axis] = amplitude_a
    U, answer = respond_to_excitation(responder, R)
    shape = (len(line), BLOCKS, H, n)

    def white(sd: float) -> np.ndarray:
        e = sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        e[:, :, 0] = e[:, :, 0].real
        return e

    # The loop feeds its own sensors' noise back: y = T r + S n, u = r - C y, i = A u + its own noise.
    m = responder._model
    C = np.where(np.array(HARMONICS) == 0, 0.0, m.controller.reshape(H, -1).T)[line][:, :, None, None]
    G, A = (x.reshape(H, -1, n, n).transpose(1, 0, 2, 3)[line] for x in (m.y_per_u, m.i_per_u))
    fed_back = np.linalg.inv(np.eye(n) + G * C)[:, None]
    y_noise = (fed_back @ white(2e-9 * noise)[..., None])[..., 0]
    u_noise = -C[:, None, :, 0] * y_noise
    i_noise = (A[:, None] @ u_noise[..., None])[..., 0] + white(2e-4 * noise)
    blocks = (slice(None), None)
    return Sweep(
        "stepped-sine",
        frequency_hz[line],
        axis,
        np.full(len(line), amplitude_a),
        HARMONICS,
        np.broadcast_to(R[blocks], shape).copy(),
        U[blocks] + u_noise,
        answer.I[blocks] + i_noise,
        answer.Y[blocks] + y_noise,
    )


def lines(count: int = 34) -> np.ndarray:
    """Log-spaced lines with some at the modes of `known_datasheet`."""
    peaks = np.array([489.0, 491.5, 493.0, 494.5, 497.0, 903.0, 906.5, 908.5, 910.5, 914.0])
    return np.unique(np.concatenate([np.geomspace(10.0, 1000.0, count), peaks]))


def experiment(rig: Rig, seed: int = 1, noise: float = 1.0, amplitude_a: float = 0.15) -> Experiment:
    """Main sweep and another one at twice the amplitude on other lines."""
    other = np.geomspace(13.0, 930.0, 16)
    return Experiment(
        rig.name,
        rig.axes,
        (
            replace(sweep(rig, lines(), amplitude_a, seed, noise), comment="main"),
            replace(sweep(rig, other, 2 * amplitude_a, seed + 1, noise, (0.8, 1.0)), comment="other amplitude"),
        ),
    )


def noisy_currents(measured: Experiment, sd_a: float, seed: int = 5) -> Experiment:
    """The experiment with noise in the logged currents that does not move the rig."""
    rng = np.random.default_rng(seed)

    def heard(I: np.ndarray) -> np.ndarray:
        e = sd_a * (rng.standard_normal(I.shape) + 1j * rng.standard_normal(I.shape))
        e[:, :, 0] = e[:, :, 0].real
        return I + e

    return replace(measured, sweeps=tuple(replace(s, I=heard(s.I)) for s in measured.sweeps))


def true_rig(truth: Datasheet) -> Rig:
    """The rig of a true datasheet."""
    return rig_from_datasheet(truth)
