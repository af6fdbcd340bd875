"""Experiments that can be run without opening the machine, as profiles that the service accepts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Limits, Profile, aims
from service.gap.measured.condition import ANOTHER_SPEED
from service.gap.measured.observation import Observation
from service.gap.proposal.safety import largest_shift, safe_speed
from sim.rig import Rig

Real = NDArray[np.float64]

SHORT: Mapping[str, float] = {
    "validation_points": 12,
    "amplifier_points": 0,
    "coarse_points": 8,
    "peak_points": 3,
    "rig_seconds": 300.0,
}
"""Settings of every option: some minutes for four axes, with a second sweep as unseen data, and no other sweeps."""
LINES, FEW_LINES = 24, 12
"""Main lines of a sweep, and of a slow one, whose lines take long."""
LOUD: Mapping[str, float] = {"displacement_share": 0.35, "current_share": 0.5, "nonlinearity": 10.0}
"""Settings of an option that asks for more amplitude: shares of the range, and some nonlinearity of the magnets."""
NEW_LINE_RATIO = 1.05
"""Ratio of the first new line to the last one measured."""
NARROWEST = 1.5
"""Least ratio of a band's ends."""
LOWEST_HZ, HIGHEST_HZ, OF_NYQUIST = 1.0, 3000.0, 0.7
"""Lowest and highest line of any option, and the highest as a share of the Nyquist frequency."""
TAKEN_HZ = (10_000.0, 20_000.0)
"""Highest first and last line of a sweep that the service accepts."""
OFFSET, LEAST_OFFSET = 0.1, 0.02
"""Share of the air gap by which set-points are moved, and the least one where there is less free way."""

ROUNDING = 1e-9
"""Per cent by which a share that should be whole may fall short of it."""

LARGER = "the same band at twice the largest amplitude so far, or what the rig allows"
SMALLER = "the same band at a third of the smallest amplitude so far"
TELL = "tell the diagnosis of it: the datasheet needs the effect off_centre_rotor with that offset"


@dataclass(frozen=True)
class Option:
    """An experiment that could be run next."""

    name: str
    description: str
    profile: Mapping[str, float]
    """fields of `service.campaign.aims.Profile`, as they are submitted"""
    speed_rad_s: float = 0.0
    offset: float = 0.0
    """share of the air gap by which set-points are moved"""
    amplitude: float | None = None
    """wanted ratio to the largest amplitude measured so far, or to the smallest where it is below 1"""
    by_hand: tuple[str, ...] = ()
    """steps that no controller does, in words"""

    def plan(self) -> Profile:
        """The profile that the service makes from the fields."""
        whole = {k: int(v) if k.endswith("points") else v for k, v in self.profile.items()}
        return Profile(**whole)  # type: ignore[arg-type]

    def rig(self, rig: Rig) -> Rig:
        """A rig at the conditions of the option."""
        magnets = replace(rig.magnets, offset_m=rig.magnets.offset_m + self.shift_m(rig))
        return replace(rig, speed_rad_s=self.speed_rad_s, magnets=magnets)

    def shift_m(self, rig: Rig) -> Real:
        """By how much the set-point of each axis is moved, m, (n,)."""
        return np.asarray(self.offset * rig.magnets.gap_m)

    def new_condition(self, seen: Sequence[Observation]) -> bool:
        """Whether the rotor has not been held at that speed and set-point in any of the sweeps so far."""
        return bool(self.offset) or not any(same_speed(self.speed_rad_s, o.speed_rad_s) for o in seen)


