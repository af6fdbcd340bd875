"""The reference rig: Khader, System Identification of Active Magnetic Bearing for Commissioning.

``reference_datasheet`` has what was known before the experiment (Table 5-1), ``reference_rig`` what was
found (Tables 5-3 and 5-5, Appendix A). The controller is a decentralised PID with a biquad at 750 Hz that
levitates the rig; a plain PID leaves mode 2 undamped.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial

from sim.datasheet import Datasheet
from sim.rig import Amplifiers, Array, ControlLaw, FlexibleMode, Magnets, Noise, Rig, Rotor, Sensors

SAMPLE_TIME_S = 1e-4
BIAS_CURRENT_A = 2.75


def pid_with_biquad(
    proportional_a_per_m: float = 18e3,
    integral_a_per_ms: float = 36e3,
    derivative_as_per_m: float = 80.0,
    filter_hz: float = 3e3,
    notch_hz: float = 750.0,
    notch_damping: tuple[float, float] = (0.2, 0.7),
    sample_time_s: float = SAMPLE_TIME_S,
) -> tuple[Array, Array]:
    """Discrete (numerator, denominator) of PID, derivative filter and biquad, by Tustin's rule."""
    wf, wn = 2 * math.pi * filter_hz, 2 * math.pi * notch_hz
    # Kp + Ki/s + Kd s wf/(s + wf) over s (s + wf)
    pid = np.array(
        [
            proportional_a_per_m + derivative_as_per_m * wf,
            proportional_a_per_m * wf + integral_a_per_ms,
            integral_a_per_ms * wf,
        ]
    )
    numerator = np.polymul(pid, [1.0, 2 * notch_damping[0] * wn, wn**2])
    denominator = np.polymul([1.0, wf, 0.0], [1.0, 2 * notch_damping[1] * wn, wn**2])
    b, a = (_tustin(np.asarray(x, dtype=float), sample_time_s) for x in (numerator, denominator))
    return b / a[0], a / a[0]


def _tustin(polynomial: Array, sample_time_s: float) -> Array:
    """A polynomial in s, (n + 1,), at s = 2 / T (z - 1) / (z + 1), times a constant and (z + 1)^n.

    To the last bit what `scipy.signal.bilinear` has, without the half second that importing it takes: every simulated
    rig, and every command that offers one, would begin with that.
    """
    n, scale = len(polynomial) - 1, np.sqrt(2 / sample_time_s)
    above, below = Polynomial([1.0, 1.0]) / scale, Polynomial([-1.0, 1.0]) * scale
    total = sum((c * above ** (n - k) * below**k for k, c in enumerate(polynomial[::-1])), Polynomial([0.0]))
    return np.asarray(total.coef[::-1], dtype=float)


def reference_datasheet() -> Datasheet:
    """What was known before the experiment: Table 5-1. No mode is known, the amplifier by its type only."""
    b, a = pid_with_biquad()
    return Datasheet(
        name="reference",
        axes=("xA", "xB", "yA", "yB"),
        mass_kg=280.0,
        transverse_inertia_kgm2=10.87,
        polar_inertia_kgm2=None,
        bearing_from_cog_m=(0.418, 0.404),
        sensor_from_cog_m=(0.484, 0.470),
        modes=(),
        current_stiffness_n_per_a=(340.0,) * 4,
        position_stiffness_n_per_m=(2.3e6,) * 4,
        bias_current_a=(BIAS_CURRENT_A,) * 4,
        linear_range_m=80e-6,
        amplifier_gain=(1.0,) * 4,
        amplifier_natural_frequency_hz=(1500.0,) * 4,
        amplifier_damping_ratio=(0.8,) * 4,
        sensor_gain=(1.0,) * 4,
        sensor_bandwidth_hz=None,
        sample_time_s=SAMPLE_TIME_S,
        computing_delay_s=0.0,
        numerator=tuple(b.tolist()),
        denominator=tuple(a.tolist()),
        displacement_limit_m=80e-6,
        current_limit_a=6.0,
    )


def _modes(frequencies: tuple[float, float], damping: tuple[float, float]) -> tuple[FlexibleMode, ...]:
    """Shapes that match the residues of Appendix A, unit modal mass."""
    return (
        FlexibleMode(frequencies[0], damping[0], (0.0806, 0.0457), (0.080, 0.1416)),
        FlexibleMode(frequencies[1], damping[1], (0.21, 0.0827), (0.20, 0.0189)),
    )


def reference_noise(displacement_limit_m: float = 80e-6, current_limit_a: float = 6.0) -> Noise:
    """Sensor noise 20 nm and current noise 2 mA a sample, with 16-bit steps; of other limits as large a share of them.

    >>> reference_noise(160e-6, 3.0).displacement_m, reference_noise(160e-6, 3.0).current_a
    (4e-08, 0.001)
    """
    y, i = displacement_limit_m / 80e-6, current_limit_a / 6.0
    return Noise(
        displacement_m=20e-9 * y,
        current_a=2e-3 * i,
        displacement_step_m=250e-6 / 2**16 * y,
        current_step_a=20 / 2**16 * i,
    )


def reference_rig(speed_rad_s: float = 0.0, gravity_m_per_s2: float = 0.0, noise: Noise | None = None) -> Rig:
    """What was identified: Tables 5-3 and 5-5, amplifier poles and modal damping of Appendix A.

    With the noise of `reference_noise`, unless ``noise`` says otherwise.
    """
    b, a = pid_with_biquad()
    poles = np.array([-7458 + 5462j, -8008 + 5364j] * 2)
    w = np.abs(poles)
    n = 4
    return Rig(
        name="reference",
        axes=("xA", "xB", "yA", "yB"),
        rotor=Rotor(
            mass_kg=280.0,
            transverse_inertia_kgm2=10.87,
            polar_inertia_kgm2=1.9,
            bearing_from_cog_m=(0.418, 0.404),
            sensor_from_cog_m=(0.484, 0.470),
            modes=(
                _modes((3097.0, 5708.0), (3.766 / 3097.0, 6.071 / 5708.0)),
                _modes((3091.0, 5701.0), (3.534 / 3091.0, 2.839 / 5701.0)),
            ),
        ),
        magnets=Magnets.plain(
            ki=np.array([181.0, 186.0, 184.0, 198.0]),
            ks=np.array([1.68e6, 1.73e6, 1.69e6, 1.88e6]),
            bias_current_a=np.full(n, BIAS_CURRENT_A),
            current_limit_a=6.0,
        ),
        amplifiers=Amplifiers.plain(np.ones(n), w, -poles.real / w),
        sensors=Sensors(gain=np.ones(n), bandwidth_rad_s=np.full(n, np.inf), delay_s=np.zeros(n), lag_s=np.zeros(n)),
        controller=ControlLaw(b, a, SAMPLE_TIME_S),
        displacement_limit_m=80e-6,
        current_limit_a=6.0,
        linear_range_m=80e-6,
        noise=reference_noise() if noise is None else noise,
        speed_rad_s=speed_rad_s,
        gravity_m_per_s2=gravity_m_per_s2,
    )
