"""An option as it would be measured: its rehearsed campaign, and the observation that a diagnosis would get."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Limits, Profile
from service.campaign.points import Point
from service.experiment.data import Sweep
from service.gap.measured.condition import ANOTHER_AMPLITUDE
from service.gap.measured.informative_lines import thinned
from service.gap.measured.observation import Observation, observe
from service.gap.observed import Observed
from service.gap.proposal.options import LOUD, Option, same_speed
from service.gap.proposal.rehearsal import HARMONICS, MOST_SAMPLES, BegunCampaign
from service.gap.proposal.safety import at_rest, free_way
from service.gap.proposal.sensor_noise import SensorNoise, fed_back
from sim.datasheet import Datasheet
from sim.harmonic_balance import STATIC_HZ, Responder, respond_to_excitation, time_points
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

FINEST, COARSEST = 1e-4, 0.3
"""Range of the accuracies that are asked of the planner to reach an amplitude."""
MOSTLY = 0.5
"""Share of a campaign's points that have been measured already, above which it is not a new experiment."""


@dataclass(frozen=True)
class Grounds:
    """What is known for planning: the sweeps measured so far, their noise, and the limits of the rig."""

    sweeps: tuple[Observation, ...]
    noise: SensorNoise
    logged: bool
    """whether the coil current was logged"""
    limits: Limits

    @staticmethod
    def of(data: Observed, datasheet: Datasheet) -> Grounds:
        """From the experiment of a diagnosis, both of its sweeps."""
        noise = SensorNoise.of(data.main, data.nuisance.rig)
        return Grounds((data.o, data.unseen), noise, data.main.I is not None, limits_of(datasheet))


def limits_of(datasheet: Datasheet) -> Limits:
    """The limits of a datasheet; those of a controller may be tighter, but none is connected."""
    d = datasheet
    return Limits.of(
        d, d.sample_rate_hz, np.inf, MOST_SAMPLES, d.current_limit_a, d.displacement_limit_m, d.current_limit_a
    )


@dataclass(frozen=True)
class Case:
    """An option's campaign on a twin, up to its main sweep."""

    option: Option
    """as it is submitted, with the accuracy that leads to the wanted amplitude"""
    campaign: BegunCampaign
    main: Observation
    """the sweep that a diagnosis would fit"""


def case(option: Option, rig: Rig, twin: Rig, grounds: Grounds) -> Case | None:
    """The option on a rig, or None where most of it has been measured already, or its amplitude cannot be reached.

    Nor is there one where tones about a moved set-point would go beyond a limit of displacement or touch a stop.

    Parameters
    ----------
    twin
        Any reasonable twin, for `service.gap.measured.observation.observe`.

    Raises
    ------
    AmbError
        The rig cannot be brought to that condition, or not be measured there.
    """
    at_condition = option.rig(rig)
    option, campaign = _at_amplitude(option, at_condition, grounds)
    excited = _excited(campaign)
    if not excited or np.mean([measured_already(option, p, grounds.sweeps) for p in excited]) > MOSTLY:
        return None
    if option.amplitude is not None:
        reached = _ratio(excited, option.amplitude > 1, grounds)
        if max(reached, 1 / reached) < ANOTHER_AMPLITUDE or (reached > 1) != (option.amplitude > 1):
            return None
    sweep = predicted(excited, at_condition, grounds, option.shift_m(rig))
    if option.offset and np.any(farthest(sweep) > free_way(rig, grounds.limits)):
        return None  # the planner does not know that the rotor is off its place, and leaves no room for it
    return Case(option, campaign, observe(thinned(sweep), twin))


def _at_amplitude(option: Option, rig: Rig, grounds: Grounds) -> tuple[Option, BegunCampaign]:
    """The option with the accuracy for which the planner chooses the wanted amplitude, and its campaign.

    The accuracy is scaled from a first rehearsal, as amplitudes are inversely proportional to it.
    """
    if (times := option.amplitude) is not None:
        if times > 1:
            option = replace(option, profile={**option.profile, **LOUD})
        tried = _excited(BegunCampaign(rig, grounds.limits, option.plan(), grounds.noise))
        wanted = Profile().accuracy * _ratio(tried, times > 1, grounds) / times
        accuracy = float(f"{np.clip(wanted, FINEST, COARSEST):.3g}")
        option = replace(option, profile={**option.profile, "accuracy": accuracy})
    return option, BegunCampaign(rig, grounds.limits, option.plan(), grounds.noise)


def _excited(campaign: BegunCampaign) -> list[Point]:
    return [p for p in campaign.main if p.excited]


