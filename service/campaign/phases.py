"""The phases of a campaign in order: noise, preliminary sweep, main sweep, peaks, validation, amplifiers.

Every decision follows from the profile and from what has been measured, nothing from the clock, so the same answers of
the rig give the same questions: that is what makes a campaign resumable.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.campaign import frequencies, plan
from service.campaign.aims import Aim, Limits, Profile, aims
from service.campaign.knowledge import Knowledge
from service.campaign.noise import NoiseSpectra
from service.campaign.noise_phases import NoisePhases
from service.campaign.peaks import densification, merged, peaks, resolved
from service.campaign.plan import Request
from service.campaign.points import Point, responses, unmeasured
from service.campaign.progress import Meter
from service.campaign.quality import judge
from service.campaign.recorder import Recorder, Trip
from service.campaign.settling import Agreement, longer, stationary, tolerable
from service.experiment.errors import CampaignError

Real = NDArray[np.float64]

PEAK_ROUNDS = 6
CLOSELY = 1e-4
"""Relative distance within which a frequency of the profile is met: a tenth of a mode's width at a damping ratio of
0.0005."""
TRIPS = 7
"""A point whose amplitude was halved that often and still trips is given up."""
FIRST_GIVEN_UP, GIVEN_UP = 3, 10
"""So many points of an axis that are given up in a row end the campaign: of one of which nothing was measured yet, and
of any other. Each is a rotor that was at its limit seven times; a resonance that cannot be passed is narrower."""


class Phases:
    """A campaign under way.

    Parameters
    ----------
    recorder
        The rig, through the journal.
    limits, profile
        What is allowed and what is wanted.
    meter
        Told of every point.
    done
        Finished points by sweep; filled as they come, so that an interrupted campaign can keep them.
    """

    def __init__(
        self, recorder: Recorder, limits: Limits, profile: Profile, meter: Meter, done: dict[str, list[Point]]
    ) -> None:
        self.recorder, self.limits, self.profile, self.meter, self.done = recorder, limits, profile, meter, done
        self.aims = aims(profile, limits)
        self._noise = NoisePhases(recorder, limits, profile, meter, done)
        self.knowledge = Knowledge(NoiseSpectra.unmeasured(), limits.n_axes)
        self._given_up_in_a_row = [0] * limits.n_axes

    # ---- noise

    def noise_step(self, raw: bool) -> None:
        """Zero-excitation record: spectra for the plan, and the noise sweep of the file."""
        self.knowledge = Knowledge(self._noise.at_rest(raw), self.limits.n_axes)

    def periodic_step(self) -> None:
        """Noise under excitation, joined with that at rest."""
        self._noise.excited(self.knowledge, self.aims["coarse"])

    # ---- sweeps

    def preliminary_sweep(self) -> None:
        """A coarse sweep from the top down, where a rotor moves least per ampere."""
        to = min(self.profile.to_hz, self.limits.max_frequency_hz)
        for f in frequencies.grid(self.profile.from_hz, to, self.profile.coarse_points)[::-1]:
            self._frequency("preliminary", "coarse", float(f))

    def main_sweep(self) -> None:
        """The log-spaced grid, then what its peaks need."""
        aim, lines = self.aims["main"], self.knowledge.noise.lines_hz
        if self.profile.frequencies_hz:
            self._given_frequencies()
            return
        for f in frequencies.main_grid(self.profile, self.limits, aim, lines):
            self._frequency("main", "main", float(f))
        for _ in range(PEAK_ROUNDS):
            new = self._missing_at_peaks()
            if not len(new):
                return
            self.meter.total += len(new) * self.limits.n_axes
            for f, tolerance in new:
                self._frequency("main", "main", f, tolerance, shown="peaks")

    def _given_frequencies(self) -> None:
        """The profile's own frequencies, met closely: one may have been chosen for its place on a narrow peak."""
        given = frequencies.main_grid(self.profile, self.limits, self.aims["main"], ())
        self._expect(len(given), self.profile.points)
        waits = dict(zip(self.profile.frequencies_hz, self.profile.settle_s, strict=False))
        for f in given:
            others = given[given != f]
            nearest = float(np.min(np.abs(others - f))) if len(others) else np.inf
            tolerance = min(0.2 * nearest, CLOSELY * float(f))
            self._frequency("main", "main", float(f), tolerance, least_settle_s=waits.get(float(f), 0.0))

    def _missing_at_peaks(self) -> list[tuple[float, float]]:
        """Frequencies that peaks of the plant still need, each with how closely it must be met."""
        f, U, Y = responses(self.done["main"], self.limits.n_axes)
        # Where the rotor stands against a stop a tone may move nothing, and U has no inverse.
        usable = np.isfinite(U).all(axis=(1, 2)) & (np.linalg.matrix_rank(np.nan_to_num(U)) == U.shape[-1])
        f, U, Y = f[usable], U[usable], Y[usable]
        if not len(f):
            return []
        G = Y @ np.linalg.inv(U)
        found = []
        for start in range(0, self.limits.n_axes, 2):
            entries = G[:, start : start + 2, start : start + 2].reshape(len(f), -1)
            size = np.linalg.norm(entries, axis=1, keepdims=True)
            deviation = self.aims["main"].accuracy * size * np.ones((1, entries.shape[1]))
            found += peaks(f, entries, deviation, self.aims["main"].accuracy)
        new: list[tuple[float, float]] = []
        known = f
        for peak in merged(found):
            if resolved(peak, f, self.profile.peak_points):
                continue
            step = peak.half_width_hz / self.profile.peak_points / 2
            added = densification(peak, known, self.profile.peak_points)
            known = np.sort(np.concatenate([known, added]))
            new += [(float(x), step) for x in added]
        return sorted(new)

    def validation_sweep(self) -> None:
        """Other frequencies, another amplitude: no fit sees them."""
        f, _, _ = responses(self.done["main"], self.limits.n_axes)
        if len(f) < 2 or not self.profile.validation_points:
            return
        between = frequencies.validation_grid(self.profile, self.aims["validation"], f, self.knowledge.noise.lines_hz)
        self._expect(len(between), self.profile.validation_points)
        for x in between:
            self._frequency("validation", "validation", float(x), tolerance_hz=0.1 * float(np.min(np.abs(f - x))))

    def amplifier_sweep(self) -> None:
        """Each amplifier alone, to the top of its range."""
        if not self.profile.amplifier_points:
            return
        aim = self.aims["amplifier"]
        for f in frequencies.amplifier_grid(self.profile, self.limits, aim, self.knowledge.noise.lines_hz):
            self._frequency("amplifier", "amplifier", float(f))

    def _frequency(
        self,
        sweep: str,
        aim_name: str,
        frequency_hz: float,
        tolerance_hz: float = np.inf,
        shown: str = "",
        least_settle_s: float = 0.0,
    ) -> None:
        """All axes at one frequency."""
        aim = self.aims[aim_name]
        for request in plan.tones(self.knowledge, frequency_hz, aim, self.profile, self.limits, tolerance_hz):
            if sweep == "validation":
                request = plan.other_amplitude(request, self.knowledge, self.aims, self.profile, self.limits)
            least = math.ceil(least_settle_s * self.limits.sample_rate_hz)
            if request.settle_samples < least:
                request = replace(request, settle_samples=plan.longest_settling(request, self.limits, least_settle_s))
            point = self._point(sweep, request, aim)
            self.done.setdefault(sweep, []).append(point)
            self._report(
                shown or sweep,
                f"{point.frequency_hz:.5g} Hz axis {point.request.axis} {point.request.amplitude_a:.3g} A"
                + (f" ({point.flag})" if point.flag else ""),
            )

    # ---- one point

    def _point(self, phase: str, request: Request, aim: Aim) -> Point:
        """Measure one point until it is good or its tries are spent; what was wrong is written on it."""
        rate, steps = self.limits.sample_rate_hz, self.limits.amplitude_steps_per_a
        flags: list[str] = []
        trips = 0
        best: Point | None = None
        attempts: list[tuple[float, Agreement]] = []
        ceiling = math.inf
        tries = self.profile.tries
        while tries > 0:
            outcome = self.recorder.point(phase, request)
            request = outcome.request or request
            if isinstance(outcome, Trip):
                self.knowledge.tripped(request.axis)
                trips += 1
                _mark(flags, f"repeated at lower amplitude after a {outcome.cause} trip")
                ceiling = request.amplitude_a / 2
                if best is not None:
                    break
                lower = request.with_amplitude(ceiling, steps)
                if trips >= TRIPS or lower.amplitude_a >= request.amplitude_a:
                    return self._given_up(request, outcome)
                request = lower
                continue
            tries -= 1
            before, best = best, outcome
            self.knowledge.held(request.axis)
            self._given_up_in_a_row[request.axis] = 0
            waited = request.settle_samples / rate
            self.knowledge.add(request.axis, outcome.frequency_hz, *outcome.per_ampere(), waited)
            verdict = judge(outcome, self.knowledge, aim, self.limits, before)
            a = min(verdict.better_amplitude_a, ceiling)
            other = request.with_amplitude(a, steps)
            lower_still = other.amplitude_a < request.amplitude_a
            slew = 2 * math.pi * outcome.frequency_hz * float(abs(outcome.I[:, 1, request.axis].mean()))
            (self.knowledge.saturated if verdict.saturated else self.knowledge.followed)(slew)
            if verdict.saturated and tries > 1 and lower_still:
                _mark(flags, "repeated at lower amplitude: the current was distorted")
                request = other
                ceiling = a
                continue
            higher = verdict.too_small and other.amplitude_a > 1.2 * request.amplitude_a
            if tries and (higher or (verdict.too_large and lower_still)):
                _mark(flags, f"repeated at {'lower' if verdict.too_large else 'higher'} amplitude")
                request = other
                continue
            if verdict.saturated:
                _mark(flags, "the current is distorted")
            if verdict.agreement.settled:
                break
            if attempts and stationary(attempts[-1][1], verdict.agreement):
                if not tolerable(verdict.agreement):
                    _mark(flags, "scatters more than the noise at rest")
                break
            attempts.append((waited, verdict.agreement))
            earlier = attempts[-2] if len(attempts) > 1 else None
            settle = plan.longest_settling(
                request, self.limits, longer(waited, verdict.agreement, request.samples / rate, earlier)
            )
            if not tries or settle <= request.settle_samples:
                _mark(flags, "not settled")
                break
            request = replace(request, settle_samples=settle)
        assert best is not None
        return replace(best, flag="; ".join(flags))

    def _given_up(self, request: Request, trip: Trip) -> Point:
        """A point that trips at every amplitude: it stays in the sweep, unmeasured, if the rotor rests without it."""
        rest = self.recorder.point("rest", replace(request, amplitude_a=0.0), keep_trip=False)
        if isinstance(rest, Trip):
            raise CampaignError(
                f"the rig trips without excitation, the rotor did not come to rest again ({rest.message}); "
                "see to the rig before it is excited again"
            )
        axis = request.axis
        self._given_up_in_a_row[axis] += 1
        in_a_row = self._given_up_in_a_row[axis]
        if in_a_row == (GIVEN_UP if self.knowledge.knows(axis) else FIRST_GIVEN_UP):
            raise CampaignError(
                f"axis {axis} trips at every amplitude, at {in_a_row} frequencies in a row ({trip.message}); see to "
                f"the rig and to its limits, then {self.recorder.anew}"
            )
        why = f"not measured: {trip.cause} trip at every amplitude down to {request.amplitude_a:.2g} A"
        frequency = request.frequency_hz(self.limits.sample_rate_hz)
        harmonics = len(self.recorder.harmonics)
        return unmeasured(request, frequency, self.limits.n_axes, harmonics, self.recorder.rig_seconds, why)

    # ---- progress

    def expected(self) -> int:
        """Points of the whole plan, before peaks are known."""
        p = self.profile
        return self.limits.n_axes * (p.coarse_points + p.points + p.validation_points + p.amplifier_points)

    def _expect(self, found: int, planned: int) -> None:
        self.meter.total += (found - planned) * self.limits.n_axes

    def _report(self, phase: str, last: str) -> None:
        self.meter.finished(phase, last, self.recorder.replaying, self.recorder.rig_seconds)


def _mark(flags: list[str], flag: str) -> None:
    if flag not in flags:
        flags.append(flag)


def run(
    recorder: Recorder,
    limits: Limits,
    profile: Profile,
    raw_records: bool,
    meter: Meter,
    done: dict[str, list[Point]],
) -> None:
    """All phases in order; points appear in ``done`` as they are finished."""
    lowest = min(profile.frequencies_hz, default=profile.from_hz)
    if lowest >= limits.max_frequency_hz:
        raise CampaignError(
            f"the controller plays tones below {limits.max_frequency_hz:g} Hz, and the lowest that is asked for is "
            f"{lowest:g} Hz; correct its highest frequency, or its place and scale in the map"
        )
    phases = Phases(recorder, limits, profile, meter, done)
    meter.total = phases.expected() + (1 + limits.n_axes if raw_records else profile.coarse_points)
    steps: Iterable[Any] = (
        (lambda: phases.noise_step(raw_records)),
        *((phases.periodic_step,) if raw_records else ()),
        phases.preliminary_sweep,
        phases.main_sweep,
        phases.validation_sweep,
        phases.amplifier_sweep,
    )
    for step in steps:
        step()
