"""An experiment and its datasheet made ready for a diagnosis: sweeps as observations, interference, notes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.experiment.dead import require_live_channels
from service.experiment.incomplete import incomplete
from service.experiment.resting import about_rest, held_at, load_in_words, resting_current
from service.experiment.stated import stated_amplitudes
from service.experiment.units import must_be_in_si, odd_rotor
from service.gap.fitting.nuisance import Nuisance, nuisance
from service.gap.interference import Interference, hums_hz, interference
from service.gap.measured.condition import same_condition
from service.gap.measured.erratic import FEWEST_AXES, erratic, erratic_in_words
from service.gap.measured.observation import GapError, Observation, observe, usable
from service.gap.measured.settling import DRIFTS
from service.gap.measured.sweeps import best_check, halves, notes_on, other_rate, span_s, sweeps_for, timed
from service.gap.measured.thin import thinned
from service.gap.measured.together import Together
from service.gap.modes import with_identified_modes
from sim.datasheet import Datasheet

FEWEST_LINES = 5
"""Lines of the fitted sweep: of four, a rig with two axes and two modes has some thirty figures of y, about as many as
its datasheet has uncertain values."""


@dataclass(frozen=True)
class Observed:
    """What a diagnosis works on."""

    nuisance: Nuisance
    main: Sweep
    """the sweep to fit"""
    main_name: str
    other: Sweep
    """the one that no fit sees, or the other lines of the same one"""
    name: str
    """of ``other``"""
    lines_only: bool
    """whether it is of the same sweep"""
    o: Observation
    """of ``main``"""
    unseen: Observation
    """of ``other``"""
    sources: tuple[Interference, ...]
    span: tuple[float, float] | None
    """when the first point was measured and when the last, s; None where the file does not tell"""
    notes: tuple[str, ...]
    """what the data or the datasheet lack, in words"""
    erratic: str | None = None
    """where amplifiers of several axes do not answer alike from block to block, in words"""

    @property
    def duration_s(self) -> float | None:
        """How long the experiment took."""
        return None if self.span is None else self.span[1] - self.span[0]

    @property
    def aloud(self) -> bool:
        """Whether some interference is heard by its loudness alone."""
        return not all(s.heard_hz for s in self.sources)

    def halves(self, fitted_hz: float | None) -> tuple[Observation, Observation, str] | None:
        """The other sweep in two, one half to fit, the other one unseen, and the name of that: `sweeps.halves`."""
        return halves(self.unseen, self.name, fitted_hz)


def observed(experiment: Experiment, datasheet: Datasheet) -> Observed:
    """What a diagnosis of an experiment works on.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    AmbError
        A channel is dead.
    """
    if experiment.axes != datasheet.axes:
        raise GapError(
            f"the experiment has axes {list(experiment.axes)}, the datasheet {list(datasheet.axes)}; "
            "give the datasheet of the rig that was measured, with the same axes"
        )
    must_be_in_si(experiment, datasheet)
    (main_name, main), *others = sweeps_for(experiment)
    require_live_channels(main, tuple(experiment.axes), main_name)
    if (lines := len(np.unique(usable(main).frequency_hz))) < FEWEST_LINES:
        raise GapError(
            f"{main_name} has {lines} usable lines; a diagnosis needs at least {FEWEST_LINES}, or the datasheet's "
            "uncertain values explain whatever there is: measure more"
        )
    notes = [
        *incomplete(experiment),
        *odd_rotor(datasheet),
        *stated_amplitudes(experiment),
        *notes_on(main, bool(others), datasheet),
    ]
    if told := other_rate(main, datasheet):
        notes.append(told)
    if not datasheet.modes:
        datasheet, note = with_identified_modes(experiment, datasheet)
        notes.append(note)
    nu = nuisance(datasheet)
    main, lines_only = timed(main), not others
    if lines_only:
        together = Together.of(usable(main))
        of_both, line = (together, together), np.unique(main.frequency_hz, return_inverse=True)[1]
        main, other, name = main.select(line % 2 == 0), main.select(line % 2 == 1), f"every other line of {main_name}"
    else:
        (name, other), unused = best_check(main, others, nu.rig)
        other = timed(other)
        if main.I is not None and other.I is None:  # a fit to one could not be held against the other
            main = replace(main, I=None)
            notes.append(
                f"{name} has no coil current, so that of {main_name} is not used: amplifier and plant cannot be told "
                "apart, alias classes grow"
            )
        of_both = Together.of(usable(main)), Together.of(usable(other))
        notes += [f"{n} is not used: a diagnosis fits one sweep and checks on one other, here {name}" for n in unused]
    if (resting := resting_current(main, nu.rig)) is not None:
        main, other = about_rest(main), about_rest(other)
        loaded = held_at(nu.rig, resting)
        notes.append(f"{load_in_words(loaded, nu.rig)}: the twin works there")
        nu = replace(nu, rig=loaded)
    main, lost = _without_erratic(usable(main), main_name, nu.rig.axes)
    other, lost_there = _without_erratic(usable(other), name, nu.rig.axes)
    lost += lost_there
    notes += [f"{words}; {'this line is' if several else 'that is'} left out" for words, several in lost]
    sources = tuple(interference(main, nu.rig)) if main.in_sequence else ()
    hums, span = hums_hz(sources), span_s(main, other)
    if nu.rig.drift is not None:
        if span is None:
            notes.append(
                "the file does not tell when its points were measured: the drift of the twin is taken to have come "
                "about while they were"
            )
        else:  # points are dated by the share of the experiment that has passed
            nu = replace(nu, rig=replace(nu.rig, drift=nu.rig.drift.over(span[1] - span[0])))
    # A file that does not date its points has them in their order, the other sweep after the main one.
    during, after = ((0.0, 1.0), (0.0, 1.0)) if lines_only else ((0.0, 0.8), (0.8, 1.0))
    o = observe(thinned(usable(main)), nu.rig, during, hums, span, of_both[0])
    unseen = observe(thinned(usable(other)), nu.rig, after, hums, span, of_both[1])
    if o.unsettled > DRIFTS:
        notes.append(f"{100 * o.unsettled:.0f} % of the points had not settled: they drift from block to block")
    if not lines_only and (same := same_condition(o, unseen)):
        notes.append(same)
    erratic_there = next((words for words, several in lost if several), None)
    return Observed(nu, main, main_name, other, name, lines_only, o, unseen, sources, span, tuple(notes), erratic_there)


def _without_erratic(sweep: Sweep, name: str, axes: Sequence[str]) -> tuple[Sweep, list[tuple[str, bool]]]:
    """A sweep without its erratic points, and what is said of them; where it is the rig, without that whole line."""
    out = erratic(sweep)
    hz, axes_of = np.unique(sweep.frequency_hz[out], return_counts=True)
    lines = np.isin(sweep.frequency_hz, hz[axes_of >= FEWEST_AXES])
    return sweep.select(~(out | lines)), erratic_in_words(sweep, out, axes, name)
