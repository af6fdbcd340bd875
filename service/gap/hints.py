"""Notes on what to check before a verdict is believed: a label, a sign, a scale or a point may look like an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.still_ringing import hertz, ringing_lines_hz
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.predict import at_speed_of, displacement, weight
from service.gap.measured.observation import Observation
from service.gap.weighing.another_rig import RESONANCES
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from sim.rig import Rig
from sim.wording import in_words

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

OF_THAT_MODE = 0.01
"""Relative distance of a named resonance from a mode of the datasheet up to which a note asks to check that mode."""
NEAR = 0.1
"""Relative distance from a mode within which a line shows whether the mode is as stated."""
AS_STATED = 0.2
"""Relative difference of a gyroscopic moment from that of the datasheet up to which the speed needs no check."""
SCALED = 0.005
"""Change of the controller's gain from which a note asks to check the scale of the log."""
LAGS = 3e-6
"""Further lag of amplifiers, s, from which a note says that it may be a delay: twice what those of another law have."""
PLAIN = 300.0
"""Least excess of a point that is noted, in squared residuals over their expectation."""
SHARE_OF_ONE_POINT = 0.8
"""Share of a part's excess that one point must have to be noted."""
SHARE_UNEXPLAINED = 0.5
"""Share of a point's excess that a named effect must leave for it to be noted: of a sharp peak it leaves less."""


def hints(
    chosen: Candidate, datasheet: Rig, sweeps: Sequence[Observation], stated_kgm2: float | None = None
) -> list[str]:
    """Causes other than effects of a rig that would look like the named effects, in words.

    Parameters
    ----------
    chosen
        The twin that the verdict names.
    datasheet
        The plain twin, as its datasheet states it.
    sweeps
        The fitted one and the unseen one.
    stated_kgm2
        Polar inertia that the datasheet states, if any.
    """
    named = dict(zip(chosen.effects, chosen.fit.values, strict=True))
    notes = _turning(chosen, datasheet, sweeps, stated_kgm2)
    for name in (name for name in RESONANCES if name in named):
        at_hz = named[name]["frequency_hz"]
        modes_hz = [m.natural_frequency_rad_s / (2 * np.pi) for plane in datasheet.rotor.modes for m in plane]
        near = [f for f in modes_hz if abs(at_hz / f - 1) < OF_THAT_MODE]
        if near:
            notes.append(
                f"the {in_words(name)} lies at {at_hz:.4g} Hz, where the datasheet has a mode of the rotor "
                f"({near[0]:.4g} Hz): check that mode's frequency, damping and shape, and that its values at A and B "
                "have the signs of one direction"
            )
    if "sensor_gain" in named:
        notes.append(_ratios(chosen.fit.rig))
    gain = named.get("controller_mismatch", {}).get("gain_change", 0.0)
    if abs(gain) > SCALED:
        notes.append(
            f"a displacement that is logged {1 / (1 + gain):.3g} times as large as the controller sees it would look "
            "the same, the plant's stiffnesses making up for the rest: check the scale of the log"
        )
    lag_s = named.get("amplifier_bandwidth", {}).get("lag_s", 0.0)
    if lag_s > LAGS and "loop_delay" not in named:
        notes.append(
            f"beside their bandwidth the amplifiers lag by {1e6 * lag_s:.3g} us: a loop delay of as much beside them "
            "would look the same; check the controller's computing delay and the amplifiers' input filter"
        )
    return notes


def _ratios(rig: Rig) -> str:
    """What is measured of sensor gains, in words: a common one is told from ki by its tolerance alone."""
    gains, axes = rig.sensors.gain, rig.axes
    of_planes = " and ".join(
        f"{axes[a + 1]} reads {gains[a + 1] / gains[a]:.3g} times what {axes[a]} does"
        for a in range(0, len(axes) - 1, 2)
    )
    return (
        f"of sensor gains only ratios within a plane are measured ({of_planes}); what both sensors of a plane have in "
        "common trades against its magnets' ki, so calibrate one of them before either is corrected"
    )


def _turning(chosen: Candidate, datasheet: Rig, sweeps: Sequence[Observation], stated_kgm2: float | None) -> list[str]:
    """How the gyroscopic moment that a turning rotor shows agrees with the polar inertia of its datasheet, in words."""
    fastest, rotor = max((s.speed_rad_s for s in sweeps), key=abs), chosen.fit.rig.rotor
    stated = stated_kgm2 or datasheet.rotor.whole_polar_inertia_kgm2
    # the moment of a disc that modes tilt is not told by its inertia alone
    if not (fastest and stated) or rotor.discs != datasheet.rotor.discs:
        return []
    share = rotor.whole_polar_inertia_kgm2 / stated
    shown = (
        f"the rotor shows {share:.2g} times the gyroscopic moment of the datasheet's polar inertia at the stated speed"
    )
    if "gyroscopic_coupling" not in chosen.effects:
        would_show = replace(rotor, polar_inertia_kgm2=rotor.polar_inertia_kgm2 + stated)
        turning = replace(chosen.fit.rig, rotor=would_show)
        if share or not any(_tells_apart(chosen.fit.rig, turning, o) for o in sweeps):
            return []
        return [
            f"the rotor shows nothing of the gyroscopic moment of the datasheet's polar inertia at the stated "
            f"{fastest:.4g} rad/s: does it turn, and is speed_rad_s in rad/s?"
        ]
    if abs(share - 1) < AS_STATED:
        return [f"{shown}: a twin turns once it names gyroscopic coupling"]
    return [
        f"{shown}: a rotor of that datasheet would turn at {share * fastest:.3g} rad/s, not {fastest:.4g} rad/s; "
        "check the sweeps' speed_rad_s (is it in rpm or Hz, and positive from x to y?)"
    ]


