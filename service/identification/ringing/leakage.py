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
from scipy.linalg import matrix_balance

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import loop_states, sampled, with_currents
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel


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
    states, period = len(plant.A), model.known.sample_time_s
    samples = np.round(np.asarray(block_s) / period)
    z = np.exp(1j * points.omega * period)[:, None, None]
    outputs = plant.C if points.I is not None else plant.C[2:]
    seen = 2 / samples[:, None, None] * z * (outputs @ np.linalg.inv(z * np.eye(states) - plant.A))
    values, vectors, driven = _modes(loop.A, loop.N * np.asarray(sensor_noise_m))
    return _of_changes(seen @ vectors[:states], values, driven, samples, points.n_blocks)


def _modes(a: Real, drive: Real) -> tuple[Complex, Complex, Complex]:
    """Eigenvalues (n,) and vectors (n, n) of a loop, and what drives each, (n, 2).

    A loop's states differ by ten orders of magnitude in size, and a mode that it hardly damps keeps what rounding puts
    into it: powers of A, and Lyapunov's equation of its entries, lose all digits where each mode by itself loses none.
    """
    balanced, scale = matrix_balance(a, permute=False)
    size = np.diag(scale)
    values, vectors = np.linalg.eig(balanced)
    driven = np.linalg.solve(vectors, drive / size[:, None])
    return values.astype(np.complex128), np.asarray(size[:, None] * vectors), driven.astype(np.complex128)


def _of_changes(seen: Complex, values: Complex, driven: Complex, samples: Real, blocks: int) -> Complex:
    """Covariance (P, B, c, B, c) of what outputs (P, c, n) see of the modes' changes over blocks of so many samples."""
    steady = driven @ driven.conj().T / (1.0 - np.outer(values, values.conj()))
    kept = values ** samples[:, None]
    gone = 1.0 - kept
    to = steady @ seen.conj().transpose(0, 2, 1)
    same = (seen * gone[:, None]) @ to
    out = np.empty((len(seen), blocks, seen.shape[1], blocks, seen.shape[1]), dtype=np.complex128)
    later = -seen * (gone**2)[:, None]  # from one block to the next, and so on
    for lag in range(blocks):
        if lag == 0:
            by_lag = same + same.conj().transpose(0, 2, 1)
        else:
            by_lag = later @ to
            later = later * kept[:, None]
        for c in range(blocks - lag):
            out[:, c + lag, :, c] = by_lag
            out[:, c, :, c + lag] = by_lag.conj().transpose(0, 2, 1)
    return out
