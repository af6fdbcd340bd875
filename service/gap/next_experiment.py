"""The affordable experiment that best separates what is left: T-optimal design (Atkinson and Fedorov 1975).

For each option the surviving explanations predict its outcome; the nuisance values may still move within what
the data so far leave of them. The option whose predictions then differ most, in units of its own noise, wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.distributions import normal_tail
from service.gap.candidates import Candidate
from service.gap.jacobian import answer_and_jacobian
from service.gap.nuisance import Nuisance
from service.gap.observation import Observation
from service.gap.predict import answer, centred, control, weights
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]

SHARE_OF_RANGE = 0.35
"""Largest displacement that an option asks for, as a share of the linear range."""


@dataclass(frozen=True)
class Option:
    """An experiment that could be run next."""

    name: str
    description: str
    frequency_hz: Real
    speed_rad_s: float = 0.0
    amplitude_factor: float = 1.0
    offset_m: float = 0.0


def options(o: Observation, rig: Rig) -> list[Option]:
    """What a commissioning engineer can do without opening the machine."""
    band = np.geomspace(o.frequency_hz[0], o.frequency_hz[-1], 24)
    nyquist = 0.5 / rig.controller.sample_time_s
    found = [
        Option("larger_amplitude", "the same band at twice the amplitude", band, amplitude_factor=2.0),
        Option("smaller_amplitude", "the same band at a third of the amplitude", band, amplitude_factor=1 / 3),
        Option("wide_band", "each axis from 1 kHz up to 3 kHz", np.geomspace(1000.0, min(3000.0, 0.7 * nyquist), 24)),
        Option("low_frequency", "a slow sweep below the present band", np.geomspace(1.0, o.frequency_hz[0], 12)),
        Option("set_point", "the same band with every set-point moved by a tenth of the gap", band, offset_m=0.1),
    ]
    if rig.n_axes == 4 and rig.rotor.polar_inertia_kgm2 > 0:
        found.append(Option("speed", "the same band at 50 rev/s", band, speed_rad_s=2 * np.pi * 50))
    return found


def _conditions(rig: Rig, option: Option) -> Rig:
    shifted = rig.magnets.offset_m + option.offset_m * rig.magnets.gap_m
    return replace(rig, speed_rad_s=option.speed_rad_s, magnets=replace(rig.magnets, offset_m=shifted))


def planned(rig: Rig, o: Observation, option: Option) -> Observation:
    """What the option's measurement would look like, with amplitudes within the rig's limits and today's noise."""
    n, lines = rig.n_axes, len(option.frequency_hz)
    line, axis = np.repeat(np.arange(lines), n), np.tile(np.arange(n), lines)
    model = linear_model(_conditions(rig, option), option.frequency_hz)
    today = np.median(np.abs(o.R[:, o.fundamental]).max(axis=1))
    r = np.full(len(line), today * option.amplitude_factor)
    per_r = model.y_per_u @ model.sensitivity
    moved = np.abs(per_r[line, :, axis]).max(axis=1)
    r = np.minimum(r, SHARE_OF_RANGE * rig.linear_range_m / np.maximum(moved, 1e-30))
    carried = np.abs((model.i_per_u @ model.sensitivity)[line, :, axis]).max(axis=1)
    r = np.minimum(r, 0.5 * rig.current_limit_a / np.maximum(carried, 1e-30))
    shape = (len(line), len(o.harmonics), n)
    R, U = np.zeros(shape, dtype=complex), np.zeros(shape, dtype=complex)
    R[np.arange(len(line)), o.fundamental, axis] = r
    U[:, o.fundamental] = model.sensitivity[line, :, axis] * r[:, None]
    noise = [np.broadcast_to(np.median(sd, axis=0), shape) for sd in (o.sd_u, o.sd_i, o.sd_y)]
    return Observation(
        option.frequency_hz, line, axis, o.harmonics, R, U, None if o.I is None else U, np.zeros(shape, dtype=complex),
        noise[0], noise[1], noise[2], np.linspace(1, 2, len(line)), np.zeros(len(line), dtype=bool),
        np.zeros(len(line)), option.speed_rad_s,
    )  # fmt: skip


def separation(nuisance: Nuisance, a: Candidate, b: Candidate, o: Observation, option: Option) -> float:
    """Distance of two explanations in standard deviations of the option's outcome, nuisances refitted."""
    case = planned(a.fit.rig, o, option)
    rigs = [_conditions(c.fit.rig, option) for c in (a, b)]
    predictions = [np.concatenate([control(rig, case), answer(rig, case)], axis=2) for rig in rigs]
    w = weights(case)
    z = centred(predictions[0] - predictions[1], w, case) * w
    n, f, k = nuisance.rig.n_axes, case.fundamental, len(nuisance)
    _, J = answer_and_jacobian(nuisance, rigs[0], case)
    J = (J * w[:, f, n:, None]).reshape(-1, k)
    J, zf = np.concatenate([J.real, J.imag]), z[:, f, n:].ravel()
    zf = np.concatenate([zf.real, zf.imag])
    before = a.fit.curvature[:k, :k] + np.eye(k)  # what the data so far leave of the nuisances
    taken = J.T @ zf
    explained = float(taken @ np.linalg.solve(before + J.T @ J, taken))
    return float(np.sqrt(max(float(np.vdot(z, z).real) - explained, 0.0)))


def next_experiment(nuisance: Nuisance, candidates: Sequence[Candidate], o: Observation) -> dict[str, Any] | None:
    """The best option for the two explanations that are left, or None when fewer are.

    The answer has the tones ready to submit and the predicted odds of telling the two apart.
    """
    if len(candidates) < 2:
        return None
    a, b = candidates[:2]
    ranking = []
    for option in options(o, a.fit.rig):
        try:
            ranking.append((separation(nuisance, a, b, o, option), option))
        except (ValueError, np.linalg.LinAlgError):
            continue  # this rig cannot be brought to that condition
    if not ranking:
        return None
    distance, option = max(ranking, key=lambda r: r[0])
    case = planned(a.fit.rig, o, option)
    amplitude = np.abs(case.R[np.arange(len(case.line)), case.fundamental, case.axis])
    return {
        "separates": ["+".join(c.effects) or "none" for c in (a, b)],
        "experiment": option.name,
        "description": option.description,
        "distance_sd": distance,
        "odds_of_telling_apart": float(normal_tail(-distance / 2)),
        "speed_rad_s": option.speed_rad_s,
        "set_point_share_of_gap": option.offset_m,
        "tones": [
            {"axis": a.fit.rig.axes[x], "frequency_hz": float(case.frequency_hz[k]), "amplitude_a": float(r)}
            for k, x, r in zip(case.line, case.axis, amplitude, strict=True)
        ],
        "alternatives": [
            {"experiment": other.name, "distance_sd": d} for d, other in sorted(ranking, key=lambda r: -r[0])[1:]
        ],
    }
