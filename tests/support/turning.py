"""Sweeps of a turning rig with exact force law, noise, and runout as it leaks into the blocks of each point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.experiment.data import Sweep
from service.identification.joint.uncertainty import uncertainty_of
from service.identification.priors.split import Posterior, Split, log_ratios
from service.identification.rotating.fit import held_rows, residuals
from service.identification.rotating.model import RotatingModel, joined, paired
from service.identification.rotating.turned import Turned
from service.identification.statistics.least_squares import minimise
from sim.harmonic_balance import Responder, respond_to_excitation
from sim.reference import reference_rig
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.planes import plane_model_of

SPEEDS = (0.0, 157.0, 314.0)
POLAR, COUPLING, INTERNAL = 2.4, 0.03, 2e-4
HZ = np.unique(
    np.concatenate([np.geomspace(10, 1000, 44), 493 + np.linspace(-9, 9, 13), 907.5 + np.linspace(-12, 12, 13)])
)
BLOCKS, PERIOD_S = 6, 1e-4
DISPLACEMENT_NOISE_M, CURRENT_NOISE_A = 4e-9, 2e-4
"""Of the real and of the imaginary part of one block."""


def rig_at(speed_rad_s: float) -> Rig:
    effects = {
        "gyroscopic_coupling": {"polar_inertia_kgm2": POLAR - 1.9, "mode_coupling": COUPLING},
        "internal_damping": {"damping_ratio": INTERNAL},
    }
    return with_effects(reference_rig(speed_rad_s=speed_rad_s), effects)


def true_model(rig: Rig) -> RotatingModel:
    """The rotating model with the values of a simulated rig."""
    x, y = (plane_model_of(rig, p) for p in "xy")
    model = joined(x, y, paired(x, y), rig.rotor.polar_inertia_kgm2)
    theta, layout = model.theta.copy(), model.layout
    for k, pair in enumerate(layout.pairs):
        w = [rig.rotor.modes[p][pair[p]].natural_frequency_rad_s for p in range(2)]
        theta[layout.gyroscopic(k)] = rig.rotor.modes[0][pair[0]].gyroscopic
        internal = rig.rotor.modes[0][pair[0]].internal_damping_ratio
        theta[layout.gyroscopic(k) + 1] = internal * np.mean(w)
        for p in range(2):
            sigma = layout.own[p].start + layout.planes[p].mode(pair[p]).start + 1
            theta[sigma] += internal * w[p]
    return model.at(theta)


def block_samples(hz: np.ndarray) -> np.ndarray:
    """About 0.1 s of whole periods, to the nearest sample."""
    return np.round(np.ceil(0.1 * hz) / hz / PERIOD_S).astype(np.int64)


def sweep_at(speed: float, seed: int, hz: np.ndarray = HZ, runout_m: float = 0.0, comment: str = "main") -> Sweep:
    """The nonlinear answer in closed loop, white noise of each block, and runout as it leaks into blocks."""
    rig, rng = rig_at(speed), np.random.default_rng(seed)
    samples = block_samples(hz)
    hz = np.ceil(0.1 * hz) / (samples * PERIOD_S)
    n = rig.n_axes
    line, axis = np.repeat(np.arange(len(hz)), n), np.tile(np.arange(n), len(hz))
    R = np.zeros((len(line), 4, n), dtype=complex)
    R[np.arange(len(line)), 1, axis] = 0.15
    U, answer = respond_to_excitation(Responder(rig, hz, line, (0, 1, 2, 3)), R)
    model = linear_model(rig, hz)
    shape = (len(line), BLOCKS, n)

    def white(sd: float) -> np.ndarray:
        return sd * (rng.normal(size=shape) + 1j * rng.normal(size=shape))

    fed = np.linalg.inv(np.eye(n) + model.y_per_u * model.controller[:, None, None])[line][:, None]
    y = (fed @ white(DISPLACEMENT_NOISE_M)[..., None])[..., 0]
    u = -model.controller[line][:, None, None] * y
    i = (model.i_per_u[line][:, None] @ u[..., None])[..., 0] + white(CURRENT_NOISE_A)
    if runout_m:
        y_line, u_line, i_line = (x[line] for x in runout_leak(rig, hz, samples, runout_m, rng))
        y, u, i = y + y_line, u + u_line, i + i_line
    return Sweep(
        kind="stepped-sine",
        frequency_hz=hz[line],
        axis=axis,
        amplitude_a=np.full(len(line), 0.15),
        harmonics=(1,),
        R=np.broadcast_to(R[:, None, 1:2], (len(line), BLOCKS, 1, n)).copy(),
        U=(U[:, None, 1] + u)[:, :, None],
        I=(answer.I[:, None, 1] + i)[:, :, None],
        Y=(answer.Y[:, None, 1] + y)[:, :, None],
        speed_rad_s=speed,
        comment=comment,
        block_samples=samples[line],
    )


def runout_leak(rig: Rig, hz: np.ndarray, samples: np.ndarray, size_m: float, rng) -> tuple[np.ndarray, ...]:
    """What blocks of whole periods of ``hz`` make of y, u and i of a loop with runout, (F, B, 4) each."""
    model = linear_model(rig, np.array([rig.speed_rad_s / (2 * np.pi)]))
    seen = size_m * np.array([1, 1, -1j, -1j])  # a quarter of a turn later in y
    y = np.linalg.solve(np.eye(4) + model.y_per_u[0] * model.controller[0], seen)
    u = -model.controller[0] * y
    out = np.zeros((3, len(hz), BLOCKS, 4), dtype=complex)
    for f, (frequency, length) in enumerate(zip(hz, samples, strict=True)):
        t = PERIOD_S * np.arange(length * BLOCKS)
        turn = np.exp(1j * (rig.speed_rad_s * t + rng.uniform(0, 2 * np.pi)))
        origin = np.exp(1j * rng.uniform(0, 2 * np.pi))  # phase of r at the record's start, taken out
        for k, line in enumerate((y, u, model.i_per_u[0] @ u)):
            wave = np.real(line[:, None] * turn) * np.exp(-2j * np.pi * frequency * t)
            out[k, f] = 2 * origin * wave.reshape(4, BLOCKS, length).mean(axis=2).T
    return tuple(out)


def told_the_noise(turned: Turned) -> Turned:
    """The last fit once more with the noise that the sweeps were made with; nobody else knows it."""
    refined = turned.refined
    one = np.repeat([CURRENT_NOISE_A, DISPLACEMENT_NOISE_M], 4) * np.sqrt(2 / BLOCKS)
    weights = tuple(
        np.diag(1 / one).astype(complex)
        / np.sqrt(np.ones(len(p.omega)) if p.inflation is None else p.inflation)[:, None, None]
        for p in turned.data
    )
    splits = tuple(Split(log_ratios(refined.model.plane(k))) for k in range(2))

    def residual(theta, gradient):
        trial = refined.model.at(theta)
        if not trial.is_physical:
            return None
        r, j = residuals(trial, turned.data, weights, refined.amplitude, gradient)
        more, slope = held_rows(trial, splits)
        return np.concatenate([r, more]), None if j is None else np.concatenate([j, slope])

    fit = minimise(residual, refined.model.theta, refined.fit.free, 40)
    found = replace(refined, model=refined.model.at(fit.theta), fit=fit, weights=weights)
    ratios = np.concatenate([s.log_ratios for s in splits])
    held = Posterior(ratios, np.zeros((len(ratios), len(ratios))))
    return replace(turned, refined=found, uncertainty=uncertainty_of(found, held))
