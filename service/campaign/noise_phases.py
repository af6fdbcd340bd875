"""The phases of a campaign that measure noise: at rest, and under excitation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.campaign import noise
from service.campaign.aims import Aim, Limits, Profile
from service.campaign.frequencies import grid, whole_periods
from service.campaign.knowledge import Knowledge
from service.campaign.noise import NoiseSpectra
from service.campaign.plan import Request, amplitude
from service.campaign.points import Point
from service.campaign.progress import Meter
from service.campaign.recorder import Recorder, Trip
from service.experiment.contract import spectral_lines
from service.experiment.demodulate import BlockPlan, amplitudes
from service.experiment.errors import CampaignError

Real = NDArray[np.float64]

NOISE_S = 3.0
"""Zero-excitation record: twenty independent looks at the noise with 4 Hz resolution."""
PERIODIC_S = 0.5


class NoisePhases:
    """Noise of a rig, through the journal.

    Parameters
    ----------
    recorder, limits, profile, meter, done
        As for `service.campaign.phases.Phases`.
    """

    def __init__(
        self, recorder: Recorder, limits: Limits, profile: Profile, meter: Meter, done: dict[str, list[Point]]
    ) -> None:
        self.recorder, self.limits, self.profile, self.meter, self.done = recorder, limits, profile, meter, done

    def at_rest(self, raw: bool) -> NoiseSpectra:
        """Zero-excitation record: spectra for the plan, and the noise sweep of the file.

        Raises
        ------
        CampaignError
            The rig trips without excitation.
        """
        rate, blocks = self.limits.sample_rate_hz, self.profile.blocks
        if not raw:
            return self._from_tones()
        samples = min(round(NOISE_S * rate), self.limits.max_samples) // blocks
        request = Request(0, 0.0, 1, samples, blocks, 0, raw=True)

        def reduction(records: dict[str, Real]) -> dict[str, Any]:
            return {
                **_stored(noise.spectra(records, rate)),
                **_lines(records, samples, blocks, self.recorder.harmonics),
            }

        self._awaits_record(request)
        found = self._certainly("noise", request, reduction)
        self.done["noise"] = [
            Point(
                request=replace(request, periods=int(k), raw=False),
                frequency_hz=int(k) * rate / samples,
                R=found["R"][j],
                U=found["U"][j],
                I=found["I"][j],
                Y=found["Y"][j],
                peak_displacement_m=0.0,
                peak_current_a=0.0,
                time_s=self.recorder.rig_seconds,
                speed_rad_s=found["speed_rad_s"],
            )
            for j, k in enumerate(found["periods"])
        ]
        self._report("zero-excitation record")
        return _restored(found)

    def _from_tones(self) -> NoiseSpectra:
        """The same from a controller that gives no records: unexcited tones, one frequency at a time."""
        rate = self.limits.sample_rate_hz
        requests = []
        top = min(self.profile.amplifier_to_hz, self.limits.max_frequency_hz)
        for f in grid(self.profile.from_hz / 2, top, self.profile.coarse_points):
            periods, samples = whole_periods(f, max(0.1, 1 / f), rate, highest_hz=self.limits.max_frequency_hz)
            requests.append(Request(0, 0.0, periods, samples, self.profile.blocks, 0))
        found = [self._tone_at_rest(r) for r in requests]
        self.done["noise"] = found
        f = np.array([p.frequency_hz for p in found])
        block = np.array([p.request.samples / rate for p in found])
        values = {s: np.array([getattr(p, s.upper())[:, 1] for p in found]) for s in noise.SIGNALS}
        return noise.from_blocks(f, values, block)

    def _tone_at_rest(self, request: Request) -> Point:
        outcome = self.recorder.point("noise", request, keep_trip=False)
        if isinstance(outcome, Trip):
            raise CampaignError(f"the rig trips without excitation ({outcome.message}); it cannot be measured")
        self._report(f"{outcome.frequency_hz:.4g} Hz at rest")
        return outcome

    def _certainly(self, phase: str, request: Request, reduction: Any) -> dict[str, Any]:
        outcome = self.recorder.reduced(phase, request, reduction)
        if isinstance(outcome, Trip):
            raise CampaignError(f"the rig trips without excitation ({outcome.message}); it cannot be measured")
        return outcome

    def excited(self, knowledge: Knowledge, aim: Aim) -> None:
        """Join noise under excitation to what is known: a periodic record less its mean block, axis by axis.

        Source: thesis, section 3.
        """
        rate, blocks = self.limits.sample_rate_hz, self.profile.blocks
        middle = math.sqrt(self.profile.from_hz * min(self.profile.to_hz, self.limits.max_frequency_hz))
        periods, samples = whole_periods(middle, PERIODIC_S / blocks, rate)
        for axis in range(self.limits.n_axes):
            frequency = periods * rate / samples
            a = amplitude(knowledge, axis, frequency, aim, blocks * samples / rate, self.limits)
            request = Request(axis, a, periods, samples, blocks, samples, raw=True)

            def reduction(records: dict[str, Real]) -> dict[str, Any]:
                return _stored(noise.spectra(noise.without_mean_block(records, samples), rate))

            self._awaits_record(request)
            outcome = self.recorder.reduced("periodic", request, reduction)
            if not isinstance(outcome, Trip):
                knowledge.noise = knowledge.noise.joined(_restored(outcome))
            self._report(f"axis {axis} periodic record at {frequency:.4g} Hz")

    def _awaits_record(self, request: Request) -> None:
        if not self.recorder.replaying:
            self.meter.awaits_record("noise", request.blocks * request.samples)

    def _report(self, last: str) -> None:
        self.meter.finished("noise", last, self.recorder.replaying, self.recorder.rig_seconds)


def _stored(spectra: NoiseSpectra) -> dict[str, Any]:
    """Spectra as a journal keeps them."""
    assert spectra.raw is not None
    return {
        "noise_hz": spectra.frequency_hz,
        "lines_hz": list(spectra.lines_hz),
        "density": dict(spectra.density),
        "raw": dict(spectra.raw),
    }


def _restored(stored: dict[str, Any]) -> NoiseSpectra:
    return NoiseSpectra(stored["noise_hz"], stored["density"], tuple(stored["lines_hz"]), stored["raw"])


def _lines(records: dict[str, Real], samples: int, blocks: int, harmonics: tuple[int, ...]) -> dict[str, Any]:
    """Complex amplitudes of a record at the lines of a noise sweep: (lines, blocks, H, n_axes)."""
    periods = spectral_lines(samples)
    cut = BlockPlan(0, samples, blocks)
    names = ("r", "u", "i", "y")
    n = records["r"].shape[1]
    stacked = np.concatenate([records[k] for k in names], axis=1)
    values = np.array([amplitudes(stacked, cut, int(k) / samples, harmonics) for k in periods])
    return {"periods": periods} | {name.upper(): values[..., j * n : (j + 1) * n] for j, name in enumerate(names)}
