"""Interference (hum): what is added to the signals at fixed frequencies, whatever the excitation.

Its phase drifts from block to block, so it hardly changes a mean over blocks, but scatters them where a harmonic of a
point comes near it. So it is searched for in the scatter, near multiples of the mains and near the rotor's speed. Where
the length of the blocks is known, it is detected by its phase (`measured.coherent`), else by the size of the scatter.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.fitting.candidates import LAW_ERROR
from service.gap.measured.coherent import (
    PATTERNS,
    beside_hum,
    coherence,
    hum_frequency,
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

MAINS_HZ = tuple(mains * k for k in (1, 2, 3, 5, 6) for mains in (50.0, 60.0))
"""The mains, and the multiples of it that rectifiers make."""
MULTIPLES = (1, 2, 3, 5)
"""Multiples of a source's frequency at which it also adds to the signals."""
OVERTONES = range(2, 7)
"""Multiples of the loudest source that may be taken for another one."""
NEAR_HUM = 0.06
"""Relative distance up to which a harmonic of a point is near an interference."""
FAR_FROM_HUM = (0.45, 0.8)
"""Relative distances between which the scatter is taken for comparison."""
LOUD_RATIO = 1.8
"""Ratio of the variance near to the variance far from which an interference is detected by its size..."""
CERTAIN = 8.0
"""... and the normal deviate that this ratio must have."""
ABOVE_BOTH = 1.25
"""Ratio of the variance near to that on either side far from it, at least: noise that falls with frequency, by steps,
is far above what it is on one side. Of a rig without any, 50 Hz had 3.5 times the mean of both sides, and 0.8 times
what 25 Hz had."""
NEIGHBOURS = 0.25
"""Relative distance of frequencies that leak into one another's neighbourhood: 50 and 60 Hz, 100 and 120 Hz."""
FLANK = 0.4
"""Relative distance from them up to which the scatter's fall is compared."""
SCATTERS = 0.95
"""Least share of the values that scatter at all: with a converter coarser than the noise the scatter is no measure."""
IN_PHASE = 8.0
"""Normal deviate from which it is detected by its phase: of 123 simulated rigs without any 3.1 was the largest, of 9
rigs with one 25 the least."""
OWN = 0.3
"""Least share of a current's hum that is the current's own, and not made by the controller from a sensor's hum..."""
OWN_IN_PHASE = 4.0
"""... and least normal deviate of the current's own hum, as noise alone is a third of a faint one: of 8 simulated rigs
it was 32 at least where the hum was the current's, and 1 at most where it was a sensor's."""
DISTANCE_BINS = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, HUMMED)
"""Edges of relative distances over which the variance ratio is averaged."""


@dataclass(frozen=True)
class Interference:
    """One source of interference."""

    effect: str
    frequency_hz: float
    parameters: Mapping[str, float]
    std: float
    """standard deviation of the amplitude"""
    level: float
    """mean log variance near it"""
    ratio: float
    """variance near it over variance far from it, in the signal that shows it"""
    significance: float
    """normal deviate"""
    signal: str
    """i or y, to which it is added"""
    shape: tuple[float, ...] = ()
    """mean variance ratio over `DISTANCE_BINS`; empty where it was detected by its phase"""
    frequency_std_hz: float = 0.0
    """standard deviation of the frequency, by its size no better than `NEAR_HUM`; runout has the rotor's"""
    heard_hz: tuple[float, ...] = ()
    """frequencies at which it was detected by its phase; empty where by its size"""
    aliases: tuple[str, ...] = ()
    """effects whose frequency is the same, within what the blocks of a point resolve"""


def interference(sweep: Sweep, rig: Rig) -> list[Interference]:
    """Sources of interference that the scatter of a sweep's blocks shows, one of each kind at most."""
    sweep = usable(sweep)
    wanted: dict[str, tuple[float, ...]] = {"mains_interference": MAINS_HZ}
    if sweep.speed_rad_s:
        wanted["runout"] = (once_a_turn_hz(sweep.speed_rad_s),)
    if sweep.block_samples is not None:
        return _all_by_phase(sweep, rig, wanted)
    _, of_i, of_y = block_scatter(sweep, rig)
    signals = {"y": of_y} if sweep.I is None else {"i": of_i, "y": of_y}
    found = []
    for effect, frequencies in wanted.items():
        for signal, variance in signals.items():  # i first: what moves the current moves the rotor, too
            measured = [_by_size(sweep, rig, effect, f, signal, variance) for f in frequencies]
            audible = [one for one in measured if one is not None]
            loud = [one for one in audible if one.ratio >= LOUD_RATIO and one.significance >= CERTAIN]
            if loud:
                loudest = max(loud, key=lambda one: one.level)
                alike = [one for one in audible if abs(one.frequency_hz / loudest.frequency_hz - 1) < NEIGHBOURS]
                found.append(_most_central(sweep, rig, variance, alike))
                break
    return found


