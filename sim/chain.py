"""Known linear blocks of a rig's chain for which a datasheet has no field, and what they do at a frequency.

A twin names them as effects; whoever models the rest of the rig holds them fixed::

    u ─[log]─[crosstalk]─ hold, delay, amplifier ─[further lag]─ i ─[eddy currents]─ flux-making current
                                           magnets, rotor, sensor ─[further lag, dead time]─ y
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from sim import actuator, amplifier
from sim.rig import SHORTEST_LAG_S, Amplifiers, Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Chain:
    """Known blocks of n axes; by default none of them does anything."""

    crosstalk: Array = field(default_factory=lambda: np.eye(2))
    """(n, n) share of u_j that drives coil i."""
    logging_offset_samples: float = 0.0
    """Logged u is this many samples early against i and y."""
    amplifiers: Amplifiers | None = None
    """With the further lag that stands in front of them; None for none."""
    delay_s: float = 0.0
    """Delay between u and the coil as far as it is known."""
    sample_time_s: float = 1e-4
    eddy_time_constant_s: Array = field(default_factory=lambda: np.zeros(2))
    """(n,) of `sim.actuator.eddy_factor`, 0 for none."""
    eddy_corner_rad_s: float = 0.0
    eddy_free_share: float = 0.0
    sensor_lag_s: Array = field(default_factory=lambda: np.zeros(2))
    """Time constant of each sensor's further first-order pole, (n,)."""
    sensor_delay_s: Array = field(default_factory=lambda: np.zeros(2))
    """Dead time of each sensor, (n,)."""

    def of(self, axes: list[int]) -> Chain:
        """The blocks of some of the axes."""
        return replace(
            self,
            crosstalk=self.crosstalk[np.ix_(axes, axes)],
            amplifiers=None if self.amplifiers is None else _of(self.amplifiers, axes),
            eddy_time_constant_s=self.eddy_time_constant_s[axes],
            sensor_lag_s=self.sensor_lag_s[axes],
            sensor_delay_s=self.sensor_delay_s[axes],
        )

    @cached_property
    def amplifier_lag_s(self) -> float:
        """Time constant of the further lag between u and the coils."""
        return 0.0 if self.amplifiers is None else self.amplifiers.lag_s

    @cached_property
    def has_crosstalk(self) -> bool:
        """Whether a control signal drives another axis's coil."""
        return bool(np.any(self.crosstalk != np.eye(len(self.crosstalk))))

    @cached_property
    def is_in_log(self) -> bool:
        """Whether logged u or i differ from those of the chain without these blocks."""
        return self.has_crosstalk or self.logging_offset_samples != 0 or self.amplifier_lag_s > 0

    @cached_property
    def is_behind_sensor(self) -> bool:
        """Whether sensors are slower than the datasheet's."""
        return bool(np.any(self.sensor_lag_s > 0) or np.any(self.sensor_delay_s != 0))

    @cached_property
    def is_before_flux(self) -> bool:
        """Whether the flux-making current lags behind what the amplifiers alone would make it."""
        return self.amplifier_lag_s > 0 or bool(np.any(self.eddy_time_constant_s > 0))

    def drive_per_logged(self, omega_rad_s: Array) -> Complex:
        """Input of the amplifiers per logged control signal, A/A, (F, n, n)."""
        turn = np.exp(-1j * np.asarray(omega_rad_s) * self.sample_time_s * self.logging_offset_samples)
        return np.asarray(turn[:, None, None] * self.crosstalk)

    def current_lag(self, omega_rad_s: Array) -> Complex:
        """Sampled coil current over that without the further lag, (F, n).

        Held and sampled, a lag in front of an amplifier is no factor of its own: what it does to the images depends
        on the amplifier, here the datasheet's. The images are a few per mille of i, so an amplifier off by some per
        cent changes this by less than 1e-4.
        """
        if self.amplifiers is None or self.amplifier_lag_s <= 0:
            return np.ones((len(omega_rad_s), len(self.crosstalk)), dtype=np.complex128)
        bare = replace(self.amplifiers, lag_s=0.0)
        delay = np.full(len(self.crosstalk), self.delay_s)
        both = [amplifier.sampled(a, omega_rad_s, self.sample_time_s, delay) for a in (self.amplifiers, bare)]
        return np.asarray(both[0] / both[1])

    def flux(self, omega_rad_s: Array) -> Complex:
        """Flux-making current at the excited line over the current of the amplifiers alone, (F, n)."""
        s: Complex = np.asarray(1j * np.asarray(omega_rad_s)[:, None])
        eddy = actuator.eddy_response(self.eddy_time_constant_s, self.eddy_corner_rad_s, s, self.eddy_free_share)
        return np.asarray(eddy / (1 + s * self.amplifier_lag_s))

    def sensor(self, omega_rad_s: Array) -> Complex:
        """Sensor signals over those without these blocks, (F, n)."""
        s = 1j * np.asarray(omega_rad_s)[:, None]
        return np.asarray(np.exp(-s * self.sensor_delay_s) / (1 + s * self.sensor_lag_s))

    def flux_states(self) -> tuple[Array, Array, Array, Array]:
        """(A, B, C, D) from the amplifiers' currents to the flux-making ones: `flux` with finitely many states.

        A lag of less than a nanosecond is none.
        """
        corner, free = self.eddy_corner_rad_s, self.eddy_free_share
        parts = [_eddy(float(tau), corner, free) for tau in self.eddy_time_constant_s]
        if self.amplifier_lag_s > SHORTEST_LAG_S:
            parts = [_after_lag(p, self.amplifier_lag_s) for p in parts]
        a, b, c, d = (np.asarray(block_diag(*[p[k] for p in parts]), dtype=float) for k in range(4))
        return a, b, c, d


Blocks = tuple[Array, Array, Array, Array]


def _of(amplifiers: Amplifiers, axes: list[int]) -> Amplifiers:
    return replace(
        amplifiers,
        gain=amplifiers.gain[axes],
        natural_frequency_rad_s=amplifiers.natural_frequency_rad_s[axes],
        damping_ratio=None if amplifiers.damping_ratio is None else amplifiers.damping_ratio[axes],
        delay_s=amplifiers.delay_s[axes],
        crosstalk=amplifiers.crosstalk[np.ix_(axes, axes)],
        slew_limit_a_per_s=amplifiers.slew_limit_a_per_s[axes],
    )


def _eddy(time_constant_s: float, corner_rad_s: float, free_share: float) -> Blocks:
    """One axis's eddy currents as decaying states in parallel."""
    if time_constant_s <= 0:
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    poles, weights = actuator.eddy_states(time_constant_s, corner_rad_s, free_share)
    return np.diag(-poles[1:]), poles[1:, None], weights[None, 1:], weights[:1, None]


def _after_lag(block: Blocks, lag_s: float) -> Blocks:
    """The same block behind a first-order lag."""
    a, b, c, d = block
    n = len(a)
    return (
        np.block([[np.array([[-1 / lag_s]]), np.zeros((1, n))], [b, a]]),
        np.vstack([[[1 / lag_s]], np.zeros((n, 1))]),
        np.hstack([d, c]),
        np.zeros((1, 1)),
    )
