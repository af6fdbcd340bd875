"""The affordable experiment that best separates what is left: T-optimal design (Atkinson and Fedorov 1975).

For each option the surviving explanations predict its outcome; the nuisance values may still move within what
the data so far leave of them. The option whose predictions then differ most, in units of its own noise, wins.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.distributions import normal_tail
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.jacobian import answer_jacobian
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.predict import answer, centred, control, weights
from service.gap.measured.observation import Observation
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]

WORTH, SURE = 0.75, 0.95
"""Odds from which an experiment is worth its time, half-way from a coin's to certainty, and from which a better one is
not worth more time."""
BLOCKS, BLOCK_S = 6, 0.1
"""Blocks of a point and the least length of one, s, of the standard profile; settling and ramps take as long again."""
LINES = 24
"""Lines of an option, log-spaced, before those at peaks."""
FLANKS = (-2e-3, -1e-3, 0.0, 1e-3, 2e-3)
"""Lines about a mode, relative: one and two half-power widths of a damping of 0.0005 to either side."""
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
    by_hand: str = ""
    """What has to be done before, where no controller does it."""

    def profile(self, n_lines: int) -> dict[str, Any]:
        """Options of the experiment's plan; at another amplitude it is the validation sweep that differs."""
        plan: dict[str, Any] = {
            "from_hz": round(float(self.frequency_hz[0]), 3),
            "to_hz": round(float(self.frequency_hz[-1]), 3),
            "points": n_lines,
            "validation_points": n_lines,
        }
        return plan | ({"validation_gain": round(self.amplitude_factor, 3)} if self.amplitude_factor != 1.0 else {})


def rig_seconds(option: Option, n_axes: int) -> float:
    """Time of the rig that the tones need, s: blocks of at least a period, and as long again to settle."""
    return float(n_axes * np.sum(2 * BLOCKS * np.maximum(BLOCK_S, 1 / option.frequency_hz)))


def options(o: Observation, rig: Rig) -> list[Option]:
    """What a commissioning engineer can do without opening the machine."""
    low, high = float(o.frequency_hz[0]), float(o.frequency_hz[-1])
    band = np.unique(np.concatenate([np.geomspace(low, high, LINES), _at_peaks(rig, low, high)]))
    nyquist = 0.5 / rig.controller.sample_time_s
    wide = np.geomspace(1000.0, min(3000.0, 0.7 * nyquist), LINES)
    found = [
        Option("larger_amplitude", "the same band at twice the amplitude", band, amplitude_factor=2.0),
        Option("smaller_amplitude", "the same band at a third of the amplitude", band, amplitude_factor=1 / 3),
        Option("wide_band", "each axis from 1 kHz up to 3 kHz", wide),
        Option("low_frequency", "a slow sweep below the present band", np.geomspace(1.0, o.frequency_hz[0], 12)),
        Option("set_point", "the same band with every set-point moved by a tenth of the gap", band, offset_m=0.1,
               by_hand="move the set-point of every axis by a tenth of the air gap at the controller"),
    ]  # fmt: skip
    if rig.n_axes == 4 and (rig.rotor.polar_inertia_kgm2 > 0 or any(rig.rotor.modes)):
        run_up = "bring the rotor to 50 rev/s (3000 rev/min) and hold the speed"
        found.append(Option("speed", "the same band at 50 rev/s", band, speed_rad_s=2 * np.pi * 50, by_hand=run_up))
    return found


def _at_peaks(rig: Rig, low_hz: float, high_hz: float) -> Real:
    """Lines on the flexible modes and on their flanks, which a campaign finds and adds by itself."""
    modes = {m.natural_frequency_rad_s / (2 * np.pi) for plane in rig.rotor.modes for m in plane}
    lines = np.array([m * (1 + flank) for m in sorted(modes) for flank in FLANKS])
    return np.asarray(lines[(lines > low_hz) & (lines < high_hz)])


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
    J = answer_jacobian(nuisance, rigs[0], case)
    J = (J * w[:, f, n:, None]).reshape(-1, k)
    J, zf = np.concatenate([J.real, J.imag]), z[:, f, n:].ravel()
    zf = np.concatenate([zf.real, zf.imag])
    before = a.fit.curvature[:k, :k] + np.eye(k)  # what the data so far leave of the nuisances
    taken = J.T @ zf
    explained = float(taken @ np.linalg.solve(before + J.T @ J, taken))
    return float(np.sqrt(max(float(np.vdot(z, z).real) - explained, 0.0)))


def next_experiment(
    nuisance: Nuisance, pair: tuple[Candidate, Candidate] | None, o: Observation, name: str
) -> dict[str, Any] | None:
    """The option that tells two explanations apart, or None where there are none or nothing affordable does.

    Of those that are nearly sure to, the one that needs the least time of the rig, else the one that is most likely to.
    The answer has the tones, and the command and the job that ask the service for them. ``name`` is the rig's.
    """
    if pair is None:
        return None
    a, b = pair
    n, ranking = a.fit.rig.n_axes, []
    for option in options(o, a.fit.rig):
        try:
            distance = separation(nuisance, a, b, o, option)
        except (ValueError, np.linalg.LinAlgError):
            continue  # this rig cannot be brought to that condition
        if (odds := float(normal_tail(-distance / 2))) >= WORTH:
            ranking.append((option, distance, odds, rig_seconds(option, n)))
    if not ranking:
        return None
    ranking.sort(key=lambda r: (r[2] < SURE, r[3] if r[2] >= SURE else 0.0, -r[1]))
    option, distance, odds, seconds = ranking[0]
    case = planned(a.fit.rig, o, option)
    amplitude = np.abs(case.R[np.arange(len(case.line)), case.fundamental, case.axis])
    return {
        "separates": ["+".join(c.effects) or "none" for c in (a, b)],
        "experiment": option.name,
        "description": option.description,
        "distance_sd": distance,
        "odds_of_telling_apart": odds,
        "rig_seconds": seconds,
        "speed_rad_s": option.speed_rad_s,
        "set_point_share_of_gap": option.offset_m,
        "tones": [
            {"axis": a.fit.rig.axes[x], "frequency_hz": float(case.frequency_hz[k]), "amplitude_a": float(r)}
            for k, x, r in zip(case.line, case.axis, amplitude, strict=True)
        ],
        "by_hand": [option.by_hand] if option.by_hand else [],
        **submission(option, name),
        "alternatives": [
            {"experiment": other.name, "distance_sd": d, "odds_of_telling_apart": p, "rig_seconds": t}
            for other, d, p, t in ranking[1:]
        ],
    }


def submission(option: Option, name: str) -> dict[str, Any]:
    """The command and the API's job that run an option; the API wants the rig's id, the command knows names too."""
    profile = option.profile(LINES)
    chosen = f"--option {shlex.quote('profile=' + json.dumps(profile))}"
    return {
        "command": f"ambit submit experiment --rig {shlex.quote(name)} {chosen}",
        "job": {"kind": "experiment", "rig": "<id of the rig>", "options": {"profile": profile}},
    }
