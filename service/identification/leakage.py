"""What the noise that the controller feeds back leaves in a point's blocks.

Sensors' noise n goes through the controller and keeps the rotor moving. Of that motion a block of N samples, whole
periods of the tone, shows in what y differs from G u only how the plant's state x changed from its start to its end:

    sum over the block of (y - G u) z^-t = C z (z I - A)^-1 (x_start - x_end),    z = exp(jw T)

(Pintelon, Schoukens and Vandersteen, IEEE Trans. Autom. Control 42, 1997, 1717-1720). A resonance is where (z I - A)^-1
is large; and a loop that hardly damps makes x large, and turn so slowly against a tone nearby that all of a point's
blocks are off alike. Where the noise is white, x has the covariance that Lyapunov's equation of the loop gives, and
nothing about it is free but the size of n, which the blocks' scatter tells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

from service.identification.closed_loop import loop_states, sampled, with_currents
from service.identification.plane_model import PlaneModel
from service.identification.points import PlanePoints
from service.identification.zoh import Complex, Real


def leakage(
    points: PlanePoints, model: PlaneModel, controller: tuple[Real, Real], block_s: Real, sensor_noise_m: Real
) -> Complex | None:
    """Covariance of what the loop's own motion leaves in the blocks of [i, y], or of y alone.

    Parameters
    ----------
    points, model, controller
        Where it is wanted; the plane; numerator and denominator of u = C(z)(-y), as it ran.
    block_s
        (P,) length of each point's blocks, s, whole periods.
    sensor_noise_m
        (2,) standard deviation of either sensor's samples, as the controller takes them, m.

    Returns
    -------
    covariance
        (P, B, c, B, c), A^2, A m and m^2, or None where the model's loop is not stable.
    """
    plant = with_currents(model, sampled(model))
    loop = loop_states(model, controller)
    if np.max(np.abs(np.linalg.eigvals(loop.A))) >= 1.0:
        return None
    states, blocks, period = len(plant.A), points.n_blocks, model.known.sample_time_s
    noise = loop.N * np.asarray(sensor_noise_m)
    samples = np.asarray(block_s) / period
    later = _later(loop.A, noise @ noise.T, np.round(samples).astype(int), blocks)[:, :, :states, :states]
    z = np.exp(1j * points.omega * period)[:, None, None]
    outputs = plant.C if points.I is not None else plant.C[2:]
    seen = 2 / samples[:, None, None] * z * (outputs @ np.linalg.inv(z * np.eye(states) - plant.A))
    before = later[:, 1].transpose(0, 2, 1)[:, None]
    change = 2 * later[:, :-1] - later[:, 1:] - np.concatenate([before, later[:, :-2]], axis=1)
    by_lag = seen[:, None] @ change @ seen.conj().transpose(0, 2, 1)[:, None]
    out = np.empty((len(points.omega), blocks, seen.shape[1], blocks, seen.shape[1]), dtype=np.complex128)
    for b in range(blocks):
        for c in range(b + 1):
            out[:, b, :, c] = by_lag[:, b - c]
            out[:, c, :, b] = by_lag[:, b - c].conj().transpose(0, 2, 1)
    return out


def _later(a: Real, drive: Real, samples: NDArray[np.int64], blocks: int) -> Real:
    """E[x(m N) x(0)'] of x+ = A x + noise for m up to the number of blocks, (P, B + 1, n, n)."""
    balanced, scale = matrix_balance(a, permute=False)
    size = np.diag(scale)
    steady = solve_discrete_lyapunov(balanced, drive / np.outer(size, size), method="direct")
    lengths, place = np.unique(samples, return_inverse=True)
    out = np.empty((len(lengths), blocks + 1, *a.shape))
    for k, n in enumerate(lengths):
        out[k, 0], ahead = steady, np.linalg.matrix_power(balanced, int(n))
        for m in range(blocks):
            out[k, m + 1] = ahead @ out[k, m]
    return np.asarray((out * np.outer(size, size))[place])
