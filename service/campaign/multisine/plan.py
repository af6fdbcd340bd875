"""Which multisines a campaign plays, how large and how long: pure, from what a small pilot has measured.

The pilot's responses and the noise at rest give every line its amplitude, with more power at low frequencies, where
the magnets' stiffness shows. Then phases are chosen for small
displacement peaks, and one gain brings the largest predicted peak of any signal to its limit.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Limits
from service.campaign.frequencies import mains_harmonics
from service.campaign.knowledge import Knowledge
from service.campaign.multisine import crest
from service.experiment.multisine import Lines, Multisine, choose_lines

if TYPE_CHECKING:  # the API offers this profile, and designs nothing
    from service.campaign.multisine.design import Design

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SIGNALS = ("u", "i", "y")
PILOT_SHARE = 0.05
"""Share of the current's limit that the pilot takes before anything is known, as a first tone does."""
ALIKE = 1e-3
"""Relative difference of the peaks of two waveforms that are one design: a digit of it, which a processor rounds up or
down. What was played is in the journal."""
PILOT_LINES = 2
"""Lines of the pilot over those of the main and the amplifier sweep: a narrow peak between lines is not seen."""


@dataclass(frozen=True)
class MultisineProfile:
    """What a multisine campaign shall reach. The defaults suit a rig of some hundred kilograms sampled at 10 kHz."""

    from_hz: float = 10.0
    to_hz: float = 1000.0
    lines: int = 220
    """Odd lines of the main sweep, the detection lines among them included."""
    period_s: float = 1.0
    periods: int = 6
    """Recorded periods of every experiment: two are the fewest that tell a transient, and distortion, from noise. What
    noise leaves in the rotor's modes leaks from one into the next and cancels in their mean, so many in one go tell
    damping best, and less time is spent on settling."""
    realisations: int = 2
    """Draws of the phases, each played in as many experiments as there are axes. Its periods are blocks of the main
    sweep."""
    settle_s: float = 1.2
    """Settling to begin with, main and validation sweep: longer where the pilot's model rings on, and doubled as long
    as the periods still change."""
    short_settle_s: float = 0.3
    """Settling of the pilot and of the amplifier sweep, whose figures no transient spoils."""
    validation_realisations: int = 2
    validation_gain: float = 0.6
    """Level of the validation sweep against the main one."""
    amplifier_realisations: int = 2
    amplifier_to_hz: float = 3000.0
    amplifier_lines: int = 60
    amplifier_period_s: float = 0.2
    displacement_share: float = 0.25
    """Share of the linear range, and of the displacement limit, that predicted peaks may take."""
    current_share: float = 0.25
    """Share of the bias current, and of the current limit, that predicted peaks may take."""
    stiffness_hz: float = 100.0
    """Below it the amplitude rises as the inverse of frequency: there ks shows."""
    seed: int = 1
    """Of lines and phases: equal campaigns ask equal questions."""
    tries: int = 4
    """Attempts at one realisation: lower level, longer settling."""


@dataclass(frozen=True)
class PeriodicRequest:
    """One experiment of a multisine as the plan wants it; `drivers.controller.Waveform` without the driver."""

    sweep: str
    realisation: int
    experiment: int
    waveform_a: Real
    """(N, n_axes) one period."""
    periods: int
    settle_samples: int

    @property
    def amplitude_a(self) -> float:
        """Largest |r|."""
        return float(np.max(np.abs(self.waveform_a)))

    def seconds(self, sample_rate_hz: float) -> float:
        """Time that the rig will need, without the controller's ramps."""
        return (self.settle_samples + self.periods * len(self.waveform_a)) / sample_rate_hz

    def description(self) -> dict[str, Any]:
        """What a journal keeps, to know the same question again; the peak stands for the waveform."""
        return {
            "sweep": self.sweep,
            "realisation": self.realisation,
            "experiment": self.experiment,
            "samples": len(self.waveform_a),
            "peak_a": round(self.amplitude_a, 9),
            "periods": self.periods,
            "settle_samples": self.settle_samples,
        }

    def recalled(self, kept: Any) -> PeriodicRequest | None:
        """The experiment of a journal where it is this one but for last digits; None where it is another."""
        asked = self.description()
        if not isinstance(kept, dict) or kept.keys() != asked.keys():
            return None
        given = {"peak_a", "settle_samples"}
        if any(kept[name] != asked[name] for name in asked.keys() - given):
            return None
        near = abs(kept["peak_a"] - asked["peak_a"]) <= ALIKE * asked["peak_a"]
        near &= abs(kept["settle_samples"] - self.settle_samples) <= 1
        return replace(self, settle_samples=kept["settle_samples"]) if near else None


