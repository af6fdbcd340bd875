"""A rig as physics sees it: the parts that an effect may change, and nothing else.

A `Rig` is a value. The time simulation (`sim.stepping`) and the frequency-domain model (`sim.twin`,
`sim.harmonic_balance`) are both built from it, so whatever is written here acts in both.

The chain of one axis, all signals in SI::

    r ──(+)── u ──[hold, delay]──[crosstalk]──[amplifier]── i ──[magnet]── f ──[rotor, support]── x ──[sensor]── y
         └───────────────────────────── C(z) of -y ──────────────────────────────────────────────────────────┘
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHORTEST_LAG_S = 1e-9
"""A first-order lag below this is none in the time domain: it would only make the equations stiff."""


@dataclass(frozen=True)
class FlexibleMode:
    """Mode of the free rotor in one plane, unit modal mass."""

    natural_frequency_rad_s: float
    damping_ratio: float
    shape_at_bearings: tuple[float, float]
    """(A, B), 1/sqrt(kg)."""
    shape_at_sensors: tuple[float, float]
    """(A, B), 1/sqrt(kg)."""
    gyroscopic: float = 0.0
    """Coupling of the two planes' copies of this mode, per unit modal mass: q'' + gyroscopic W q' (1)."""
    internal_damping_ratio: float = 0.0
    """Damping that turns with the shaft, beside ``damping_ratio``: circulatory forces at speed."""


@dataclass(frozen=True)
class Disc:
    """What turns with the shaft where flexible modes tilt it: its moment couples all that tilts there."""

    polar_inertia_kgm2: float
    slopes_per_m_sqrt_kg: tuple[float, ...]
    """Tilt per modal displacement, of the modes in order; those beyond do not tilt it."""


@dataclass(frozen=True)
class Rotor:
    """Rigid body and flexible modes, one tuple of modes per plane."""

    mass_kg: float
    transverse_inertia_kgm2: float
    polar_inertia_kgm2: float
    bearing_from_cog_m: tuple[float, float]
    sensor_from_cog_m: tuple[float, float]
    modes: tuple[tuple[FlexibleMode, ...], ...]
    """modes[plane][k]."""
    discs: tuple[Disc, ...] = ()
    """Whose polar inertias are beyond ``polar_inertia_kgm2``, which tilts with the rigid body alone."""
    gyroscopic_between: tuple[tuple[int, int, float], ...] = ()
    """(j, k, g): two modes that the moments of a whole shaft couple across the planes as `FlexibleMode.gyroscopic`
    couples one mode's copies, beyond what discs do."""

    @property
    def whole_polar_inertia_kgm2(self) -> float:
        """Of the rotor as a rigid body."""
        return self.polar_inertia_kgm2 + sum(disc.polar_inertia_kgm2 for disc in self.discs)


@dataclass(frozen=True)
class Support:
    """Housing on a mass-spring: bearings and sensors see the rotor relative to it, magnets react on it."""

    mass_kg: float
    natural_frequency_rad_s: float
    damping_ratio: float
    pedestals: float = 0.0
    """Share of the inverse mass that is in a pedestal under each bearing, which moves apart from the other end's; the
    rest is in one housing that carries both."""
    frequency_ratio: float = 1.0
    """Natural frequency of the pedestal at B over that at A."""
    damping_quotient: float = 1.0
    """Damping ratio of the pedestal at B over that at A."""
    plane_frequency_ratio: float = 1.0
    """Natural frequency in y over that in x, of housing and pedestals."""
    rocking: float = 0.0
    """Inverse inertia with which the housing of both bearings also rocks, times the square of half their distance, over
    the inverse mass; 0 where it only translates."""
    rocking_frequency_ratio: float = 1.5
    """Natural frequency of its rocking over that of its translation."""
    rocking_damping_quotient: float = 1.0
    """Damping ratio of its rocking over that of its translation."""
    rocking_plane_quotient: float = 1.0
    """``plane_frequency_ratio`` of its rocking over that of its translation."""
    rocking_imbalance: float = 0.0
    """By which it moves bearing A more and bearing B less than their mean as it rocks, 0 about the middle between."""
    shares: tuple[float, ...] = ()
    """Inverse mass at each axis over the mean, n; () for the same everywhere. A housing has the mean of its plane, and
    moves either bearing as the root of its share: where they differ it leans as it moves."""

    def of_axis(self, axis: int) -> float:
        """Inverse mass at an axis, over the mean of all."""
        return self.shares[axis] if self.shares else 1.0


@dataclass(frozen=True)
class Contact:
    """Stops of each axis at the bearing: a spring beyond the clearance."""

    clearance_m: Array
    """(n,) free way; inf where there is no stop"""
    stiffness_n_per_m: float
    side: float = 0.0
    """0 stops to either side alike, 1 only where displacement is positive, -1 only where it is negative"""
    centre_m: Array | float = 0.0
    """(n,) where the middle between the stops of an axis is, as an auxiliary bearing is never centred"""
    ring: float = 0.0
    """1 where the stops of both planes at a bearing are one ring, which pushes along the radius; 0 where each axis has
    its own, between them that share of either"""


