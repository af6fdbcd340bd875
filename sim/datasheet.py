"""The rig's datasheet: what an engineer knows before the experiment. `sim.rig_file` reads and writes it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

AXES = ("xA", "xB", "yA", "yB")

FASTEST_RAD_S = 6e4
"""Beyond any rotor's speed, 573,000 rpm: the rim of one of 1 cm diameter moves at 300 m/s there, and sheets burst."""

ISO_14839_3_DB = (("A", 9.5), ("B", 12.0), ("C", 14.0), ("D", math.inf))
"""Zones of ISO 14839-3 by peak sensitivity and their upper limits, dB."""


def source_of(zones_db: Iterable[tuple[str, float]]) -> str:
    """Where zones of the sensitivity peak are from: names and upper limits in dB, with or without the last zone.

    >>> source_of([("A", 9.5), ("B", 12.0), ("C", 14.0)]), source_of([("good", 9.5), ("bad", math.inf)])
    ('ISO 14839-3', "the rig's own table")
    """
    limited = tuple((name, limit) for name, limit in zones_db if math.isfinite(limit))
    return "ISO 14839-3" if limited == ISO_14839_3_DB[:-1] else "the rig's own table"


NOT_KNOWN = "not known"
"""In place of a zone where nothing tells it."""


def calm_zones(zones_db: Iterable[tuple[str, float]]) -> tuple[str, ...]:
    """Zones of the sensitivity peak in which a machine may stay: as A and B of ISO 14839-3 the first two with a limit.

    >>> calm_zones(ISO_14839_3_DB), calm_zones([("good", 9.5), ("bad", math.inf)])
    (('A', 'B'), ('good',))
    """
    return tuple(name for name, limit in zones_db if math.isfinite(limit))[:2]


@dataclass(frozen=True)
class Mode:
    """A flexible mode of the free rotor, unit modal mass, as the datasheet states it."""

    frequency_hz: float
    damping_ratio: float
    shape_at_bearings: tuple[float, float]
    """(A, B), 1/sqrt(kg)."""
    shape_at_sensors: tuple[float, float]
    """(A, B), 1/sqrt(kg)."""


@dataclass(frozen=True)
class Tolerance:
    """One-sigma errors of the datasheet's values: relative, but ``sensor_position_m``, which is in metres.

    The defaults are the ones that this product assumes where a datasheet is silent: magnets are known
    to a fifth (the reference rig's were off by 47 % and 27 %), geometry and mass to a per cent.
    """

    current_stiffness: float = 0.2
    position_stiffness: float = 0.2
    mode_frequency: float = 0.01
    mode_damping: float = 0.5
    mode_shape: float = 0.1
    mass: float = 0.005
    transverse_inertia: float = 0.01
    sensor_gain: float = 0.01
    amplifier_frequency: float = 0.02
    amplifier_damping: float = 0.05
    amplifier_gain: float = 0.01
    sensor_position_m: float = 0.001


ASSUMED = "the datasheet states no tolerances: this product's defaults are assumed"
"""What to tell wherever tolerances decide."""


@dataclass(frozen=True)
class Datasheet:
    """What is known of a rig before it is measured. Tuples have one value per axis unless said otherwise."""

    name: str
    axes: tuple[str, ...]
    mass_kg: float
    transverse_inertia_kgm2: float
    polar_inertia_kgm2: float | None
    bearing_from_cog_m: tuple[float, float]
    sensor_from_cog_m: tuple[float, float]
    modes: tuple[Mode, ...]
    current_stiffness_n_per_a: tuple[float, ...]
    position_stiffness_n_per_m: tuple[float, ...]
    bias_current_a: tuple[float, ...]
    linear_range_m: float
    amplifier_gain: tuple[float, ...]
    amplifier_natural_frequency_hz: tuple[float, ...]
    """Natural frequency of a second-order amplifier, bandwidth of a first-order one."""
    amplifier_damping_ratio: tuple[float, ...] | None
    """None for a first-order amplifier."""
    sensor_gain: tuple[float, ...]
    sensor_bandwidth_hz: tuple[float, ...] | None
    sample_time_s: float
    computing_delay_s: float
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    displacement_limit_m: float
    current_limit_a: float
    tolerance: Tolerance = field(default_factory=Tolerance)
    tolerance_stated: bool = False
    """Whether the datasheet itself states tolerances."""
    sensitivity_zones_db: tuple[tuple[str, float], ...] = ISO_14839_3_DB
    """By peak sensitivity, rising, the upper limit of each, dB; the last one has none. Not one value per axis."""
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    """Effects that a diagnosis has added to the twin: (id, ((parameter, value), ...)), in order."""

    @property
    def n_axes(self) -> int:
        """Number of measured axes, 2 or 4."""
        return len(self.axes)

    @property
    def sample_rate_hz(self) -> float:
        """Controller's sample rate, Hz."""
        return 1.0 / self.sample_time_s