def _ratio(points: Sequence[Point], largest: bool, grounds: Grounds) -> float:
    """Median over the points of the amplitude over that of the loudest sweep so far, or of the faintest."""
    ratios = [1.0]
    for p in points:
        of = [amplitude_there(o, p.request.axis, p.frequency_hz) for o in grounds.sweeps]
        if so_far := [a for a in of if a is not None]:
            ratios.append(p.request.amplitude_a / (max(so_far) if largest else min(so_far)))
    return float(np.median(ratios[1:] or ratios))


def amplitude_there(o: Observation, axis: int, frequency_hz: float) -> float | None:
    """Amplitude of a sweep's excitation of an axis at a frequency, A, interpolated log-log; None without excitation."""
    points = np.flatnonzero(o.axis == axis)
    if not len(points):
        return None
    points = points[np.argsort(o.points_hz[points], kind="stable")]
    amplitude = np.maximum(np.abs(o.R[points, o.fundamental, axis]), 1e-300)
    return float(np.exp(np.interp(np.log(frequency_hz), np.log(o.points_hz[points]), np.log(amplitude))))


def measured_already(option: Option, point: Point, sweeps: Sequence[Observation]) -> bool:
    """Whether a sweep was measured at a point's condition: speed, set-point, band and amplitude."""
    f, axis = point.frequency_hz, point.request.axis
    for o in sweeps:
        same = not option.offset and same_speed(option.speed_rad_s, o.speed_rad_s)
        so_far = amplitude_there(o, axis, f) if o.frequency_hz[0] <= f <= o.frequency_hz[-1] else None
        if same and so_far and 1 / ANOTHER_AMPLITUDE < point.request.amplitude_a / so_far < ANOTHER_AMPLITUDE:
            return True
    return False


def farthest(sweep: Sweep) -> Real:
    """Largest way of each axis off the sensors' zero to its positive side, m, (n,), if its harmonics come together."""
    Y, mean = sweep.Y.mean(axis=1), sweep.harmonics.index(0)
    swing = np.abs(np.delete(Y, mean, axis=1)).sum(axis=1)
    return np.asarray(np.max(Y[:, mean].real + swing, axis=0))


def predicted(points: Sequence[Point], rig: Rig, grounds: Grounds, shift_m: Real) -> Sweep:
    """The sweep that points of a campaign would give: the rig's response, all harmonics, with sensor noise added.

    The sensors tell set-points that were moved, by ``shift_m``, as displacement; the model counts from the set-point.
    """
    ordered = sorted(points, key=lambda p: (p.frequency_hz, p.request.axis))
    frequency, line = time_points(np.array([p.frequency_hz for p in ordered]))
    axis, n = np.array([p.request.axis for p in ordered]), rig.n_axes
    amplitude = np.array([p.request.amplitude_a for p in ordered])
    samples, blocks = np.array([p.request.samples for p in ordered]), ordered[0].request.blocks
    R = np.zeros((len(line), len(HARMONICS), n), dtype=complex)
    R[np.arange(len(line)), HARMONICS.index(1), axis] = amplitude
    responder = Responder(rig, frequency, line, HARMONICS, np.linspace(0, 1, len(line)))
    U, answer = respond_to_excitation(responder, R)
    signals = [np.repeat(x[:, None], blocks, axis=1) for x in (R, U, answer.I, answer.Y)]
    if np.any(shift_m):
        signals[3][:, :, HARMONICS.index(0)] += at_rest(grounds.sweeps) + shift_m
    draws = np.random.default_rng(0)  # so that proposals are reproducible

    def white(power: Real) -> Complex:
        """Noise of the blocks, (P, B, n), from its variance for one second at each frequency, (F, n)."""
        shape = (len(line), blocks, n)
        sd = np.sqrt(0.5 * power[line] / (samples / grounds.limits.sample_rate_hz)[:, None])[:, None]
        return np.asarray(sd * (draws.standard_normal(shape) + 1j * draws.standard_normal(shape)))

    for k, h in enumerate(HARMONICS):
        at = np.maximum(h * frequency, STATIC_HZ)
        of_i, of_y = grounds.noise.at(at)
        noise = white(of_y)
        for x, per_noise in zip(signals[1:], fed_back(linear_model(rig, at)), strict=True):
            e = np.einsum("pij,pbj->pbi", per_noise[line], noise)
            x[:, :, k] += e.real if h == 0 else e
        own = white(of_i)
        signals[2][:, :, k] += own.real if h == 0 else own
    return Sweep(
        "stepped-sine",
        frequency[line],
        axis,
        amplitude,
        HARMONICS,
        signals[0],
        signals[1],
        signals[2] if grounds.logged else None,
        signals[3],
        rig.speed_rad_s,
        grounds.limits.sample_rate_hz,
        "main",
        block_samples=samples,
        time_s=np.array([p.time_s for p in ordered]),
    )