def _most_central(sweep: Sweep, rig: Rig, variance: Real, measured: Sequence[Interference]) -> Interference:
    """The one from whose frequency on the scatter falls to both sides; the loudest may be a neighbour with more lines.

    What a hum leaks falls with the distance in hertz, by a law that depends on the blocks' unknown length. So the
    frequency is taken for which the log of the variance is explained best by any function that does not rise.
    """
    if len(measured) == 1:
        return measured[0]
    lowest, *_, highest = sorted(one.frequency_hz for one in measured)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    cells = quiet_cells(sweep, rig) & (at > (1 - FLANK) * lowest) & (at < (1 + FLANK) * highest)
    level = np.log(np.maximum(variance[cells], 1e-300)).mean(axis=1)

    def left(one: Interference) -> float:
        order = np.argsort(np.abs(at[cells] - one.frequency_hz), kind="stable")
        return float(np.var(level[order] - scipy.optimize.isotonic_regression(level[order], increasing=False).x))

    return min(measured, key=left)


def _all_by_phase(sweep: Sweep, rig: Rig, wanted: Mapping[str, Sequence[float]]) -> list[Interference]:
    """Sources detected by their phase, one of each kind at most, the loudest first.

    A loud hum leaks into every line, and may be taken for another one whose phase advances alike. So the others must be
    detected with the loudest taken off, which also shows faint ones better.
    """
    all_by_phase = (_by_phase(sweep, rig, effect, frequencies) for effect, frequencies in wanted.items())
    found = sorted((one for one in all_by_phase if one is not None), key=lambda one: -one.ratio)
    if not found:
        return found
    loudest = found[0]
    if sweep.Y.shape[1] <= PATTERNS + 1:  # too few blocks to take it off: all may be one
        return [replace(loudest, aliases=tuple(one.effect for one in found[1:]))]
    by = beside_hum(sweep, loudest.frequency_hz)
    others = {e: _no_overtones(sweep, loudest, wanted[e], by) for e in wanted if e != loudest.effect}
    beside = [one for e, hz in others.items() if hz and (one := _by_phase(sweep, rig, e, hz, by)) is not None]
    alike = (one.effect for one in found[1:] if abs(one.frequency_hz - loudest.frequency_hz) < resolution_hz(sweep))
    aliases = tuple(e for e in alike if e not in {one.effect for one in beside})
    return [replace(loudest, aliases=aliases), *beside]


def _no_overtones(
    sweep: Sweep, loudest: Interference, frequencies_hz: Sequence[float], by: Estimate
) -> tuple[float, ...]:
    """The frequencies without those at which an overtone of the loudest source nearby is heard better.

    Runout has some, and twice the speed of a rotor that turns at nearly the mains is nearly twice the mains.
    """

    def deviate(hz: float) -> float:
        return coherence(sweep, sweep.Y, hz, by)[1]

    overtones = [k * loudest.frequency_hz for k in OVERTONES]
    near = {f: [g for g in overtones if 0 < abs(g / f - 1) < NEAR_HUM] for f in frequencies_hz}
    return tuple(f for f in frequencies_hz if not any(deviate(g) > deviate(f) for g in near[f]))


def heard_at_speed(sources: Sequence[Interference], main: Sweep, other: Sweep, rig: Rig) -> tuple[Interference, ...]:
    """The sources of a main sweep at standstill, with the runout that only the other sweep can have, at its speed.

    What turns at the mains' frequency is no mains where that is not heard at standstill.
    """
    if main.speed_rad_s or not other.speed_rad_s or not other.in_sequence:
        return tuple(sources)
    heard = [one for one in interference(other, rig) if "runout" in (one.effect, *one.aliases)]
    mains = any(s.effect == "mains_interference" for s in sources)
    if not heard or (heard[0].aliases and mains):
        return tuple(sources)
    at_turns = (once_a_turn_hz(other.speed_rad_s),)
    runout = heard[0] if heard[0].effect == "runout" else _by_phase(usable(other), rig, "runout", at_turns)
    return tuple(sources) if runout is None else (*sources, replace(runout, aliases=()))


