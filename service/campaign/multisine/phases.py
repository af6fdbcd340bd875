"""A multisine campaign in order: noise, pilot, main sweep, validation, amplifiers.

Like `service.campaign.phases` every decision follows from profile and measurements, so a campaign can be resumed.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from service.campaign.aims import Limits, Profile
from service.campaign.knowledge import Knowledge
from service.campaign.multisine import distortion, plan
from service.campaign.multisine.design import Design, design_of
from service.campaign.multisine.plan import MultisineProfile, PeriodicRequest, Responses
from service.campaign.noise import NoiseSpectra
from service.campaign.noise_phases import NoisePhases
from service.campaign.plan import Request
from service.campaign.points import Point
from service.campaign.points import sweep as swept
from service.campaign.progress import Meter
from service.campaign.recorder import Recorder, Trip
from service.campaign.settling import period_change
from service.experiment.errors import CampaignError
from service.experiment.multisine import Lines, Multisine, separated, spectra
from sim.datasheet import Datasheet

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

NAMES = ("r", "u", "i", "y")
PILOT_TRIES = 4
LOWER = 0.5
"""Level after a trip, against the one that tripped."""
SETTLED = ("main", "validation")
"""Sweeps whose responses are sharp. An amplifier's current follows its control signal at once, and a pilot is rough."""
LONGEST_S = 10.0
"""Settling that is begun with, at most: the pilot does not tell the decay of a loop that hardly damps a mode."""
LASTING = 0.5
"""A change between periods that a doubled settling time does not lower to this share (of power) is no transient."""
NEGLIGIBLE = 5e-4
"""Relative change between periods that does not matter: a quarter of the accuracy of a stepped sine's point."""
DISTORTED = 0.05
"""Odd distortion of the current over its signal above which an amplifier is at its limit."""

TOLERANCE = 1.5
"""What `settling.period_change` may reach: the noise it is compared with was estimated, from a short record."""
TOLERABLE = 4.0
"""A change beyond that is not taken for noise, however it lasts."""
REST_PERIODS = 4
"""Periods without excitation: noise with the resolution of the lines, which a spectrum of short segments smears."""


@dataclass(frozen=True)
class Ringing:
    """A transient was not over; what it exceeds the noise by, see `settling.period_change`."""

    excess: float


@dataclass(frozen=True)
class Played:
    """One realisation, every experiment of it: (E, P, L + D, n) amplitudes by signal, detection lines last."""

    multisine: Multisine
    values: dict[str, Complex]
    peak_displacement_m: float
    """NaN where it is not known of all of them."""
    peak_current_a: float
    kurtosis: Real
    """(n_axes,) E[y^4] / (3 E[y^2]^2) over all experiments: 1 for Gaussian."""
    speeds_rad_s: tuple[float, ...] = ()
    """At which the rotor turned, of those experiments of which that is known."""

    def columns(self) -> dict[str, Complex]:
        """(P, L, inputs, n) of every period, each input as if alone."""
        L = len(self.multisine.lines.excited)
        return {
            s: np.array([separated(v[:, p, :L], self.multisine) for p in range(v.shape[1])])
            for s, v in self.values.items()
        }