def _tells_apart(one: Rig, other: Rig, o: Observation) -> bool:
    """Whether a sweep tells two rigs apart by its displacements."""
    change = displacement(at_speed_of(other, o), o) - displacement(at_speed_of(one, o), o)
    return float(np.sum(np.abs(change * weight(o, "y")[:, o.fundamental]) ** 2)) > CLEAR_CHI_SQUARE


def unseen_modes(datasheet: Rig, sweeps: Sequence[Observation]) -> list[str]:
    """Modes of the datasheet that no line comes near, in words: of them a twin without a gap says nothing."""
    lines_hz = np.concatenate([o.frequency_hz for o in sweeps])
    modes_hz = sorted({m.natural_frequency_rad_s / (2 * np.pi) for plane in datasheet.rotor.modes for m in plane})
    unseen = [hz for hz in modes_hz if np.abs(np.log(lines_hz / hz)).min() > NEAR]
    if not unseen:
        return []
    modes = ", ".join(f"{hz:.4g}" for hz in unseen)
    band = f"{lines_hz.min():.3g} to {lines_hz.max():.4g} Hz"
    return [f"of the datasheet's modes at {modes} Hz nothing is said: no line comes near them in the {band} measured"]


def one_point(parts: Sequence[Explained], unseen: Observation, names: tuple[str, str]) -> list[str]:
    """Points with nearly all of the excess that a part's twin leaves, in words: each may be one bad measurement.

    That is the twin with the part's effects, if it has any: they explain nearly nothing of such a point. ``names`` are
    those of the fitted sweep and of the unseen one. A point that draws the fit leaves an excess in the unseen sweep,
    too, which is not told beside the larger one.
    """
    points: dict[tuple[str, float, int], None] = {}
    for e in parts:
        worst: list[tuple[float, tuple[str, float, int]]] = []
        seen, plain = on_sweep(e, e.null.candidate, unseen)
        left = on_sweep(e, e.chosen, unseen)[1] if e.chosen.effects else plain
        sweeps = (e.ground.observations[0], e.plain[0], e.left[0]), (seen, plain, left)
        for name, (o, before, after) in zip(names, sweeps, strict=True):
            k = _worst(after)
            if k is not None and _excess(after)[k] > SHARE_UNEXPLAINED * _excess(before)[k]:
                worst.append((float(_excess(after)[k]), (name, float(o.points_hz[k]), int(o.axis[k]))))
        points |= dict.fromkeys([point for _, point in sorted(worst, reverse=True)][:1])
    axes = parts[0].ground.nuisance.rig.axes
    return [
        f"nearly all of what the twin leaves of {name} lies in one point, {hz:.4g} Hz with {axes[axis]} excited: "
        "measure it again"
        for name, hz, axis in points
    ]


def _excess(z: Complex) -> Real:
    """By how much the squared weighted residuals (P, H, n) of each point exceed what noise makes, (P,)."""
    power = np.abs(z) ** 2 / 2
    # noise hardly makes twice the number of a point's dozen values, even in one of a hundred points
    return np.asarray(np.maximum(power.sum(axis=(1, 2)) - 2 * np.count_nonzero(power, axis=(1, 2)), 0.0))


def _worst(z: Complex) -> int | None:
    """The point with nearly all of the excess of weighted residuals (P, H, n); None where there is no such point."""
    excess = _excess(z)
    k = int(excess.argmax())
    return k if excess[k] > PLAIN and excess[k] > SHARE_OF_ONE_POINT * excess.sum() else None


def moved_modes_shown(parts: Sequence[Explained]) -> list[str]:
    """That the datasheet's modes show elsewhere, beside something else that is not explained."""
    moved = [e.moved for e in parts if e.moved is not None]
    return [f"the main sweep shows {modes}: correct frequency_hz, and diagnose again" for modes in moved]


def unsettled_lines(parts: Sequence[Explained]) -> list[str]:
    """Lines with most of what the best twin leaves of a part, at which the rig still rang, in words."""
    if not (lines := {hz for e in parts for hz in ringing_lines_hz(e)}):
        return []
    return [
        f"most of what is left lies at {hertz(lines)}, where the rig still rang from block to block: a narrow "
        "resonance there needs a longer wait; measure those lines again"
    ]
