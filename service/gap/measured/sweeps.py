"""Which sweeps of an experiment a diagnosis uses, and notes on what they lack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.experiment.data import Complex, Experiment, Sweep
from service.experiment.dead import dropped
from service.gap.measured.condition import conditions_of
from service.gap.measured.observation import GapError, Observation, observe, usable
from service.identification.measured.block_length import block_samples
from service.identification.measured.sweeps import speed_of
from sim.datasheet import ASSUMED, Datasheet
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.wording import in_words

ELSEWHERE = ("amplifier", "preliminary")
"""Comments of sweeps that are not used: they are not of the plant, or not exact enough."""

SAME_RATE = 0.01
"""Relative difference of two sample rates below which they are the same."""

MOST_NAMED = 5
"""Frequencies of points that are named."""
MOST = 0.5
"""Share of points from which it is most of them."""
COPY_SHARE = 1e-9
"""Largest difference of blocks, relative to the signal, at which they are copies of one another (rounding)."""
COPY_WITHIN = 3e-7
"""Largest difference of two measurements of a point, relative to the signal, at which one is a copy of the other, as
single precision rounds it; noise makes a hundred times as much."""


def sweeps_for(experiment: Experiment) -> list[tuple[str, Sweep]]:
    """Excited sweeps of the plant with their names: the one to fit first, then those that may check it.

    One at standstill has no speed, whatever a controller tells of a rotor that rests.
    """
    plant = [(k, s) for k, s in enumerate(experiment.sweeps) if s.kind != "noise" and s.comment not in ELSEWHERE]
    tones = [(k, s) for k, s in plant if s.kind == "stepped-sine"]  # they show more effects than a multisine
    excited = tones or plant
    if not excited:
        raise GapError("the experiment has no stepped-sine or multisine sweep of the plant; run one, then diagnose")
    return [(f"sweeps/{k}", replace(s, speed_rad_s=speed_of(s))) for k, s in excited]


def without_copies(sweeps: Sequence[tuple[str, Sweep]]) -> tuple[list[tuple[str, Sweep]], list[str]]:
    """The sweeps without points that are copies of earlier ones, value for value, and what is said of these.

    A copy has the noise of what it was copied from: as data that no fit has seen, or as one point more, it confirms
    whatever was fitted.
    """
    seen: dict[tuple[str, int], list[Complex]] = {}
    left, notes = [], []
    for name, sweep in sweeps:
        new = np.ones(sweep.n_points, dtype=bool)
        for k in range(sweep.n_points):
            earlier = seen.setdefault((f"{sweep.frequency_hz[k]:.6g}", int(sweep.axis[k])), [])
            point = np.stack([sweep.U[k], sweep.Y[k]])
            new[k] = not any(_alike(point, one) for one in earlier)
            earlier.append(point)
        if new.any():
            left.append((name, sweep if new.all() else sweep.select(new)))
        if lost := int(np.count_nonzero(~new)):
            which = "all points" if lost == len(new) else f"{lost} of {len(new)} points"
            notes.append(
                f"{which} of {name} are copies of earlier ones, value for value, and are left out; measure them again, "
                "for a copy tells nothing new"
            )
    return left, notes


def _alike(point: Complex, other: Complex) -> bool:
    """Whether u and y of two points, (2, B, H, n), are the same but for rounding."""
    if point.shape != other.shape:
        return False
    within = COPY_WITHIN * np.abs(point).max(axis=(1, 2, 3), keepdims=True)
    return bool(np.all(np.abs(point - other) <= within))


def without_copied_blocks(sweeps: Sequence[tuple[str, Sweep]]) -> tuple[list[tuple[str, Sweep]], list[str]]:
    """The sweeps without blocks that are copies of earlier ones, as of a point's mean, and what is said of these.

    Raises
    ------
    GapError
        No sweep has two blocks that were measured: then the noise is not known, and whatever is left of a gap may be
        noise that all copies share.
    """
    left, notes = [], []
    for name, sweep in sweeps:
        measured = _distinct_blocks(sweep)
        if len(measured) == sweep.Y.shape[1]:
            left.append((name, sweep))
        elif len(measured) > 1:
            left.append((name, sweep.with_blocks(measured)))
            notes.append(
                f"{name}: of {sweep.Y.shape[1]} blocks of a point {len(measured)} were measured, the others are copies "
                "of them and are left out; log every block, for a copy tells nothing of the noise"
            )
        else:
            notes.append(
                f"{name}: the blocks of a point are copies of one another, so that its noise is not known; it is left "
                "out: log the blocks that were measured, not their mean"
            )
    if not left:
        raise GapError(
            "the blocks of every point are copies of one another: how much of the data is noise is not known, and no "
            "gap can be told from it; log the blocks that were measured, not copies of them or of their mean (a "
            "simulation needs noise, too)"
        )
    return left, notes


def _distinct_blocks(sweep: Sweep) -> list[int]:
    """Blocks that are no copies of earlier ones at most points, all of their channels; all where no point is whole."""
    Y = sweep.Y[np.isfinite(sweep.Y).all(axis=(1, 2, 3))]
    if not len(Y):
        return list(range(sweep.Y.shape[1]))
    alike_within = COPY_SHARE * np.abs(Y).max()
    distinct: list[int] = []
    for b in range(Y.shape[1]):
        apart = (np.abs(Y[:, a] - Y[:, b]).max(axis=(1, 2)) for a in distinct)
        if not any(np.mean(x <= alike_within) > MOST for x in apart):
            distinct.append(b)
    return distinct


def interrupted(sweeps: Sequence[tuple[str, Sweep]]) -> list[str]:
    """Points at which the log reads exactly zero though something was excited, a sentence for each sweep."""
    told = []
    for name, sweep in sweeps:
        if (lost := dropped(sweep)).any():
            hz = ", ".join(f"{f:.4g}" for f in np.unique(sweep.frequency_hz[lost])[:MOST_NAMED])
            more = ", ..." if len(np.unique(sweep.frequency_hz[lost])) > MOST_NAMED else ""
            told.append(
                f"{name}: u, i and y of the excited axis are exactly zero at {int(lost.sum())} points ({hz}{more} Hz): "
                "the log was interrupted; they are left out, measure them again"
            )
    return told


def with_usable_checks(sweeps: Sequence[tuple[str, Sweep]]) -> tuple[list[tuple[str, Sweep]], list[str]]:
    """The first sweep and those of the others that can be checked on, and a sentence on each that cannot."""
    kept, told = [sweeps[0]], []
    for name, sweep in sweeps[1:]:
        try:
            usable(sweep)
        except GapError as error:
            told.append(f"{name} is not used: {error}")
        else:
            kept.append((name, sweep))
    return kept, told


def silent_axes(sweeps: Sequence[tuple[str, Sweep]], axes: Sequence[str]) -> list[str]:
    """Axes that sweeps never excite, a sentence each: what acts there shows only where it answers to the others."""
    told = []
    for name, sweep in sweeps:
        excited = set(sweep.axis[sweep.amplitude_a > 0].tolist())
        silent = [axis for k, axis in enumerate(axes) if k not in excited]
        if silent and excited:
            told.append(
                f"{name} does not excite {', '.join(silent)}: of what acts there it tells hardly anything, so that an "
                "effect there may stay unseen; excite every axis"
            )
    return told


def best_check(main: Sweep, others: Sequence[tuple[str, Sweep]], rig: Rig) -> tuple[tuple[str, Sweep], list[str]]:
    """The sweep to check on, the first at another amplitude or speed if there is one, and the names of the others."""
    chosen = others[0]
    if len(others) > 1:
        o = observe(usable(main), rig)
        at_other_condition = (one for one in others if any(conditions_of(o, observe(usable(one[1]), rig))))
        chosen = next(at_other_condition, chosen)
    return chosen, [name for name, _ in others if name != chosen[0]]


def timed(sweep: Sweep, alike: Sweep | None = None) -> Sweep:
    """The sweep with the length of its blocks, inferred from its frequencies where the file lacks it and they allow.

    ``alike`` is another sweep of the same program, for lines that leave several lengths.
    """
    if sweep.block_samples is not None or (inferred := block_samples(sweep, alike)) is None:
        return sweep
    return replace(sweep, block_samples=inferred.astype(np.int64))


def span_s(*sweeps: Sweep) -> tuple[float, float] | None:
    """Times of the first and of the last point of all sweeps, s; None where the file lacks them."""
    times = [s.time_s for s in sweeps if s.time_s is not None and np.isfinite(s.time_s).all() and s.n_points]
    if len(times) < len(sweeps):
        return None
    first, last = min(float(t.min()) for t in times), max(float(t.max()) for t in times)
    return (first, last) if last > first else None


def halves(
    other: Observation, name: str, fitted_hz: float | None = None
) -> tuple[Observation, Observation, str] | None:
    """The other sweep split line by line into a half to fit and an unseen half, and the name of the latter.

    The line nearest to ``fitted_hz``, or else the first one, is in the half to fit. None where there is one line alone.
    """
    if len(other.frequency_hz) < 2:
        return None
    first = 0 if fitted_hz is None else int(np.argmin(np.abs(other.frequency_hz - fitted_hz)))
    fitted = (np.arange(len(other.frequency_hz)) - first) % 2 == 0
    to_fit, unseen = other.select(fitted), other.select(~fitted)
    return to_fit, unseen, name + ", every other line"


def unseen_across(datasheet: Datasheet, turning: bool) -> list[str]:
    """Ids of effects that couple x and y, which data of two axes cannot show."""
    if datasheet.n_axes > 2:
        return []
    return [e.id for e in CATALOGUE.values() if e.needs_axes > 2 and (turning or not e.needs_speed)]


def notes_on(main: Sweep, checked: bool, datasheet: Datasheet) -> list[str]:
    """Notes on what the data or the datasheet lack; ``checked``: there is another sweep."""
    notes = []
    if not checked:
        notes.append(
            "one sweep only: closure is cross-validated over its lines, which is weaker than another condition"
        )
    if not set(main.harmonics) - {0, 1}:
        notes.append(
            "the file holds no harmonics of the tones: what only they show, as of a rotor off centre, magnets that "
            "saturate a little or a stop that is hardly touched, stays unseen; log harmonics 2 and 3"
        )
    if main.I is None:
        notes.append("the coil current was not logged: amplifier and plant cannot be told apart, alias classes grow")
    if not main.in_sequence:
        notes.append(
            "a multisine drives all axes at once: its lines tell nothing of voltage limits, drift, mains and runout, "
            "each of which may look like another effect; a stepped sine shows them"
        )
    if across := unseen_across(datasheet, main.speed_rad_s != 0):
        names = ", ".join(map(in_words, across))
        notes.append(f"two axes only: effects that couple x and y cannot be seen ({names}); one may look like another")
    if not datasheet.tolerance_stated:
        notes.append(ASSUMED)
    return notes


def other_rate(sweep: Sweep, datasheet: Datasheet) -> str | None:
    """A note where the log's sample rate is not that of the datasheet's controller; None where they agree.

    A log may be decimated on purpose, so it is no error; but a datasheet with a wrong sample time describes another
    controller, and a diagnosis would find a gap there.
    """
    logged, stated = sweep.sample_rate_hz, 1 / datasheet.sample_time_s
    if abs(logged / stated - 1) < SAME_RATE:
        return None
    return (
        f"the log has {logged:g} samples a second, the datasheet's controller {stated:g}; if the log is not thinned "
        "out, one of sample_rate_hz and sample_time_s is wrong, and the controller would be blamed for it"
    )