@dataclass(frozen=True)
class Magnets:
    """Differentially driven magnets, per axis: f = k ((i0 + i)^2/(s0 - x)^2 - (i0 - i)^2/(s0 + x)^2).

    ``ki`` and ``ks`` are the factors of the centred, unloaded bearing; the gap follows from them,
    s0 = i0 ki / ks, and k = ki s0^2 / (4 i0).
    """

    ki: Array
    """Force-current factor, N/A, (n,)."""
    ks: Array
    """Position stiffness, N/m, positive destabilises, (n,)."""
    bias_current_a: Array
    current_limit_a: float
    offset_m: Array
    """Displacement of the magnetic from the sensor's centre, (n,)."""
    eddy_time_constant_s: Array
    """tau of `sim.actuator.eddy_factor` between coil current and flux, 0 for none, (n,)."""
    eddy_corner_rad_s: float
    """wc: below it the sheets are thinner than the skin depth and the lag is of first order; 0 for solid iron."""
    saturation_current_a: Array
    """i_s of i_s tanh(i/i_s), inf for none, (n,)."""
    hysteresis_rad: Array
    """Loss angle of the current's loop, 0 for none, (n,): of a Rayleigh loop, at the reference amplitude."""
    hysteresis_reference_a: float
    cross_coupling_rad: Array
    """Rotation of the force from x to y at A and B, (2,)."""
    cross_coupling_symmetric: Array
    """Share of the x force that acts in y, and the reverse, at A and B, (2,)."""
    flux_share: Array
    """Flux density at the bias over that at which a pole saturates, 0 for none, (n,)."""
    flux_power: float = 4.0
    """n of a pole's pull / (1 + (B/Bs)^n)"""
    turned_whole: float = 0.0
    """1 where magnets whose force is turned pull along turned axes, too; 0 where the force alone is turned."""
    hysteresis_narrowest_a: float = 0.0
    """Half width of the narrowest play of the iron; those of a Rayleigh loop begin at 0 and have no end."""
    hysteresis_widest_inverse_per_a: float = 0.0
    """1 / half width of the widest; no wider than the narrowest, that is the only one."""
    hysteresis_density: tuple[float, ...] = ()
    """Plays beside those, from one of `sim.actuator.PLAY_EDGES` to the next: how dense they are over those of the
    Rayleigh loop. A few plays far apart, as of an iron's grains or of a model, have no even density."""
    hysteresis_displacement_share: float = 0.0
    """Share in which the plays also follow the flux of a moving rotor: 1 where they lag behind ki i + ks x."""
    eddy_free_share: float = 0.0
    """Share of the flux that eddy currents do not hold back."""
    eddy_displacement_share: float = 0.0
    """Share of their lag that the flux of a moving rotor has, too: 1 where all of it passes the same iron."""

    @staticmethod
    def plain(ki: Array, ks: Array, bias_current_a: Array, current_limit_a: float) -> Magnets:
        """Magnets of the force law alone, without any further effect."""
        n = len(ki)
        return Magnets(
            ki=ki,
            ks=ks,
            bias_current_a=bias_current_a,
            current_limit_a=current_limit_a,
            offset_m=np.zeros(n),
            eddy_time_constant_s=np.zeros(n),
            eddy_corner_rad_s=0.0,
            saturation_current_a=np.full(n, np.inf),
            hysteresis_rad=np.zeros(n),
            hysteresis_reference_a=0.5,
            cross_coupling_rad=np.zeros(2),
            cross_coupling_symmetric=np.zeros(2),
            flux_share=np.zeros(n),
        )

    @property
    def gap_m(self) -> Array:
        """Nominal air gap s0 = i0 ki / ks, (n,)."""
        return self.bias_current_a * self.ki / self.ks


@dataclass(frozen=True)
class Amplifiers:
    """Current amplifiers: i/u = gain w^2/(s^2 + 2 zeta w s + w^2), or gain w/(s + w) where zeta is None."""

    gain: Array
    natural_frequency_rad_s: Array
    damping_ratio: Array | None
    delay_s: Array
    """Delay between u and the coil, (n,)."""
    crosstalk: Array
    """Share of u_j that drives coil i, identity for none, (n, n)."""
    slew_limit_a_per_s: Array
    """Largest |di/dt| that the supply voltage allows at zero current, inf for none, (n,)."""
    lag_s: float = 0.0
    """Time constant of a further first-order lag in front of every amplifier (a filter, a slow power stage)."""
    slew_seen: float = 0.0
    """Share of the damping that acts on the slope that the coil has, not on the one asked for, where it is limited:
    0 for a current loop that does not know of its limit, 1 for one whose damping is in the coil."""
    slope_noise_share: float = 0.0
    """Root mean square of the slopes that noise asks of a coil, over its slew limit: they reach a limit that the tone
    alone does not. Of the harmonic balance alone; in time a rig has its noise."""

    @staticmethod
    def plain(gain: Array, natural_frequency_rad_s: Array, damping_ratio: Array | None) -> Amplifiers:
        """Amplifiers of first or second order, without any further effect."""
        n = len(gain)
        return Amplifiers(
            gain=gain,
            natural_frequency_rad_s=natural_frequency_rad_s,
            damping_ratio=damping_ratio,
            delay_s=np.zeros(n),
            crosstalk=np.eye(n),
            slew_limit_a_per_s=np.full(n, np.inf),
        )


