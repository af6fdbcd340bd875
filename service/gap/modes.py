"""Flexible modes for a datasheet without any, identified from the experiment itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.experiment.data import Experiment
from service.identification.result.supports import SAME, move_as_supports
from sim.datasheet import Datasheet, Mode
from sim.errors import AmbError
from sim.folded import folded

if TYPE_CHECKING:
    from service.identification.result.parts import ModeResult

SHAPE_TOLERANCE = 0.2
"""Relative error of the identified shapes: an effect that is not in the model changes their product at bearings and
sensors by up to 14 % (measured on rigs of an independent program)."""

SPLIT = 2.0
"""Largest ratio of a mode's amplitudes at bearings and at sensors, or inverse, that is believed. The data determine
their product; the ratio only through the position stiffness, so that an effect that is not in the model changed it by
up to a factor of 100, where rotors of an independent program had up to 2.2."""

OF_ROTOR = 0.05
"""Least residue, over 1/mass, of a mode of the rotor, which moves the rotor about as much as a force does that moves it
rigidly: the faintest of 576 modes of rigs of independent programs had 0.051, half of them more than 4. A blade, a rim
or a heavy pedestal has a few hundredths."""


def with_identified_modes(experiment: Experiment, datasheet: Datasheet) -> tuple[Datasheet, str]:
    """The datasheet with the rotor's modes as identified from the experiment, and a note on it.

    A resonance with the shape of a support, and one that hardly moves the rotor, is left to the diagnosis. Any other
    one is taken for a mode of the rotor.
    """
    from service.identification.fit import identify  # takes a while, and few datasheets know no modes

    try:
        result = identify(experiment, datasheet)
    except AmbError as error:
        return datasheet, f"the datasheet knows no flexible mode, and none could be identified: {error}"
    # a housing or a mode that the twin names as an effect is identified, too, but is in the twin already
    named = [2 * np.pi * m.frequency_hz for m in folded(datasheet).datasheet.modes]
    of_planes = [
        _apart([m for m in plane.modes if m.kind == "rotor" and not _among(m, named)])
        for plane in result.planes.values()
    ]
    shown: list[Mode] = []
    for k, plane in enumerate(of_planes):  # a mode may show in one plane alone
        first = (mode for mode in plane if not _same(mode, of_planes[:k]))
        shown += [_mean([mode, *_same(mode, of_planes[k + 1 :])]) for mode in first]
    shown.sort(key=lambda mode: mode.frequency_hz)
    if not shown:
        return datasheet, "the datasheet knows no flexible mode, and the experiment shows none"
    residues = [_residue(mode.shape_at_bearings, mode.shape_at_sensors) * datasheet.mass_kg for mode in shown]
    faint = [mode for mode, residue in zip(shown, residues, strict=True) if residue < OF_ROTOR]
    own = [mode for mode in shown if mode not in faint]
    shapes = np.array([(mode.shape_at_bearings, mode.shape_at_sensors) for mode in own])
    support = move_as_supports(shapes.reshape(-1, 2, 2))
    modes, left = ([mode for mode, s in zip(own, support, strict=True) if s == of] for of in (False, True))
    tolerance = replace(datasheet.tolerance, mode_shape=max(datasheet.tolerance.mode_shape, SHAPE_TOLERANCE))
    note = "the datasheet knows no flexible mode"
    if modes:
        note += (
            f": {_listed(modes)} were identified from this experiment; another mode cannot be told from them, nor a "
            "resonance of the support that moves its ends unlike"
        )
    if left:
        note += (
            f"; {_listed(left)} moves bearings and sensors as a support does, and was taken for no mode of the rotor"
        )
    if faint:
        note += f"; {_listed(faint)} moves the rotor too little for a mode of its own, and was taken for none"
    return replace(datasheet, modes=tuple(modes), tolerance=tolerance), note


def _listed(modes: Sequence[Mode]) -> str:
    return " and ".join(f"{mode.frequency_hz:.1f} Hz" for mode in modes)


def _apart(modes: Sequence[ModeResult]) -> list[ModeResult]:
    """A plane's modes without weaker ones beside a stronger one: coupling shows the other plane's loop there."""
    w, strength = (np.array([f(m) for m in modes]) for f in (lambda m: m.natural_frequency_rad_s.value, _strength))
    near = np.abs(w[:, None] / w - 1) < SAME
    return [m for m, beside, own in zip(modes, near, strength, strict=True) if own >= strength[beside].max()]


def _strength(mode: ModeResult) -> float:
    """Size of a mode's residues, 1/kg."""
    shape = _shape(mode)
    return _residue(shape[:2], shape[2:])


def _residue(at_bearings: ArrayLike, at_sensors: ArrayLike) -> float:
    """Size of a mode's residues, 1/kg, of its shapes, 1/sqrt(kg)."""
    return float(np.linalg.norm(at_bearings) * np.linalg.norm(at_sensors))


def _same(mode: ModeResult, others: Sequence[Sequence[ModeResult]]) -> list[ModeResult]:
    """The mode as the other planes have it."""
    w = mode.natural_frequency_rad_s.value
    return [m for plane in others for m in plane if abs(m.natural_frequency_rad_s.value / w - 1) < SAME]


def _among(mode: ModeResult, named_rad_s: Sequence[float]) -> bool:
    return any(abs(mode.natural_frequency_rad_s.value / w - 1) < SAME for w in named_rad_s)


def _mean(modes: Sequence[ModeResult]) -> Mode:
    """A mode as the mean of what the planes show of it."""
    of_planes = [_shape(m) for m in modes]
    # The sign of a mode shape is arbitrary, and where both ends move alike noise decides which is the larger.
    shapes = np.mean([shape * np.sign(shape @ of_planes[0]) for shape in of_planes], axis=0)
    return Mode(
        float(np.mean([m.natural_frequency_rad_s.value for m in modes]) / (2 * np.pi)),
        float(np.mean([m.damping_ratio.value for m in modes])),
        (float(shapes[0]), float(shapes[1])),
        (float(shapes[2]), float(shapes[3])),
    )


def _shape(mode: ModeResult) -> NDArray[np.float64]:
    """Shape at bearings A, B and sensors A, B, (4,), its ratio limited to `SPLIT`; positive where it is largest."""
    bearings, sensors = (np.array([e.value for e in at]) for at in (mode.shape_at_bearings, mode.shape_at_sensors))
    ratio = np.linalg.norm(bearings) / np.linalg.norm(sensors)
    moved = np.sqrt(np.clip(ratio, 1 / SPLIT, SPLIT) / ratio)
    shape = np.r_[bearings * moved, sensors / moved]
    return np.asarray(shape * np.sign(shape[np.argmax(np.abs(shape))]))