def told_apart(sources: Sequence[Interference], main: Sweep, other: Sweep, rig: Rig) -> tuple[Interference, ...]:
    """The sources of the main sweep, those of a rotor that turns at a multiple of the mains named by the other sweep.

    At another speed the mains stays where it is, and runout follows the rotor. Where both are heard there, or neither,
    both stay open.
    """
    other = usable(other)
    if other.block_samples is None or not other.in_sequence or other.speed_rad_s == main.speed_rad_s:
        return tuple(sources)
    return tuple(_named_at_another_speed(s, usable(main), other, rig) if s.aliases else s for s in sources)


def _named_at_another_speed(source: Interference, main: Sweep, other: Sweep, rig: Rig) -> Interference:
    turns_hz = once_a_turn_hz(main.speed_rad_s)
    at_main = {"mains_interference": min(MAINS_HZ, key=lambda hz: abs(hz - turns_hz)), "runout": turns_hz}
    wanted = {"mains_interference": (at_main["mains_interference"],)}
    if other.speed_rad_s:
        wanted["runout"] = (once_a_turn_hz(other.speed_rad_s),)
    heard = _all_by_phase(other, rig, wanted)
    if len(heard) != 1 or heard[0].aliases:
        return source
    name = heard[0].effect
    return _by_phase(main, rig, name, (at_main[name],)) or source


def _by_phase(
    sweep: Sweep, rig: Rig, effect: str, frequencies_hz: Sequence[float], by: Estimate | None = None
) -> Interference | None:
    """The interference at one of the frequencies, detected by its phase from block to block.

    ``by`` is the estimate of responses beside a louder one.
    """
    signals = {"y": sweep.Y} if sweep.I is None else {"i": sweep.I, "y": sweep.Y}
    coherences = {(name, f): coherence(sweep, X, f, by) for name, X in signals.items() for f in frequencies_hz}
    detected = {key for key, (_, deviate) in coherences.items() if deviate > IN_PHASE}
    heard_hz = tuple(sorted({f for _, f in detected}))
    for name in signals:
        # what the currents show and have not of their own is the sensors', even where the log of these is too noisy
        at = heard_hz if name == "y" else [f for signal, f in detected if signal == name]
        if not at:
            continue
        f = max(at, key=lambda f: coherences[name, f][1])
        amplitude, deviation, share = _amplitude(sweep, rig, name, f)
        if name == "i" and (share < OWN or coherence(sweep, _own(sweep, rig, name, f), f, by)[1] < OWN_IN_PHASE):
            continue  # the controller makes it from the sensors' hum
        coherent, significance = coherences[name, f]
        parameters, ratio = _parameters(effect, f, name, amplitude), 1 / max(1 - coherent, 1e-6)
        return Interference(effect, f, parameters, deviation, 0.0, ratio, significance, name, heard_hz=heard_hz)
    return None


def _amplitude(sweep: Sweep, rig: Rig, signal: str, frequency_hz: float) -> tuple[float, float, float]:
    """Amplitude of a signal's own hum, without what feedback makes, its standard deviation, and its share of all hum.

    Zeros where no line is near enough.
    """
    X = sweep.I if signal == "i" and sweep.I is not None else sweep.Y
    own, whole = (hum_power(sweep, Z, frequency_hz) for Z in (_own(sweep, rig, signal, frequency_hz), X))
    if not own.size:
        return 0.0, 0.0, 0.0
    power = max(float(own.mean()), 0.0)
    amplitude = float(np.sqrt(power))
    deviation = float(own.mean(axis=1).std() / np.sqrt(len(own)) / (2 * amplitude)) if power else 0.0
    return amplitude, deviation, float(np.sqrt(power / max(float(whole.mean()), 1e-300)))


def _own(sweep: Sweep, rig: Rig, signal: str, frequency_hz: float) -> Complex:
    """A signal without what the controller's output makes of it at a frequency, (P, B, H, n), A or m."""
    model = linear_model(rig, np.array([frequency_hz]))
    G, X = (model.i_per_u[0], sweep.I) if signal == "i" and sweep.I is not None else (model.y_per_u[0], sweep.Y)
    return np.asarray(X - sweep.U @ G.T)


