"""Interference: what is added to the signals at fixed frequencies, whatever the excitation.

It hardly changes a mean over blocks, as its phase drifts from block to block, but the blocks scatter where a harmonic
of a point comes near it. So it is looked for in the scatter: near the mains and their multiples, and near the rotor's
speed. Where the file tells how long a block is, by its phase, which noise does not have; elsewhere by its loudness.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.fitting.candidates import LAW_ERROR
from service.gap.measured.coherent import (
    PATTERNS,
    beside_hum,
    coherence,
    hum_power,
    resolution_hz,
)
from service.gap.measured.estimate import Estimate
from service.gap.measured.observation import HUMMED, usable
from service.gap.measured.scatter import block_scatter
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

MAINS_HZ = tuple(mains * k for k in (1, 2, 3, 6) for mains in (50.0, 60.0))
"""The mains, and what rectifiers make of them."""
MULTIPLES = (1, 2, 3, 5)
NEAR_HUM = 0.06
"""Relative distance up to which a harmonic is near an interference."""
FAR_FROM_HUM = (0.45, 0.8)
"""Relative distances between which it is held against."""
LOUD_RATIO = 1.8
"""Ratio of the variance near to the variance far from which an interference is named."""
CERTAIN = 8.0
"""Normal deviate from which it is."""
SCATTERS = 0.95
"""Share of the values that must scatter at all: a converter coarser than the noise tells nothing of it."""
IN_PHASE = 8.0
"""The same by its phase: of 123 simulated rigs without any 3.1 was the largest, of 9 rigs with one 25 the least."""
OWN = 0.3
"""Share of a current's hum that must be the current's own: what the controller makes of a sensor's hum is not."""
DISTANCE_BINS = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, HUMMED)
"""Relative distances over which its share of the variance is averaged."""


@dataclass(frozen=True)
class Interference:
    """One source of interference."""

    effect: str
    frequency_hz: float
    parameters: Mapping[str, float]
    std: float
    """of the amplitude"""
    level: float
    """mean log variance near it"""
    ratio: float
    """variance near it over variance far from it, in the signal that shows it most"""
    significance: float
    """normal deviate"""
    signal: str
    shape: tuple[float, ...] = ()
    """mean variance ratio over `DISTANCE_BINS`; empty where the phase tells more"""
    heard_hz: tuple[float, ...] = ()
    """frequencies at which its phase was heard"""
    aliases: tuple[str, ...] = ()
    """effects whose frequency is the same, within what the blocks of a point resolve"""


def interference(sweep: Sweep, rig: Rig) -> list[Interference]:
    """Sources of interference that the scatter of a sweep's blocks shows, one of each kind at most."""
    sweep = usable(sweep)
    wanted: dict[str, tuple[float, ...]] = {"mains_interference": MAINS_HZ}
    if sweep.speed_rad_s:
        wanted["runout"] = (once_a_turn_hz(sweep.speed_rad_s),)
    if sweep.block_samples is not None:
        return _all_told_by_phase(sweep, rig, wanted)
    _, of_i, of_y = block_scatter(sweep, rig)
    signals = {"y": of_y} if sweep.I is None else {"i": of_i, "y": of_y}
    found = []
    for effect, frequencies in wanted.items():
        for signal, variance in signals.items():  # in i first: what moves the current moves the rotor too
            heard = [_heard(sweep, rig, effect, f, signal, variance) for f in frequencies]
            loud = [one for one in heard if one is not None]
            if loud:
                found.append(max(loud, key=lambda one: one.level))
                break
    return found


def _all_told_by_phase(sweep: Sweep, rig: Rig, wanted: Mapping[str, Sequence[float]]) -> list[Interference]:
    """One source of each kind at most, the loudest first.

    A loud hum leaks into every line, and where its phase happens to advance as another's would, it is heard as that:
    the others must be heard beside it, where a faint one is heard better, too.
    """
    told = (_told_by_phase(sweep, rig, effect, frequencies) for effect, frequencies in wanted.items())
    found = sorted((one for one in told if one is not None), key=lambda one: -one.ratio)
    if not found or sweep.Y.shape[1] <= PATTERNS + 1:
        return found
    loudest, by = found[0], beside_hum(sweep, found[0].frequency_hz)
    others = (e for e in wanted if e != loudest.effect)
    beside = [one for e in others if (one := _told_by_phase(sweep, rig, e, wanted[e], by)) is not None]
    alike = (one.effect for one in found[1:] if abs(one.frequency_hz - loudest.frequency_hz) < resolution_hz(sweep))
    aliases = tuple(e for e in alike if e not in {one.effect for one in beside})
    return [replace(loudest, aliases=aliases), *beside]


def _told_by_phase(
    sweep: Sweep, rig: Rig, effect: str, frequencies_hz: Sequence[float], by: Estimate | None = None
) -> Interference | None:
    """The interference whose phase advances from block to block as that of one of the frequencies.

    ``by``: how responses are estimated beside a louder one.
    """
    signals = {"y": sweep.Y} if sweep.I is None else {"i": sweep.I, "y": sweep.Y}
    heard = {(name, f): coherence(sweep, X, f, by) for name, X in signals.items() for f in frequencies_hz}
    loud = {key: deviate for key, (_, deviate) in heard.items() if deviate > IN_PHASE}
    for name in signals:
        at = [f for signal, f in loud if signal == name]
        if not at:
            continue
        f = max(at, key=lambda f: loud[name, f])
        amplitude, spread, own = _amplitude(sweep, rig, name, f)
        if name == "i" and own < OWN:  # what the controller makes of the sensors' hum
            continue
        ratio = 1 / max(1 - heard[name, f][0], 1e-6)
        parameters = _parameters(effect, f, name, amplitude)
        return Interference(
            effect, f, parameters, spread, 0.0, ratio, loud[name, f], name, heard_hz=tuple(sorted({f for _, f in loud}))
        )
    return None