class MultisinePhases:
    """A multisine campaign under way.

    Parameters
    ----------
    recorder, limits, profile, meter, done
        As for `service.campaign.phases.Phases`.
    extra
        Filled with what belongs to the experiment beside its points: "distortion" levels as JSON, and why the main
        sweep was not designed for the rig, where it was not.
    datasheet, speed_rad_s
        Of the rig, to fit the pilot's model; None for amplitudes that need no model.
    """

    def __init__(
        self,
        recorder: Recorder,
        limits: Limits,
        profile: MultisineProfile,
        meter: Meter,
        done: dict[str, list[Point]],
        extra: dict[str, str],
        datasheet: Datasheet | None = None,
        speed_rad_s: float = 0.0,
    ) -> None:
        self.recorder, self.limits, self.profile, self.meter, self.done = recorder, limits, profile, meter, done
        self.extra, self.datasheet, self.speed_rad_s = extra, datasheet, speed_rad_s
        self.design: Design | None = None
        self.settle_s = profile.settle_s
        self.tolerance = TOLERANCE
        self._rest: dict[str, Real] = {}
        self.knowledge = Knowledge(NoiseSpectra.unmeasured(), limits.n_axes)
        self._levels: dict[str, dict[str, dict[str, list[float | None]]]] = {}

    def run(self, raw_records: bool) -> None:
        """All phases in order."""
        p = self.profile
        self.meter.total = self.limits.n_axes * (
            1 + p.realisations + p.validation_realisations + p.amplifier_realisations
        )
        rest = NoisePhases(self.recorder, self.limits, Profile(), self.meter, self.done)
        self.knowledge = Knowledge(rest.at_rest(raw_records), self.limits.n_axes)
        self.at_rest()
        responses = self.pilot()
        responses.into(self.knowledge)
        self.settle_s = self._first_settling()
        for sweep in ("main", "validation", "amplifier"):
            self.sweep(sweep, responses)

    # ---- rest and pilot

    def at_rest(self) -> None:
        """Noise of every line of the main sweep's grid, and of its neighbours.

        Raises
        ------
        CampaignError
            The rig trips without excitation.
        """
        samples = round(self.profile.period_s * self.limits.sample_rate_hz)
        top = math.ceil(min(self.profile.to_hz, self.limits.max_frequency_hz) * self.profile.period_s) + 2
        request = PeriodicRequest("rest", 0, 0, np.zeros((samples, self.limits.n_axes)), REST_PERIODS, 0)

        def reduction(records: dict[str, Real]) -> dict[str, Any]:
            return {s: np.mean(np.abs(spectra(records[s], samples, np.arange(top))) ** 2, axis=0) for s in ("u", "y")}

        found = self.recorder.reduced("rest", request, reduction)
        if isinstance(found, Trip):
            raise CampaignError(f"the rig trips without excitation ({found.message}); it cannot be measured")
        self._rest = {s: uniform_filter1d(found[s], 3, axis=0) for s in ("u", "y")}

    def pilot(self) -> Responses:
        """Responses of the closed loop from a multisine that is small enough for a rig of which nothing is known.

        Raises
        ------
        CampaignError
            It trips at every level.
        """
        lines = self._lines("pilot")
        gain, why = 1.0, ""
        for _ in range(PILOT_TRIES):
            multisine = plan.pilot(self.profile, self.limits, lines, gain)
            outcome = self._realisation("pilot", 0, multisine)
            if isinstance(outcome, Played):
                columns = {s: v.mean(axis=0) for s, v in outcome.columns().items()}
                self.design = self._designed(lines, outcome)
                r = np.einsum("ljj->lj", columns["r"])
                f = lines.frequency_hz(self.limits.sample_rate_hz)
                per_ampere = {s: np.swapaxes(columns[s] / r[:, :, None], 1, 2) for s in plan.SIGNALS}
                return Responses(f, per_ampere)
            assert isinstance(outcome, Trip)
            gain, why = gain / 4, outcome.message
        raise CampaignError(
            f"the rig trips even with {plan.PILOT_SHARE * gain * 100:.2g} % of the current's share "
            f"({why}); see to the rig, or raise its limits"
        )

    def _designed(self, lines: Lines, pilot: Played) -> Design | None:
        if self.datasheet is None:
            return None
        rate, to_hz = self.limits.sample_rate_hz, min(self.profile.to_hz, self.limits.max_frequency_hz)
        measured = swept(self._points("pilot", lines, [pilot], []), (1,), rate, self.speed_rad_s, "pilot")

        def say(why: str) -> None:
            self.extra["not_designed"] = why

        return design_of(measured, self.datasheet, to_hz, say)

    def _lines(self, sweep: str) -> Lines:
        try:
            hum = self.knowledge.noise.lines_hz
            return plan.lines_of(sweep, self.profile, self.limits, hum, self.design)
        except ValueError as error:
            raise CampaignError(f"no multisine fits: {error}") from error

    # ---- sweeps

    def sweep(self, name: str, responses: Responses) -> None:
        """All realisations of a sweep; each becomes a block of its points."""
        lines = self._lines(name)
        planned = plan.realisations(self.profile, self.limits, name, lines, self.knowledge, responses, self.design)
        gain = 1.0
        played: list[Played] = []
        flags: list[str] = []
        for k, multisine in enumerate(planned):
            outcome, gain = self._patiently(name, k, multisine, gain, flags)
            played.append(outcome)
            self.done[name] = self._points(name, lines, played, flags)
            self._judge(name, played)
        if len(played) < 2:
            self.done.pop(name, None)

    def _patiently(
        self, name: str, k: int, multisine: Multisine, gain: float, flags: list[str]
    ) -> tuple[Played, float]:
        """One realisation, at a lower level or settled for longer when it has to be."""
        lowered = lengthened = 0
        before, waited = 0.0, self.settle_s
        while lowered < self.profile.tries:
            outcome = self._realisation(name, k, multisine.scaled(gain))
            if isinstance(outcome, Ringing):
                longer = max(2 * self.settle_s, self.settle_s + self.profile.period_s / 2)
                if LASTING * before < outcome.excess < TOLERABLE and before:
                    # a longer wait did not lower it, so it is noise that the record at rest does not tell
                    self.settle_s, self.tolerance = waited, 2 * max(outcome.excess, before)
                elif lengthened == self.profile.tries or not self._may_settle(longer, multisine, name):
                    self.tolerance = np.inf
                    _mark(flags, "not settled")
                else:
                    waited, self.settle_s = self.settle_s, longer
                    lengthened += 1
                before = outcome.excess
            elif isinstance(outcome, Trip):
                gain *= LOWER
                lowered += 1
                _mark(flags, f"repeated at lower amplitude after a {outcome.cause} trip")
            elif self._distorted(outcome) and lowered < self.profile.tries - 1:
                gain *= LOWER
                lowered += 1
                _mark(flags, "repeated at lower amplitude: the current was distorted")
            else:
                return outcome, gain
        raise CampaignError(
            f"the {name} multisine trips at every level down to {gain:.2g} of the planned one; see to the rig"
        )

    def _settling(self, name: str) -> float:
        return self.settle_s if name in SETTLED else self.profile.short_settle_s

    def _may_settle(self, seconds: float, multisine: Multisine, name: str) -> bool:
        record = plan.periods_of(name, self.profile) * multisine.lines.samples
        return plan.settle_samples(seconds, self.limits) + record <= self.limits.max_samples

    def _first_settling(self) -> float:
        """What is begun with: as long as the pilot's model asks for, s, and one record has beside the periods."""
        p, rate = self.profile, self.limits.sample_rate_hz
        if self.design is None:
            return p.settle_s
        record = max(plan.periods_of(name, p) for name in SETTLED) * round(p.period_s * rate)
        return max(p.settle_s, min(self.design.settle_s(), LONGEST_S, (self.limits.max_samples - record - 1) / rate))

    def _distorted(self, played: Played) -> bool:
        levels = self._pooled([played], "i")
        return bool(np.any(levels.odd > DISTORTED * levels.signal))

    def _realisation(self, name: str, k: int, multisine: Multisine) -> Played | Trip | Ringing:
        """All experiments of one realisation, or what ended it early."""
        lines = multisine.lines
        both = np.concatenate([lines.excited, lines.detection])

        def reduction(records: dict[str, Real]) -> dict[str, Any]:
            y = records["y"] - records["y"].mean(axis=0)
            values = {s: spectra(records[s], lines.samples, both) for s in NAMES}
            return values | {"moments": np.array([np.mean(y**2, axis=0), np.mean(y**4, axis=0)])}

        found: list[dict[str, Any]] = []
        for e in range(multisine.n_inputs):
            request = PeriodicRequest(
                name,
                k,
                e,
                multisine.waveform(e),
                plan.periods_of(name, self.profile),
                plan.settle_samples(self._settling(name), self.limits),
            )
            outcome = self.recorder.reduced(name, request, reduction)
            if isinstance(outcome, Trip):
                return outcome
            if name in SETTLED and (excess := self._excess(multisine, outcome)) > self.tolerance:
                return Ringing(excess)
            found.append(outcome)
            told = f"realisation {k + 1}, experiment {e + 1}"
            self.meter.finished(name, told, self.recorder.replaying, self.recorder.rig_seconds)
        values = {s: np.array([x[s] for x in found]) for s in NAMES}
        second, fourth = np.mean([x["moments"] for x in found], axis=0)
        return Played(
            multisine,
            values,
            float(np.max([x["peak_displacement_m"] for x in found])),
            float(np.max([x["peak_current_a"] for x in found])),
            # a log coarser than the motion shows none
            np.divide(fourth, 3 * second**2, out=np.ones_like(fourth), where=second > 0),
            tuple(x["speed_rad_s"] for x in found if x["speed_rad_s"] is not None),
        )

    def _excess(self, multisine: Multisine, found: dict[str, Any]) -> float:
        """Change from the first period to the last over what chance allows.

        Of y, and of u, which is small where a plant resonates.
        """
        lines, rate = multisine.lines, self.limits.sample_rate_hz
        L = len(lines.excited)
        smooth = [self.knowledge.noise.block_variance(float(f), lines.samples / rate) for f in lines.frequency_hz(rate)]
        ratios = []
        for s in ("u", "y"):
            X = found[s][:, :L]
            variance = np.maximum(self._rest[s][lines.excited], np.array([v[s] for v in smooth]))
            size = np.sqrt(np.mean(np.abs(X) ** 2, axis=(0, 2)))
            ratios.append(period_change(X[0], X[-1], variance, NEGLIGIBLE * size))
        return max(ratios)

    # ---- what it gives

    def _points(self, name: str, lines: Lines, played: list[Played], flags: list[str]) -> list[Point]:
        """Points of a sweep: a block is a period of a realisation, so that blocks scatter by noise and distortion."""
        columns = [p.columns() for p in played]
        stacked = {s: np.concatenate([c[s] for c in columns]) for s in NAMES}  # (B, L, inputs, n)
        # the excitation that was played is rounded: its own phase, not the planned one, is the time origin
        late = np.angle(np.einsum("bljj->blj", stacked["r"]))
        stacked = {s: v * np.exp(-1j * late)[..., None] for s, v in stacked.items()}
        f = lines.frequency_hz(self.limits.sample_rate_hz)
        periods, settle = (
            plan.periods_of(name, self.profile),
            plan.settle_samples(self._settling(name), self.limits),
        )
        # of all that a point is made of, the speed that is furthest from the campaign's
        speeds = [w for p in played for w in p.speeds_rad_s]
        speed = max(speeds, key=lambda w: abs(w - self.speed_rad_s), default=None)
        points = []
        for k, line in enumerate(lines.excited):
            for axis in range(self.limits.n_axes):
                amplitude = float(np.mean(np.abs(stacked["r"][:, k, axis, axis])))
                request = Request(axis, amplitude, int(line), lines.samples, periods * len(played), settle)
                R, U, I, Y = (stacked[s][:, k, axis][:, None, :] for s in NAMES)
                points.append(
                    Point(
                        request,
                        float(f[k]),
                        R,
                        U,
                        I,
                        Y,
                        float(np.max([p.peak_displacement_m for p in played])),
                        float(np.max([p.peak_current_a for p in played])),
                        self.recorder.rig_seconds,
                        "; ".join(flags),
                        kind="multisine",
                        phase_rad=late[:, k, axis]
                        + np.repeat([np.angle(p.multisine.spectrum[k, axis]) for p in played], periods),
                        kurtosis=np.mean([p.kurtosis for p in played], axis=0),
                        speed_rad_s=speed,
                    )
                )
        return points

    def _pooled(self, played: list[Played], signal: str) -> distortion.Distortion:
        return distortion.pooled([distortion.levels(v, p.multisine.lines) for p in played for v in p.values[signal]])

    def _judge(self, name: str, played: list[Played]) -> None:
        """Noise, odd and even distortion of current and displacement, dB over the signal, for the file."""
        found: dict[str, dict[str, list[float | None]]] = {}
        for s in ("i", "y"):
            decibels = self._pooled(played, s).in_decibels()
            found[s] = {k: [None if np.isinf(x) else round(float(x), 1) for x in v] for k, v in decibels.items()}
        self._levels[name] = found
        self.extra["distortion_db"] = json.dumps(self._levels)


def _mark(flags: list[str], flag: str) -> None:
    if flag not in flags:
        flags.append(flag)
