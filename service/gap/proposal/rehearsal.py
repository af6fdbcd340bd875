"""The service's own campaign rehearsed on a twin: which tones it will play, of which amplitudes, and how long it takes.

The planner that moves a real rotor requests its tones, and the twin's linear model answers, with the noise of the rig's
sensors and with the transient of each start, so that the planner waits for settling as on the rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Limits, Profile
from service.campaign.knowledge import Knowledge
from service.campaign.multisine.plan import PeriodicRequest
from service.campaign.noise import SIGNALS, NoiseSpectra
from service.campaign.noise_phases import NOISE_S, PERIODIC_S
from service.campaign.phases import Phases
from service.campaign.plan import Request
from service.campaign.points import Point
from service.campaign.progress import Meter
from service.campaign.recorder import Recorder
from service.gap.proposal.sensor_noise import SensorNoise
from sim.harmonic_balance import STATIC_HZ
from sim.loop import Loop
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

HARMONICS = (0, 1, 2, 3)
RAMP_PERIODS, SHORTEST_RAMP_S, LONGEST_RAMP_S = 2, 0.02, 0.25
"""Duration of the ramp at either end of a tone, in periods and within these limits."""
SLOW_S = 1e-3
"""Time constant from which a pole's transient may outlast a ramp."""
GONE = 1e-6
"""Magnitude up to which a pole of the sampled loop is that of a delay, and has no transient."""
MOST_SAMPLES = 2_000_000
"""Samples of a tone that a controller is assumed to hold."""


@dataclass(frozen=True)
class Rehearsal:
    """The points of a campaign."""

    points: Mapping[str, list[Point]]
    """by sweep, as a campaign has them; their signals are those of the linear model, at the fundamental only"""
    rig_seconds: float


@dataclass(frozen=True)
class _Answer:
    """Answer to a requested tone, as `service.campaign.recorder.Answer`."""

    R: Complex
    U: Complex
    I: Complex
    Y: Complex
    rig_seconds: float
    peak_displacement_m: float = 0.0
    peak_current_a: float = 0.0
    records: None = None


class _LinearRig:
    """A rig that answers requested tones by its linear model."""

    def __init__(self, rig: Rig, rate: float, noise: NoiseSpectra) -> None:
        self._rig, self._rate, self._noise = rig, rate, noise
        self._draws = np.random.default_rng(0)  # so that proposals are reproducible
        self._known: dict[float, Complex] = {}
        z = np.linalg.eigvals(Loop(rig, 1).closed_loop())
        poles = np.log(z[np.abs(z) > GONE].astype(complex)) * rate
        poles = poles[(poles.imag >= 0) & (poles.real > -1 / SLOW_S) & (poles.real < 0)]
        self._poles = poles[np.argsort(poles.imag)]
        self._at_poles = _per_ampere(rig, np.maximum(self._poles.imag / (2 * np.pi), STATIC_HZ))

    def __call__(self, request: Request | PeriodicRequest) -> _Answer:
        assert isinstance(request, Request)
        f, axis, k = request.frequency_hz(self._rate), request.axis, HARMONICS.index(1)
        ramp_s = float(np.clip(RAMP_PERIODS / f, SHORTEST_RAMP_S, LONGEST_RAMP_S)) if request.amplitude_a else 0.0
        if f not in self._known:
            self._known[f] = _per_ampere(self._rig, np.array([f]))[:, 0]
        answer = self._known[f][:, None, :, axis] + self._transient(f, request, ramp_s)
        variance = self._noise.block_variance(f, request.samples / self._rate)
        noise = np.sqrt([variance[signal] for signal in SIGNALS])[:, None]
        signals = np.zeros((4, request.blocks, len(HARMONICS), self._rig.n_axes), dtype=complex)
        signals[0, :, k, axis] = request.amplitude_a
        signals[1:, :, k] = request.amplitude_a * answer + noise * self._white(answer.shape)
        R, U, I, Y = signals
        return _Answer(R, U, I, Y, request.seconds(self._rate) + 2 * ramp_s)

    def _transient(self, f: float, request: Request, ramp_s: float) -> Complex:
        """Mean of the loop's transients in each block after the start of a tone, per ampere, (3, B, n).

        A slow pole p responds nearly as r / (s - p) with r = -Re p G(Im p). A raised-cosine ramp of T seconds excites
        it by (k^2 / 2) (1 + exp(a T)) / (k^2 + a^2) of what a step does, with a = p - j w and k = pi / T.
        """
        if not ramp_s:
            return np.zeros((3, request.blocks, self._rig.n_axes), dtype=complex)
        seconds = request.samples / self._rate
        begins = (request.settle_samples + np.arange(request.blocks) * request.samples) / self._rate
        a, k = self._poles - 2j * np.pi * f, np.pi / ramp_s
        excited = 0.5 * k**2 * (1 + np.exp(a * ramp_s)) / (k**2 + a**2)
        decayed = np.exp(np.outer(begins, a)) * np.expm1(a * seconds) / (a * seconds)
        at_start = self._at_poles[..., request.axis] * (-self._poles.real / a * excited)[:, None]
        return np.asarray(np.einsum("bp,spi->sbi", decayed, at_start))

    def _white(self, shape: tuple[int, ...]) -> Complex:
        """Complex white noise of unit variance."""
        parts = self._draws.standard_normal((2, *shape)) / np.sqrt(2)
        return np.asarray(parts[0] + 1j * parts[1])


def _per_ampere(rig: Rig, frequency_hz: Real) -> Complex:
    """u, i and y per ampere of excitation in closed loop, (3, F, n, n)."""
    model = linear_model(rig, frequency_hz)
    u_per_r = model.u_per_r
    return np.stack([u_per_r, model.i_per_u @ u_per_r, model.y_per_u @ u_per_r])


class BegunCampaign:
    """The campaign of a profile on a rig, rehearsed up to its main sweep."""

    def __init__(self, rig: Rig, limits: Limits, profile: Profile, noise: SensorNoise) -> None:
        """Rehearse it.

        Raises
        ------
        LevitationError
            Its controller does not hold that rig.
        CampaignError
            The planner cannot go on.
        """
        rate = limits.sample_rate_hz
        spectra = noise.spectra(rig, rate / 2)
        self._recorder = Recorder(_LinearRig(rig, rate, spectra), [], lambda _: None, rate, HARMONICS)
        self._n_axes = rig.n_axes
        self._done: dict[str, list[Point]] = {}
        self._phases = Phases(self._recorder, limits, profile, Meter(None), self._done)
        self._phases.knowledge = Knowledge(spectra, rig.n_axes)
        self._phases.preliminary_sweep()
        self._phases.main_sweep()

    @property
    def main(self) -> Sequence[Point]:
        """Points of the main sweep."""
        return self._done.get("main", ())

    def whole(self) -> Rehearsal:
        """The campaign with the sweeps that follow; asked for once.

        Raises
        ------
        CampaignError
            The planner cannot go on.
        """
        self._phases.validation_sweep()
        self._phases.amplifier_sweep()
        return Rehearsal(self._done, self._recorder.rig_seconds + NOISE_S + PERIODIC_S * self._n_axes)
