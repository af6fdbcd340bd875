"""The sweeps of an experiment that a diagnosis uses: the one to fit, the one that no fit sees, what they lack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.gap.measured.observation import GapError, Observation
from service.identification.block_length import block_samples
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE

ELSEWHERE = ("amplifier", "coarse")
"""Comments of sweeps that are not of the plant, or not exact enough."""


def sweeps_for(experiment: Experiment) -> tuple[Sweep, Sweep | None, str]:
    """The sweep to fit, the one that no fit sees, and its name; only excited sweeps of the plant count."""
    plant = [(k, s) for k, s in enumerate(experiment.sweeps) if s.kind != "noise" and s.comment not in ELSEWHERE]
    tones = [(k, s) for k, s in plant if s.kind == "stepped-sine"]  # shows more effects than a multisine does
    excited = tones or plant
    if not excited:
        raise GapError("the experiment has no stepped-sine or multisine sweep of the plant; run one, then diagnose")
    main = excited[0][1]
    for k, s in excited[1:]:
        return main, s, f"sweeps/{k}"
    return main, None, "every other line of sweeps/0"


def timed(sweep: Sweep) -> Sweep:
    """The sweep with the length of its blocks, told by its lines where the file does not tell it and they do."""
    if sweep.block_samples is not None or (told := block_samples(sweep)) is None:
        return sweep
    return replace(sweep, block_samples=told.astype(np.int64))


def span_s(*sweeps: Sweep) -> tuple[float, float] | None:
    """When the first point of all was measured and when the last, s; None where the file does not tell."""
    times = [s.time_s for s in sweeps if s.time_s is not None and np.isfinite(s.time_s).all() and s.n_points]
    if len(times) < len(sweeps):
        return None
    first, last = min(float(t.min()) for t in times), max(float(t.max()) for t in times)
    return (first, last) if last > first else None


def halves(other: Observation, name: str, fitted_hz: float | None = None) -> tuple[Observation, Observation, str]:
    """The other sweep in two: every other line to fit, with the one at ``fitted_hz`` or else the first; unseen ones."""
    first = 0 if fitted_hz is None else int(np.argmin(np.abs(other.frequency_hz - fitted_hz)))
    fitted = (np.arange(len(other.frequency_hz)) - first) % 2 == 0
    seen, unseen = other.select(fitted), other.select(~fitted)
    if min(len(half.line) for half in (seen, unseen)) * 2 <= 16:
        return other, other, name + " (fitted too)"
    return seen, unseen, name + ", every other line"


def unseen_across(datasheet: Datasheet, turning: bool) -> list[str]:
    """Effects that couple x and y, which two axes cannot show."""
    if datasheet.n_axes > 2:
        return []
    return [e.id for e in CATALOGUE.values() if e.needs_axes > 2 and (turning or not e.needs_speed)]


def notes_on(main: Sweep, other: Sweep | None, datasheet: Datasheet) -> list[str]:
    """What the data or the datasheet lack, in words."""
    notes = []
    if other is None:
        notes.append(
            "one sweep only: closure is cross-validated over its lines, which is weaker than another condition"
        )
    if main.I is None:
        notes.append("the coil current was not logged: amplifier and plant cannot be told apart, alias classes grow")
    if not main.in_sequence:
        notes.append(
            "a multisine drives all axes at once: its lines tell nothing of voltage limits, drift, mains and runout, "
            "each of which may look like another effect; a stepped sine shows them"
        )
    if across := unseen_across(datasheet, main.speed_rad_s != 0):
        names = ", ".join(name.replace("_", " ") for name in across)
        notes.append(f"two axes only: effects that couple x and y cannot be seen ({names}); one may look like another")
    if not datasheet.tolerance_stated:
        notes.append("the datasheet states no tolerances: this product's defaults are assumed")
    return notes