def _amplitude(sweep: Sweep, rig: Rig, signal: str, frequency_hz: float) -> tuple[float, float, float]:
    """Amplitude of a signal's own hum, its standard deviation, and its share of the hum there is; 0 if not told."""
    model = linear_model(rig, np.array([frequency_hz]))
    G, X = (model.i_per_u[0], sweep.I) if signal == "i" and sweep.I is not None else (model.y_per_u[0], sweep.Y)
    own, whole = (hum_power(sweep, Z, frequency_hz) for Z in (X - sweep.U @ G.T, X))
    if not own.size:
        return 0.0, 0.0, 0.0
    power = max(float(own.mean()), 0.0)
    amplitude = float(np.sqrt(power))
    spread = float(own.mean(axis=1).std() / np.sqrt(len(own)) / (2 * amplitude)) if power else 0.0
    return amplitude, spread, float(np.sqrt(power / max(float(whole.mean()), 1e-300)))


def measured_by(source: Interference, sweep: Sweep, rig: Rig) -> Interference:
    """A source heard by its phase, with the amplitude that a twin fitted to the sweep tells.

    Feedback makes most of a hum that there is; what is left as a signal's own is only as good as the loop is known.
    """
    amplitude, spread, _ = _amplitude(usable(sweep), rig, source.signal, source.frequency_hz)
    if not amplitude:
        return source
    parameters = _parameters(source.effect, source.frequency_hz, source.signal, amplitude)
    return replace(source, parameters=parameters, std=float(np.hypot(spread, LAW_ERROR * amplitude)))


def _heard(
    sweep: Sweep, rig: Rig, effect: str, frequency_hz: float, signal: str, variance: Real
) -> Interference | None:
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    away = np.abs(at / frequency_hz - 1)
    quiet = quiet_cells(sweep, rig)
    near, far = quiet & (away < NEAR_HUM), quiet & (away > FAR_FROM_HUM[0]) & (away < FAR_FROM_HUM[1])
    if near.sum() < 4 or far.sum() < 4 or np.mean(variance[quiet] > 0) < SCATTERS:
        return None
    level, floor = (np.log(np.maximum(variance[cells], 1e-300)).mean(axis=0) for cells in (near, far))
    blocks = sweep.Y.shape[1]
    # The log of a variance of B blocks scatters by about 1 / sqrt(B - 1); the channels share the interference.
    spread = float(np.sqrt((1 / near.sum() + 1 / far.sum()) / (blocks - 1)))
    heard = float((level - floor).mean())
    if heard < np.log(LOUD_RATIO) or heard / spread < CERTAIN:
        return None
    ratio = variance / np.exp(floor)
    shape = tuple(
        float(ratio[inside].mean()) if (inside := quiet & (away >= low) & (away < high)).any() else 1.0
        for low, high in itertools.pairwise(DISTANCE_BINS)
    )
    amplitude = float(np.sqrt(variance[near].mean(axis=1).max() * (blocks - 1)))
    return Interference(
        effect,
        frequency_hz,
        _parameters(effect, frequency_hz, signal, amplitude),
        amplitude * spread / 2,
        float(level.mean()),
        float(np.exp(heard)),
        heard / spread,
        signal,
        shape,
    )


def _parameters(effect: str, frequency_hz: float, signal: str, amplitude: float) -> dict[str, float]:
    if effect == "runout":
        return {"amplitude_m": amplitude}
    name, other = ("amplitude_a", "amplitude_m") if signal == "i" else ("amplitude_m", "amplitude_a")
    return {name: amplitude, other: 0.0, "frequency_hz": frequency_hz}


def quiet_cells(sweep: Sweep, rig: Rig) -> NDArray[np.bool_]:
    """Harmonics of the points whose scatter may tell of interference: none that rings, nor the mean, (P, H)."""
    harmonics = np.array(sweep.harmonics)
    return ~_near_modes(sweep.frequency_hz[:, None] * harmonics, rig) & (harmonics > 0)


def _near_modes(at_hz: Real, rig: Rig) -> NDArray[np.bool_]:
    modes = np.array([m.natural_frequency_rad_s for plane in rig.rotor.modes for m in plane]) / (2 * np.pi)
    return np.asarray(np.any(np.abs(at_hz[..., None] - modes) < 0.1 * modes, axis=-1))


def at_speed(sources: Sequence[Interference], speed_rad_s: float) -> tuple[Interference, ...]:
    """The sources as a sweep at this speed has them: runout turns with the rotor, and is not there at standstill."""
    out = []
    for s in sources:
        if s.effect != "runout":
            out.append(s)
        elif speed_rad_s:
            hz = once_a_turn_hz(speed_rad_s)
            out.append(replace(s, frequency_hz=hz, heard_hz=(hz,) if s.heard_hz else ()))
    return tuple(out)


def once_a_turn_hz(speed_rad_s: float) -> float:
    """Turns a second, whichever way."""
    return abs(speed_rad_s) / (2 * np.pi)


def hums_hz(sources: Sequence[Interference], speed_rad_s: float) -> tuple[float, ...]:
    """Frequencies at which a sweep at this speed may have the sources, each source's own first."""
    return tuple(k * s.frequency_hz for s in at_speed(sources, speed_rad_s) for k in MULTIPLES)
