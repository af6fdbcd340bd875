"""What an experiment may ask of a rotor so that it is not endangered, whichever explanation in question is true."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Limits
from service.gap.measured.observation import Observation
from sim.errors import AmbError
from sim.loop import Loop
from sim.rig import Rig

Real = NDArray[np.float64]

SPEEDS = tuple(2 * np.pi * per_second for per_second in (50.0, 40.0, 30.0, 20.0, 10.0))
"""Speeds to which a rotor may be brought, rad/s: the fastest shows most, so the first safe one is taken."""
MARGIN = 1.25
"""Ratio to a speed below which there is no critical speed, and up to which the loop is stable: separation margins of
API 617 end at about 0.27, and a force that turns with the shaft grows with speed."""
WELL_DAMPED = 0.2
"""Damping ratio from which a whirl makes no critical speed: it amplifies an unbalance less than 2.5 times (API 617)."""
STEPS = 5
"""Speeds at which a loop is looked at on the way up."""
GONE = 1e-6
"""Magnitude up to which a pole of the sampled loop is that of a delay."""
SLOWEST_RAD_S = 1.0
"""Slowest whirl; what is slower is an integrator of the controller."""
SWING = 2.0
"""Way that a tone's start may take, in amplitudes of the tone, with the noise that is there."""


def safe_speed(rigs: Iterable[Rig], datasheet: Rig) -> float | None:
    """The fastest of `SPEEDS` that is below all critical speeds, and where no loop becomes unstable; None without one.

    The rotor is not taken through a critical speed: nobody has seen how it passes there.

    Parameters
    ----------
    rigs
        Those of all explanations in question.
    datasheet
        The rig as its datasheet has it, which tells modes that a fit may have moved.
    """
    rigs = list(rigs)
    slowest = min((f for rig in (datasheet, *rigs) for f in _free_modes(rig)), default=np.inf)
    below = [speed for speed in SPEEDS if MARGIN * speed < slowest]
    return next((speed for speed in below if all(_safe_up_to(rig, MARGIN * speed) for rig in rigs)), None)


def require_levitation(rigs: Iterable[Rig]) -> None:
    """Refuse rigs of which one is not held by its controller.

    Raises
    ------
    LevitationError
        The closed loop of one is unstable.
    """
    for rig in rigs:
        Loop(rig, 1)


def free_way(rig: Rig, limits: Limits) -> Real:
    """How far each axis may be off the sensors' zero to its positive side, m, (n,): to a limit, or to a stop."""
    way = np.full(rig.n_axes, min(limits.displacement_limit_m, limits.linear_range_m))
    if rig.contact is None or rig.contact.side < 0:
        return way
    return np.asarray(np.minimum(way, rig.contact.centre_m + rig.contact.clearance_m))


def largest_shift(seen: Sequence[Observation], rigs: Iterable[Rig], limits: Limits, amplitude_m: float) -> Real:
    """How far the set-points may be moved to their positive side, m, (n,), beside tones of an amplitude.

    Parameters
    ----------
    seen
        The sweeps so far, which tell where the rotor is now.
    rigs
        Those of all explanations in question: one may have a stop on the way.
    """
    now = np.maximum(at_rest(seen), 0.0)
    free = np.min([free_way(rig, limits) for rig in rigs], axis=0)
    return np.asarray(free - now - SWING * amplitude_m)


def at_rest(seen: Sequence[Observation]) -> Real:
    """Mean displacement of each axis that the sensors have told, m, (n,); the larger one where it was moved."""
    means = [np.median(o.Y[:, o.harmonics.index(0)].real, axis=0) for o in seen if 0 in o.harmonics]
    return np.max(means, axis=0) if means else np.zeros(seen[0].Y.shape[2])


def _free_modes(rig: Rig) -> Iterator[float]:
    return (mode.natural_frequency_rad_s for plane in rig.rotor.modes for mode in plane)


def _safe_up_to(rig: Rig, speed_rad_s: float) -> bool:
    """Whether a rig is stable at all speeds up to one, and whirls well damped wherever slower than that."""
    try:
        return not any(
            np.any(critical_speeds(replace(rig, speed_rad_s=speed)) < speed_rad_s)
            for speed in np.linspace(0.0, speed_rad_s, STEPS + 1)
        )
    except (AmbError, np.linalg.LinAlgError):
        return False


def critical_speeds(rig: Rig) -> Real:
    """Speeds of the whirls of a rig's closed loop that are not well damped, rad/s.

    Raises
    ------
    LevitationError
        The closed loop is unstable.
    """
    z = np.linalg.eigvals(Loop(rig, 1).closed_loop())
    s = np.log(z[np.abs(z) > GONE].astype(complex)) / rig.controller.sample_time_s
    return np.asarray(s.imag[(s.imag > SLOWEST_RAD_S) & (-s.real < WELL_DAMPED * np.abs(s))])
