"""An experiment and its datasheet prepared for a diagnosis: observations, nuisance values, interference, notes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Experiment, Sweep
from service.experiment.dead import require_live_channels
from service.experiment.incomplete import incomplete
from service.experiment.resting import held_at, load_in_words, resting_current
from service.experiment.speeds import changed_speed
from service.experiment.stated import stated_amplitudes
from service.experiment.units import must_be_in_si, odd_air_gap, odd_modes, odd_rotor, odd_tolerances
from service.gap.fitting.nuisance import Nuisance, nuisance
from service.gap.interference import Interference, heard_at_speed, hums_hz, interference, told_apart
from service.gap.measured.cabling import odd_scales, other_law, wrong_channels
from service.gap.measured.condition import same_condition
from service.gap.measured.erratic import Erratic, ringing_in_words
from service.gap.measured.observation import GapError, Observation, usable
from service.gap.measured.pair import Pair
from service.gap.measured.settling import NOTED_DRIFTING_SHARE
from service.gap.measured.sweeps import (
    halves,
    interrupted,
    notes_on,
    other_rate,
    silent_axes,
    span_s,
    sweeps_for,
    with_usable_checks,
    without_copied_blocks,
    without_copies,
)
from service.gap.modes import with_identified_modes
from service.gap.unlisted_tone import Tone, unlisted_tone
from sim.datasheet import Datasheet
from sim.twin import non_rotating

FEWEST_LINES = 5
"""Fewest lines of the fitted sweep: with four, a rig with two axes and two modes has some thirty values of y, about as
many as nuisance values."""
NARROWEST = 1.001
"""Highest over lowest frequency of these lines, below which all of them tell the same."""


@dataclass(frozen=True, kw_only=True)
class Observed:
    """The data of a diagnosis."""

    nuisance: Nuisance
    main: Sweep
    """the sweep to fit"""
    main_name: str
    other: Sweep
    """the sweep to check on, or other lines of the main one"""
    name: str
    """of ``other``"""
    lines_only: bool
    """whether ``other`` is of the same sweep"""
    o: Observation
    """of ``main``"""
    unseen: Observation
    """of ``other``"""
    sources: tuple[Interference, ...]
    tone: Tone | None
    """interference of no effect of the catalogue"""
    span: tuple[float, float] | None
    """times of the first and of the last point, s; None where the file lacks them"""
    notes: tuple[str, ...]
    """what the data or the datasheet lack"""
    erratic: Erratic | None = None
    """lines where the currents of several axes do not repeat from block to block"""
    polar_inertia_kgm2: float | None = None
    """that the datasheet states; its twin does not turn"""
    wrong_channels: str | None = None
    """which channels of the log are swapped, have another sign or unit, or are conjugates, in words"""

    @property
    def duration_s(self) -> float | None:
        """How long the experiment took."""
        return None if self.span is None else self.span[1] - self.span[0]

    @property
    def detected_by_size(self) -> bool:
        """Whether some interference was detected by the size of its scatter, not by its phase."""
        return not all(s.heard_hz for s in self.sources)

    def halves(self, fitted_hz: float | None) -> tuple[Observation, Observation, str] | None:
        """Two halves of the other sweep, one to fit and one unseen, and the name of the latter: `sweeps.halves`."""
        return halves(self.unseen, self.name, fitted_hz)


def observed(experiment: Experiment, datasheet: Datasheet) -> Observed:
    """The data of a diagnosis of an experiment.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    AmbError
        A channel is dead.
    """
    ((main_name, main), *others), copied = _sweeps(experiment, datasheet)
    notes = [
        *incomplete(experiment),
        *_of_another_rig(experiment, datasheet),
        *changed_speed(experiment),
        *odd_rotor(datasheet),
        *odd_air_gap(datasheet),
        *odd_modes(datasheet),
        *odd_tolerances(datasheet),
        *stated_amplitudes(experiment),
        *copied,
        *notes_on(main, bool(others), datasheet),
        *interrupted([(main_name, main), *others]),
        *silent_axes([(main_name, main), *others], experiment.axes),
    ]
    if rate_note := other_rate(main, datasheet):
        notes.append(rate_note)
    if not datasheet.modes:
        datasheet, note = with_identified_modes(experiment, datasheet)
        notes.append(note)
    nu = nuisance(non_rotating(datasheet))
    wrong = None
    for name, sweep in ((main_name, main), *others):
        wrong = wrong or wrong_channels(usable(sweep), nu.rig, experiment.axes, name)
        notes += other_law(usable(sweep), nu.rig, experiment.axes, name)
        notes += odd_scales(usable(sweep), nu.rig, experiment.axes, name)
    pair, unused = Pair.of(main_name, main, others, nu.rig)
    notes += unused
    if (resting := resting_current(pair.main, nu.rig)) is not None:
        loaded = held_at(nu.rig, resting)
        notes.append(f"{load_in_words(loaded, nu.rig)}: the twin works there")
        pair, nu = pair.about_rest(), replace(nu, rig=loaded)
    for name, sweep in ((pair.main_name, pair.main), (pair.name, pair.other)):
        notes += ringing_in_words(usable(sweep), nu.rig.axes, name)
    pair, left_out, erratic = pair.without_erratic(nu.rig.axes)
    notes += left_out
    if left_out:
        fitted = [pair.main, pair.other] if pair.lines_only else [pair.main]
        _require_lines(main_name, np.concatenate([s.frequency_hz for s in fitted]), "repeating")
    sources = tuple(interference(pair.main, nu.rig)) if pair.main.in_sequence else ()
    sources = told_apart(sources, pair.main, pair.other, nu.rig)
    sources = heard_at_speed(sources, pair.main, pair.other, nu.rig)
    tone = unlisted_tone(sources, pair.main, pair.other, nu.rig)
    span = span_s(pair.main, pair.other)
    nu, undated = _with_drift_over(nu, span)
    notes += undated
    at_any_speed = () if tone is None else (tone.frequency_hz,)
    hums = [(*hums_hz(sources, sweep.speed_rad_s), *at_any_speed) for sweep in (pair.main, pair.other)]
    o, unseen = pair.observations(nu.rig, hums, span)
    if o.unsettled > NOTED_DRIFTING_SHARE:
        notes.append(f"{100 * o.unsettled:.0f} % of the points had not settled: they drift from block to block")
    if not pair.lines_only and (same := same_condition(o, unseen)):
        notes.append(same)
    return Observed(
        nuisance=nu,
        main=pair.main,
        main_name=pair.main_name,
        other=pair.other,
        name=pair.name,
        lines_only=pair.lines_only,
        o=o,
        unseen=unseen,
        sources=sources,
        tone=tone,
        span=span,
        notes=tuple(notes),
        erratic=erratic,
        polar_inertia_kgm2=datasheet.polar_inertia_kgm2,
        wrong_channels=wrong,
    )


def _sweeps(experiment: Experiment, datasheet: Datasheet) -> tuple[list[tuple[str, Sweep]], list[str]]:
    """The excited sweeps with their names, the one to fit first, and what is said of those that are copies.

    Raises `GapError` or `AmbError` where they are not of this datasheet's rig, or too few or dead to be fitted.
    """
    if experiment.axes != datasheet.axes:
        remedy = "give the datasheet of the rig that was measured, with the same axes"
        if sorted(experiment.axes) == sorted(datasheet.axes):
            remedy = "write the experiment with its channels, and what axis indexes, in the datasheet's order"
        raise GapError(
            f"the experiment has axes {list(experiment.axes)}, the datasheet {list(datasheet.axes)}; {remedy}"
        )
    must_be_in_si(experiment, datasheet)
    sweeps, notes = without_copies(sweeps_for(experiment))
    for name, sweep in sweeps:
        require_live_channels(sweep, tuple(experiment.axes), name)
    sweeps, copied = without_copied_blocks(sweeps)  # after that: blocks of a dead log are alike, too
    main_name, main = sweeps[0]
    _require_lines(main_name, usable(main).frequency_hz)
    sweeps, too_short = with_usable_checks(sweeps)
    return sweeps, notes + copied + too_short


def _of_another_rig(experiment: Experiment, datasheet: Datasheet) -> list[str]:
    """A note where the datasheet has another name than the rig that was measured: it may be another rig's."""
    if experiment.rig == datasheet.name or not experiment.rig or not datasheet.name:
        return []
    return [
        f"the experiment is of rig {experiment.rig}, the datasheet of rig {datasheet.name}: if these are two rigs, "
        "what differs between them is told as the gap; give the datasheet of the rig that was measured"
    ]