@dataclass(frozen=True)
class Allowed:
    """Largest predicted peaks."""

    displacement_m: float
    current_a: float
    excitation_a: float

    @staticmethod
    def of(profile: MultisineProfile, limits: Limits) -> Allowed:
        """Shares of what rig and controller allow."""
        return Allowed(
            profile.displacement_share * min(limits.displacement_limit_m, limits.linear_range_m),
            profile.current_share * min(limits.current_limit_a, limits.bias_current_a),
            min(profile.current_share * min(limits.current_limit_a, limits.bias_current_a), limits.max_amplitude_a),
        )


@dataclass(frozen=True)
class Responses:
    """What the pilot tells: closed-loop responses from r, and what is known of noise with them."""

    frequency_hz: Real
    values: dict[str, Complex]
    """"u", "i" in A/A and "y" in m/A: (F, outputs, inputs)."""

    def at(self, frequency_hz: Real) -> dict[str, Complex]:
        """Interpolated, (L, outputs, inputs); the end's value beyond the ends."""
        f = frequency_hz
        return {
            s: np.stack(
                [
                    np.interp(f, self.frequency_hz, v.real) + 1j * np.interp(f, self.frequency_hz, v.imag)
                    for v in G.reshape(len(G), -1).T
                ],
                axis=1,
            ).reshape(len(f), *G.shape[1:])
            for s, G in self.values.items()
        }

    def into(self, knowledge: Knowledge) -> None:
        """Tell what a campaign knows."""
        for k, f in enumerate(self.frequency_hz):
            for axis in range(self.values["y"].shape[2]):
                u, i, y = (self.values[s][k, :, axis] for s in SIGNALS)
                knowledge.add(axis, float(f), u, i, y, 0.0)