def measured_by(source: Interference, sweep: Sweep, rig: Rig) -> Interference:
    """A source detected by its phase, with its amplitude estimated by a twin that was fitted to the sweep.

    Feedback makes most of a hum, so the signal's own part is only as accurate as the model of the loop.
    """
    sweep = usable(sweep)
    amplitude, deviation, _ = _amplitude(sweep, rig, source.signal, source.frequency_hz)
    if not amplitude:
        return source
    f, f_deviation = source.frequency_hz, 0.0
    if source.effect != "runout":  # whose frequency is the rotor's, and no parameter
        f, f_deviation = hum_frequency(sweep, sweep.Y if sweep.I is None or source.signal == "y" else sweep.I, f)
    parameters = _parameters(source.effect, f, source.signal, amplitude)
    deviation = float(np.hypot(deviation, LAW_ERROR * amplitude))
    return replace(source, parameters=parameters, std=deviation, frequency_std_hz=f_deviation)


def _by_size(
    sweep: Sweep, rig: Rig, effect: str, frequency_hz: float, signal: str, variance: Real
) -> Interference | None:
    """The interference at a frequency as the size of the scatter near it has it.

    None where too few lines are near, or where there is as much on one side.

    ``variance`` is that of the signal's means, (P, H, n).
    """
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    away = np.abs(at / frequency_hz - 1)
    quiet = quiet_cells(sweep, rig)
    near, far = quiet & (away < NEAR_HUM), quiet & (away > FAR_FROM_HUM[0]) & (away < FAR_FROM_HUM[1])
    if near.sum() < 4 or far.sum() < 4 or np.mean(variance[quiet] > 0) < SCATTERS:
        return None
    log_variance = np.log(np.maximum(variance, 1e-300))
    level, floor = (log_variance[cells].mean(axis=0) for cells in (near, far))
    sides = [log_variance[side].mean() for side in (far & (at < frequency_hz), far & (at > frequency_hz)) if side.any()]
    if level.mean() < max(sides) + np.log(ABOVE_BOTH):
        return None
    blocks = sweep.Y.shape[1]
    # The log of a variance of B blocks scatters by about 1 / sqrt(B - 1); channels count as one, as they may share it.
    deviation = float(np.sqrt((1 / near.sum() + 1 / far.sum()) / (blocks - 1)))
    log_ratio = float((level - floor).mean())
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
        amplitude * deviation / 2,
        float(level.mean()),
        float(np.exp(log_ratio)),
        log_ratio / deviation,
        signal,
        shape,
        frequency_std_hz=NEAR_HUM * frequency_hz,
    )


def _parameters(effect: str, frequency_hz: float, signal: str, amplitude: float) -> dict[str, float]:
    """Parameters of the effect that adds such a hum to a signal."""
    if effect == "runout":
        return {"amplitude_m": amplitude}
    name, other = ("amplitude_a", "amplitude_m") if signal == "i" else ("amplitude_m", "amplitude_a")
    return {name: amplitude, other: 0.0, "frequency_hz": frequency_hz}


def quiet_cells(sweep: Sweep, rig: Rig) -> NDArray[np.bool_]:
    """Harmonics of points whose scatter is used, (P, H): not near a flexible mode, which rings, nor harmonic 0."""
    harmonics = np.array(sweep.harmonics)
    return ~_near_modes(sweep.frequency_hz[:, None] * harmonics, rig) & (harmonics > 0)


def _near_modes(at_hz: Real, rig: Rig) -> NDArray[np.bool_]:
    modes = np.array([m.natural_frequency_rad_s for plane in rig.rotor.modes for m in plane]) / (2 * np.pi)
    return np.asarray(np.any(np.abs(at_hz[..., None] - modes) < 0.1 * modes, axis=-1))


def at_speed(sources: Sequence[Interference], speed_rad_s: float) -> tuple[Interference, ...]:
    """The sources as they are in a sweep at this speed: runout follows the rotor, and vanishes at standstill."""
    out = []
    for s in sources:
        if s.effect != "runout":
            out.append(s)
        elif speed_rad_s:
            hz = once_a_turn_hz(speed_rad_s)
            out.append(replace(s, frequency_hz=hz, heard_hz=(hz,) if s.heard_hz else ()))
    return tuple(out)


def once_a_turn_hz(speed_rad_s: float) -> float:
    """Revolutions per second, of either sense."""
    return abs(speed_rad_s) / (2 * np.pi)


def hums_hz(sources: Sequence[Interference], speed_rad_s: float) -> tuple[float, ...]:
    """Frequencies at which a sweep at this speed may have the sources, each with its `MULTIPLES`."""
    return tuple(k * s.frequency_hz for s in at_speed(sources, speed_rad_s) for k in MULTIPLES)