def _require_lines(name: str, frequency_hz: NDArray[np.float64], of_which: str = "usable") -> None:
    if (lines := len(np.unique(frequency_hz))) < FEWEST_LINES:
        raise GapError(
            f"{name} has {lines} {of_which} lines; a diagnosis needs at least {FEWEST_LINES}, or the datasheet's "
            "uncertain values explain whatever there is: measure more"
        )
    lowest, highest = float(frequency_hz.min()), float(frequency_hz.max())
    if highest < NARROWEST * lowest:
        raise GapError(
            f"{name} has all its {of_which} lines between {lowest:.9g} and {highest:.9g} Hz, which is one place of the "
            "frequency response: measure over the loop's band"
        )


def _with_drift_over(nu: Nuisance, span: tuple[float, float] | None) -> tuple[Nuisance, tuple[str, ...]]:
    """The twin with its drift, if any, restated over the time of the experiment; or a note that it is unknown."""
    drift = nu.rig.drift
    if drift is None:
        return nu, ()
    if span is None:
        return nu, (
            "the file does not tell when its points were measured: the drift of the twin is taken to have come about "
            "while they were",
        )
    # the progress of points is their share of that time
    return replace(nu, rig=replace(nu.rig, drift=drift.over(span[1] - span[0]))), ()