def lines_of(
    sweep: str,
    profile: MultisineProfile,
    limits: Limits,
    hum_hz: tuple[float, ...],
    design: Design | None = None,
) -> Lines:
    """Lines of a sweep: "pilot" over the whole band, "main", "validation" (drawn anew) or "amplifier".

    The main sweep has every line on the peaks of a ``design``.
    """
    p, rate = profile, limits.sample_rate_hz
    top = min(p.to_hz, limits.max_frequency_hz)
    high = min(p.amplifier_to_hz, limits.max_frequency_hz)
    period, low, to, count = {
        "pilot": (p.period_s, p.from_hz, high, PILOT_LINES * (p.lines + p.amplifier_lines)),
        "main": (p.period_s, p.from_hz, top, p.lines),
        "validation": (p.period_s, p.from_hz, top, p.lines // 2),
        "amplifier": (p.amplifier_period_s, max(p.from_hz, 0.05 * high), high, p.amplifier_lines),
    }[sweep]
    hums = tuple(mains_harmonics(to)) + hum_hz
    near = tuple(h for h in hums if low < h < to) if period * 50 >= 8 else ()
    peaks = design.peaks_hz() if design is not None and sweep == "main" else []
    return choose_lines(round(period * rate), rate, low, to, count, generator(profile, sweep, 99), near, peaks)


def periods_of(sweep: str, profile: MultisineProfile) -> int:
    """Recorded periods of every experiment: more than two only help the main sweep."""
    return profile.periods if sweep == "main" else min(2, profile.periods)


def generator(profile: MultisineProfile, sweep: str, realisation: int) -> np.random.Generator:
    """Random numbers of one realisation, the same in every run."""
    place = ("pilot", "main", "validation", "amplifier").index(sweep)
    return np.random.default_rng([profile.seed, place, realisation])


def pilot(profile: MultisineProfile, limits: Limits, lines: Lines, gain: float) -> Multisine:
    """A small multisine on a rig of which nothing is known: equal amplitudes, little current."""
    n = limits.n_axes
    L = len(lines.excited)
    flat = np.ones((L, n))
    found = crest.optimised(lines, flat, np.tile(np.eye(n, dtype=complex), (L, 1, 1)), generator(profile, "pilot", 0))
    peak = max(float(np.max(np.abs(found.waveform(e)))) for e in range(n))
    most = PILOT_SHARE * Allowed.of(profile, limits).current_a
    return found.scaled(gain * min(most, limits.max_amplitude_a) / peak)


def shape(profile: MultisineProfile, sweep: str, knowledge: Knowledge, frequency_hz: Real, n_axes: int) -> Real:
    """Relative amplitudes of the lines, (L, n).

    Equal accuracy (eq. 3.18) would spend the current, which is what limits all lines together, on high frequencies,
    where a rotor hardly moves. The root of that profile is half-way to equal amplitudes, and lines below
    ``stiffness_hz`` get more: of the profiles tried, this one gives the smallest deviations of ki and ks together.
    """
    amplifier = sweep == "amplifier"
    a = np.array([[knowledge.noise_at_unit(k, float(f), amplifier) for k in range(n_axes)] for f in frequency_hz])
    if not amplifier:
        a = np.sqrt(a) * (1 + profile.stiffness_hz / frequency_hz[:, None])
    return np.asarray(a)


def realisations(
    profile: MultisineProfile,
    limits: Limits,
    sweep: str,
    lines: Lines,
    knowledge: Knowledge,
    responses: Responses,
    design: Design | None = None,
) -> list[Multisine]:
    """Realisations of a sweep at their predicted limits, all at one level; the main sweep as ``design`` wants it."""
    count = {
        "main": profile.realisations,
        "validation": profile.validation_realisations,
        "amplifier": profile.amplifier_realisations,
    }[sweep]
    f = lines.frequency_hz(limits.sample_rate_hz)
    G = responses.at(f)
    a = shape(profile, sweep, knowledge, f, limits.n_axes)
    allowed = Allowed.of(profile, limits)
    own = np.zeros((len(f), 0, limits.n_axes))
    if design is not None and sweep == "main":
        G = design.responses(f, G)
        a = design.amplitudes(f, a, allowed.displacement_m, allowed.current_a, allowed.excitation_a)
        own = np.broadcast_to(np.eye(limits.n_axes), G["y"].shape)
    # whichever is nearest to its limit, displacement, current or excitation, has its peaks pressed down
    relative = np.concatenate(
        [G["y"] / allowed.displacement_m, G["i"] / allowed.current_a, own / allowed.excitation_a], axis=1
    )
    found = [crest.optimised(lines, a, relative, generator(profile, sweep, k)) for k in range(count)]
    gain = min(level(m, G, allowed) for m in found)
    if sweep == "validation":
        gain *= profile.validation_gain
    return [m.scaled(gain) for m in found]


def level(multisine: Multisine, responses: dict[str, Complex], allowed: Allowed) -> float:
    """Gain that brings the first of the predicted peaks to its limit."""
    peaks = crest.predicted_peaks(multisine, responses)
    played = max(float(np.max(np.abs(multisine.waveform(e)))) for e in range(multisine.n_inputs))
    return min(
        allowed.displacement_m / max(float(peaks["y"].max()), 1e-300),
        allowed.current_a / max(float(peaks["i"].max()), 1e-300),
        allowed.excitation_a / max(played, 1e-300),
    )


def settle_samples(seconds: float, limits: Limits) -> int:
    """Samples of a settling time."""
    return math.ceil(seconds * limits.sample_rate_hz)


def documented(profile: MultisineProfile) -> dict[str, Any]:
    """The profile as a journal keeps it."""
    return {"multisine": asdict(profile)}
