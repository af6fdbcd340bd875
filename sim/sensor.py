"""Displacement sensors: gain, first-order lags, delay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rig import Array, Sensors


def response(sensors: Sensors, omega_rad_s: Array) -> NDArray[np.complex128]:
    """y per displacement at the sensor, (F, n)."""
    s = 1j * np.asarray(omega_rad_s)[:, None]
    lags = (1 + s / sensors.bandwidth_rad_s) * (1 + s * sensors.lag_s)
    return np.asarray(sensors.gain * np.exp(-s * sensors.delay_s) / lags)