def same_speed(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds are one condition."""
    return abs(one_rad_s - other_rad_s) <= ANOTHER_SPEED * max(abs(one_rad_s), abs(other_rad_s))


def options(
    seen: Sequence[Observation], rig: Rig, limits: Limits, rivals: Sequence[Rig] = (), datasheet: Rig | None = None
) -> list[Option]:
    """The options for a rig, without those of empty bands, and without a speed or a set-point that endangers it.

    Parameters
    ----------
    seen
        The sweeps measured so far.
    rivals
        The rigs of other explanations in question.
    datasheet
        The rig as its datasheet has it, where that is another one.
    """
    low, high = min(float(o.frequency_hz[0]) for o in seen), max(float(o.frequency_hz[-1]) for o in seen)
    highest = min(HIGHEST_HZ, OF_NYQUIST * limits.sample_rate_hz / 2, limits.max_frequency_hz)
    top = min(high, limits.max_frequency_hz, TAKEN_HZ[1])
    same, wide, slow = (low, top), (NEW_LINE_RATIO * high, highest), (LOWEST_HZ, min(low / NEW_LINE_RATIO, top))
    speed = seen[0].speed_rad_s
    as_now = (f"hold the rotor at {_revolutions(speed)}",) if speed else ()

    def option(name: str, description: str, band: tuple[float, float], points: int = LINES) -> Option:
        profile = {**SHORT, "points": points, "from_hz": round(band[0], 3), "to_hz": round(band[1], 3)}
        return Option(name, description, profile, speed, by_hand=as_now)

    def turned(name: str, where: str, there: float, step: str) -> Option:
        return replace(option(name, f"the same band {where}", same), speed_rad_s=there, by_hand=(step,))

    found = [
        replace(option("larger_amplitude", LARGER, same), amplitude=2.0),
        replace(option("smaller_amplitude", SMALLER, same), amplitude=1 / 3),
        option("wide_band", f"each axis from {_hz(wide[0])} up to {_hz(wide[1])}", wide),
        option("low_frequency", f"a slow sweep from {_hz(slow[0])} up to {_hz(slow[1])}", slow, FEW_LINES),
    ]
    shifted = option("set_point", "the same band", same)
    offset = _offset(seen, rig, rivals, limits, shifted.plan())
    if offset >= LEAST_OFFSET:
        words, move = f"the same band with every set-point moved by {100 * offset:.0f} % of the gap", _move(offset, rig)
        found.append(replace(shifted, description=words, offset=offset, by_hand=(*as_now, move, TELL)))
    if rig.n_axes == 4 and (rig.rotor.polar_inertia_kgm2 > 0 or any(rig.rotor.modes)):
        fastest = safe_speed((rig, *rivals), datasheet or rig)
        if fastest is not None:
            there = _revolutions(fastest)
            found.append(turned("speed", f"at {there}", fastest, f"bring the rotor to {there}, no faster, and hold it"))
        if speed:
            found.append(turned("standstill", "at rest", 0.0, "bring the rotor to rest"))
    bands = [(o, o.profile["from_hz"], o.profile["to_hz"]) for o in found]
    return [o for o, begin, end in bands if 0 < begin <= TAKEN_HZ[0] and end >= NARROWEST * begin]


def _offset(seen: Sequence[Observation], rig: Rig, rivals: Sequence[Rig], limits: Limits, profile: Profile) -> float:
    """Share of the air gap, to a per cent, by which set-points may be moved; none or less where they may not."""
    amplitude = max(aim.displacement_m for name, aim in aims(profile, limits).items() if name != "amplifier")
    free = largest_shift(seen, (rig, *rivals), limits, amplitude) / rig.magnets.gap_m
    return float(np.floor(100 * min(OFFSET, float(np.min(free))) + ROUNDING) / 100)


def _move(offset: float, rig: Rig) -> str:
    by = ", ".join(f"{axis} by {1e6 * m:+.3g} µm" for axis, m in zip(rig.axes, offset * rig.magnets.gap_m, strict=True))
    return f"move the set-point of every axis by {100 * offset:.0f} % of the air gap at the controller: {by}"


def _revolutions(speed_rad_s: float) -> str:
    per_second = speed_rad_s / (2 * np.pi)
    return f"{per_second:.3g} rev/s ({60 * per_second:.4g} rev/min)"


def _hz(frequency: float) -> str:
    return f"{frequency / 1000:.3g} kHz" if frequency >= 1000 else f"{frequency:.3g} Hz"
