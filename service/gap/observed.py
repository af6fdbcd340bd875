"""An experiment and its datasheet made ready for a diagnosis: sweeps as observations, interference, notes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.gap.fitting.nuisance import Nuisance, nuisance
from service.gap.interference import Interference, hums_hz, interference
from service.gap.measured.observation import GapError, Observation, observe, usable
from service.gap.measured.settling import DRIFTS
from service.gap.measured.sweeps import halves, notes_on, span_s, sweeps_for, timed
from service.gap.measured.thin import thinned
from service.gap.measured.together import Together
from service.gap.modes import with_identified_modes
from service.gap.where.conditions import same_condition
from sim.datasheet import Datasheet


@dataclass(frozen=True)
class Observed:
    """What a diagnosis works on."""

    nuisance: Nuisance
    main: Sweep
    """the sweep to fit"""
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

    @property
    def duration_s(self) -> float | None:
        """How long the experiment took."""
        return None if self.span is None else self.span[1] - self.span[0]

    @property
    def aloud(self) -> bool:
        """Whether some interference is heard by its loudness alone."""
        return not all(s.heard_hz for s in self.sources)

    def halves(self, fitted_hz: float | None) -> tuple[Observation, Observation, str]:
        """The other sweep in two, one half to fit, the other one unseen, and the name of that: `sweeps.halves`."""
        return halves(self.unseen, self.name, fitted_hz)


def observed(experiment: Experiment, datasheet: Datasheet) -> Observed:
    """What a diagnosis of an experiment works on.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    """
    if experiment.axes != datasheet.axes:
        raise GapError(
            f"the experiment has axes {list(experiment.axes)}, the datasheet {list(datasheet.axes)}; "
            "give the datasheet of the rig that was measured, with the same axes"
        )
    main, other, name = sweeps_for(experiment)
    notes = notes_on(main, other, datasheet)
    if not datasheet.modes:
        datasheet, note = with_identified_modes(experiment, datasheet)
        notes.append(note)
    nu = nuisance(datasheet)
    main, other, lines_only = timed(main), None if other is None else timed(other), other is None
    together = [Together.of(usable(sweep)) for sweep in (main, main if other is None else other)]
    if other is None:
        line = np.unique(main.frequency_hz, return_inverse=True)[1]
        main, other = main.select(line % 2 == 0), main.select(line % 2 == 1)
    sources = tuple(interference(main, nu.rig)) if main.in_sequence else ()
    hums, span = hums_hz(sources), span_s(main, other)
    o = observe(thinned(main), nu.rig, (0.0, 0.8), hums, span, together[0])
    unseen = observe(thinned(other), nu.rig, (0.8, 1.0), hums, span, together[1])
    if o.unsettled > DRIFTS:
        notes.append(f"{100 * o.unsettled:.0f} % of the points had not settled: they drift from block to block")
    if not lines_only and (same := same_condition(o, unseen)):
        notes.append(same)
    return Observed(nu, main, other, name, lines_only, o, unseen, sources, span, tuple(notes))
