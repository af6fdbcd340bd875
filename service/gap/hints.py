"""Notes on what to check before a verdict is believed: a label, a sign, a scale or a point may look like an effect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.measured.observation import Observation
from service.gap.weighing.another_rig import RESONANCES
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from sim.rig import Rig
from sim.wording import in_words

Complex = NDArray[np.complex128]

OF_THAT_MODE = 0.01
"""Relative distance of a named resonance from a mode of the datasheet up to which a note asks to check that mode."""
SCALED = 0.005
"""Change of the controller's gain from which a note asks to check the scale of the log."""
PLAIN = 300.0
"""Least excess of a point that is noted, in squared residuals over their expectation."""
SHARE_OF_ONE_POINT = 0.8
"""Share of a part's excess that one point must have to be noted."""


def hints(chosen: Candidate, datasheet: Rig, sweeps: Sequence[Observation]) -> list[str]:
    """Causes other than effects of a rig that would look like the named effects, in words.

    Parameters
    ----------
    chosen
        The twin that the verdict names.
    datasheet
        The plain twin, as its datasheet states it.
    sweeps
        The fitted one and the unseen one.
    """
    notes = []
    named = dict(zip(chosen.effects, chosen.fit.values, strict=True))
    rotor = chosen.fit.rig.rotor
    stated = datasheet.rotor.whole_polar_inertia_kgm2
    # the moment of a disc that modes tilt is no wrong speed
    if "gyroscopic_coupling" in named and stated and rotor.discs == datasheet.rotor.discs:
        share = rotor.whole_polar_inertia_kgm2 / stated
        fastest = max((s.speed_rad_s for s in sweeps), key=abs)
        notes.append(
            f"the rotor shows {share:.2g} times the gyroscopic moment of the datasheet's polar inertia at the stated "
            f"speed: a rotor of that datasheet would turn at {share * fastest:.3g} rad/s, not {fastest:.4g} rad/s; "
            "check the sweeps' speed_rad_s (is it in rpm or Hz?)"
        )
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
    gain = named.get("controller_mismatch", {}).get("gain_change", 0.0)
    if abs(gain) > SCALED:
        notes.append(
            f"a displacement that is logged {1 / (1 + gain):.3g} times as large as the controller sees it would look "
            "the same, the plant's stiffnesses making up for the rest: check the scale of the log"
        )
    return notes


def one_point(parts: Sequence[Explained], unseen: Observation, names: tuple[str, str]) -> list[str]:
    """Points with nearly all of the plain twin's excess in a part, in words: each may be one bad measurement.

    ``names`` are those of the fitted sweep and of the unseen one.
    """
    points: dict[tuple[str, float, int], None] = {}
    for e in parts:
        sweeps = ((e.ground.observations[0], e.plain[0]), on_sweep(e, e.null.candidate, unseen))
        for name, (o, z) in zip(names, sweeps, strict=True):
            k = _worst(z)
            if k is not None:
                points[name, float(o.points_hz[k]), int(o.axis[k])] = None
    axes = parts[0].ground.nuisance.rig.axes
    return [
        f"nearly all of what the twin leaves of {name} lies in one point, {hz:.4g} Hz with {axes[axis]} excited: "
        "measure it again"
        for name, hz, axis in points
    ]


def _worst(z: Complex) -> int | None:
    """The point with nearly all of the excess of weighted residuals (P, H, n); None where there is no such point."""
    power = np.abs(z) ** 2 / 2
    # noise hardly makes twice the number of a point's dozen values, even in one of a hundred points
    excess = np.maximum(power.sum(axis=(1, 2)) - 2 * np.count_nonzero(power, axis=(1, 2)), 0.0)
    k = int(excess.argmax())
    return k if excess[k] > PLAIN and excess[k] > SHARE_OF_ONE_POINT * excess.sum() else None