@dataclass(frozen=True)
class Sensors:
    """Displacement sensors: y = gain x through an optional first-order lag and a delay."""

    gain: Array
    bandwidth_rad_s: Array
    """First-order pole, inf for none, (n,)."""
    delay_s: Array
    lag_s: Array
    """Time constant of a further first-order pole, 0 for none, (n,)."""


@dataclass(frozen=True)
class ControlLaw:
    """Discrete controller from -y to u, the same in every axis but for ``apart``, highest power of z first."""

    numerator: Array
    denominator: Array
    sample_time_s: float
    computing_delay_s: float = 0.0
    apart: tuple[tuple[Array, Array], ...] = ()
    """(numerator, denominator) of each axis where they differ, of which the law above is the mean; () where not."""


@dataclass(frozen=True)
class Disturbance:
    """A sinusoid added to one signal: frequency = fixed_hz + order * speed / 2 pi."""

    target: str
    """"i" (coil current, A) or "y" (sensor output, m)."""
    amplitude: Array
    """(n,)."""
    phase_rad: Array
    fixed_hz: float = 0.0
    order: float = 0.0


@dataclass(frozen=True)
class Drift:
    """Change of the magnets while a campaign runs, as they warm up."""

    ki_change: Array
    """Relative change of each axis's ki at ``duration_s``, (n,)."""
    ks_change: Array
    """The same of ks, (n,)."""
    duration_s: float
    curvature: float = 0.0
    """``duration_s`` in time constants of an exponential approach; 0 for a change in proportion to time"""

    def progress(self, share: Array) -> Array:
        """Share of the change that has come about when a share of ``duration_s`` has passed."""
        if abs(self.curvature) < 1e-6:
            return share
        return np.asarray(np.expm1(-self.curvature * share) / np.expm1(-self.curvature))

    def over(self, duration_s: float) -> Drift:
        """The same drift, stated over another time: what has changed when that has passed."""
        longer = duration_s / self.duration_s
        gone = self.progress(np.array(longer))
        return Drift(self.ki_change * gone, self.ks_change * gone, duration_s, self.curvature * longer)


@dataclass(frozen=True)
class Noise:
    """White measurement noise, standard deviations per sample, and quantisation steps (0 for none)."""

    displacement_m: float = 0.0
    current_a: float = 0.0
    displacement_step_m: float = 0.0
    current_step_a: float = 0.0


@dataclass(frozen=True)
class Rig:
    """A whole rig: parts, limits, and the conditions under which it runs."""

    name: str
    axes: tuple[str, ...]
    rotor: Rotor
    magnets: Magnets
    amplifiers: Amplifiers
    sensors: Sensors
    controller: ControlLaw
    displacement_limit_m: float
    current_limit_a: float
    linear_range_m: float
    support: Support | None = None
    contact: Contact | None = None
    seal_cross_stiffness_n_per_m: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """K of fx = -K y, fy = +K x, displacements at the bearings A and B, (2, 2); diagonal for seals that are there."""
    seal_cross_stiffness_by_speed_ns_per_m: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """What the speed adds to it, as the rotor carries the fluid round: K per rad/s, (2, 2)."""
    seal_damping_ns_per_m: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """C of direct damping fx = -C x', fy = -C y' of seals whose cross stiffness goes with the speed, (2, 2)."""
    seal_damping_times_speed_n_per_m: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """C W of those whose cross stiffness does not: damping that is stated by what it is at the rig's speed, (2, 2)."""
    seal_bow_per_sqrt_kg: tuple[float, ...] = ()
    """How much farther than the bearings the first modes move the shaft at the seals, the same in both planes."""
    disturbances: tuple[Disturbance, ...] = ()
    noise: Noise = field(default_factory=Noise)
    logging_offset_samples: float = 0.0
    """Logged u is this many samples early against i and y; whole where the rig runs in time."""
    drift: Drift | None = None
    speed_rad_s: float = 0.0
    gravity_m_per_s2: float = 0.0
    """Weight shared by all axes at 45 degrees; 0 for a vertical or unloaded rotor."""
    static_current_a: Array | None = None
    """Mean coil current that holds whatever load there is, (n,), in place of the weight's; None where that is all."""

    @property
    def n_axes(self) -> int:
        """Number of axes."""
        return len(self.axes)

    @property
    def n_planes(self) -> int:
        """Number of planes, two axes each."""
        return len(self.axes) // 2
