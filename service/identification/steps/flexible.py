"""Step 5: flexible modes and the split from the rigid rotor, found from the data.

What the rigid model leaves is searched for poles one after another (orthogonal matching pursuit over a grid of
frequencies and damping ratios, all residues refitted each time). The search only gives starts; how many modes are kept
is decided by the joint fits' evidence in `service.identification.joint.selection`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares

from service.identification.arrays import Complex, Real

DAMPING_GRID = (0.0005, 0.002, 0.008, 0.03, 0.1)
LONE_LINE = 0.8
"""A pole that owes more than this share of its worth to a single line is taken for an outlier."""
MAX_LONE_LINES = 5


@dataclass(frozen=True)
class PoleResidue:
    """G = sum of (R_k + s/nu_k V_k) / (s^2 + 2 sigma_k s + nu_k^2): the modal form of the thesis's flexible model.

    V_k is nil for a rotor with modal damping; it takes up a lag that the model does not have, which would else call
    for further modes beside the true ones.
    """

    nu_rad_s: Real
    """(n,)"""
    sigma_rad_s: Real
    """(n,)"""
    residues: Real
    """(n, 2, 2)"""
    lags: Real
    """(n, 2, 2) V_k."""

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.nu_rad_s)

    def response(self, omega: Real) -> Complex:
        """Frequency response, (P, 2, 2)."""
        both = _both(omega, self.nu_rad_s, self.sigma_rad_s)
        return np.asarray(np.tensordot(both, np.concatenate([self.residues, self.lags]), axes=(1, 0)))


def _basis(omega: Real, nu: Real, sigma: Real) -> Complex:
    s = 1j * omega[:, None]
    return np.asarray(1.0 / (s**2 + 2 * sigma * s + nu**2))


def _both(omega: Real, nu: Real, sigma: Real) -> Complex:
    """Displacement-like and velocity-like basis side by side, (P, 2 n)."""
    basis = _basis(omega, nu, sigma)
    return np.hstack([basis, basis * (1j * omega[:, None] / nu)])


def split_frequency(omega: Real, plant: Complex) -> float:
    """Frequency below which the rigid rotor may be fitted alone, rad/s.

    A rigid rotor's receptance times w^2 + w0^2 is flat; the first frequency at which its largest singular value stands
    three times above the median of what lies below is the foot of the first flexible mode, and the split is at 60 %
    of it. Without such a rise all of the band counts as rigid.
    """
    size = np.linalg.svd(plant, compute_uv=False)[:, 0] * omega**2
    start = max(4, len(omega) // 6)
    for k in range(start, len(omega)):
        # below the rigid poles the product grows as w^2: compare with the largest so far
        if size[k] > 2.5 * np.max(size[: k - 1][omega[: k - 1] < 0.9 * omega[k]], initial=size[0]):
            peak = k + int(np.argmax(size[k : k + max(6, len(omega) // 10)]))
            return float(0.5 * omega[peak])
    return float(omega[-1] * 1.001)


def candidate_poles(omega: Real, above: float = 3.0, per_gap: int = 6) -> tuple[Real, Real]:
    """Grid of (nu, sigma) on which modes are looked for: between the measured lines, and above the band."""
    inside = np.concatenate([np.linspace(a, b, per_gap, endpoint=False) for a, b in pairwise(omega)])
    outside = np.geomspace(omega[-1], above * omega[-1], 12)
    nu = np.concatenate([inside, outside])
    zeta = np.array(DAMPING_GRID)
    return np.repeat(nu, len(zeta)), (nu[:, None] * zeta).ravel()


def search(
    omega: Real, left: Complex, weight: Real, n_modes: int, lowest_rad_s: float, enough: float = 0.0
) -> list[PoleResidue]:
    """Models with 1 to ``n_modes`` poles for what the rigid model leaves.

    Parameters
    ----------
    omega, left
        (F,), (F, 2, 2) measured plant less the rigid one.
    weight
        (F, 2, 2) multiplies residuals.
    n_modes
        Largest number of modes.
    lowest_rad_s
        No mode is looked for below.
    enough
        Stop after two modes or more when the weighted residual is below this.
    """
    nu_grid, sigma_grid = candidate_poles(omega)
    keep = nu_grid >= lowest_rad_s
    nu_grid, sigma_grid = nu_grid[keep], sigma_grid[keep]
    if not len(nu_grid):
        return []
    basis = _basis(omega, nu_grid, sigma_grid)  # (F, C)
    target = left * weight
    nu, sigma = np.empty(0), np.empty(0)
    models: list[PoleResidue] = []
    rest = target.copy()
    gap = np.diff(omega) / omega[1:]
    close = np.minimum(np.append(gap, np.inf), np.append(np.inf, gap)) < 0.03
    # d and s d are orthogonal in the real inner product up to a little, so both projections add up
    power = np.einsum("fc,fab->cab", np.abs(basis) ** 2, weight**2)
    for _ in range(n_modes + MAX_LONE_LINES):
        along = np.einsum("fc,fab->cab", basis.conj(), rest * weight)
        score = np.sum(np.abs(along) ** 2 / power, axis=(1, 2))
        taken = np.min(np.abs(nu_grid[:, None] - nu) / nu_grid[:, None], axis=1, initial=1.0) < 1e-4
        score[taken] = -1.0
        best = int(np.argmax(score))
        more = np.append(nu, nu_grid[best]), np.append(sigma, sigma_grid[best])
        polished = _polished(omega, target, weight, *more)
        model = _fitted(omega, target, weight, *polished)
        now = target - model.response(omega) * weight
        gain = np.sum(np.abs(rest) ** 2 - np.abs(now) ** 2, axis=(1, 2))
        lone = int(np.argmax(gain))
        if close[lone] and gain[lone] > LONE_LINE * max(gain.sum(), 1e-300):
            # a mode has a foot on either side; this is one line that disagrees with its neighbours
            weight = weight.copy()
            weight[lone] = 0.0
            target[lone], rest[lone] = 0.0, 0.0
            continue
        nu, sigma = polished
        order = np.argsort(nu)
        nu, sigma = nu[order], sigma[order]
        model = _fitted(omega, target, weight, nu, sigma)
        models.append(model)
        rest = target - model.response(omega) * weight
        if len(models) == n_modes:
            break
        if len(models) > 1 and np.sum(np.abs(rest) ** 2) < enough**2 * target.size:
            break
    return models


def residues_at(omega: Real, left: Complex, weight: Real, nu: Real, sigma: Real) -> PoleResidue:
    """Residues of (F, 2, 2) by least squares weighted line by line, (F,), the poles given."""
    whole = np.broadcast_to(weight[:, None, None], left.shape)
    return _fitted(omega, left * whole, np.asarray(whole), nu, sigma)


def _fitted(omega: Real, target: Complex, weight: Real, nu: Real, sigma: Real) -> PoleResidue:
    """Residues by linear least squares, entry by entry, the poles given."""
    basis = _both(omega, nu, sigma)
    out = np.empty((2 * len(nu), 2, 2))
    for a in range(2):
        for b in range(2):
            columns = basis * weight[:, a, b, None]
            scale = np.linalg.norm(columns, axis=0)
            matrix = np.concatenate([columns.real, columns.imag]) / scale
            vector = np.concatenate([target[:, a, b].real, target[:, a, b].imag])
            out[:, a, b] = np.linalg.lstsq(matrix, vector, rcond=None)[0] / scale
    return PoleResidue(nu, sigma, out[: len(nu)], out[len(nu) :])


def _polished(omega: Real, target: Complex, weight: Real, nu: Real, sigma: Real) -> tuple[Real, Real]:
    """Poles after a few steps of variable projection."""
    n = len(nu)

    def rest(z: Real) -> Real:
        model = _fitted(omega, target, weight, nu * (1 + z[:n]), sigma * np.exp(z[n:]))
        e = target - model.response(omega) * weight
        return np.concatenate([e.real.ravel(), e.imag.ravel()])

    step = np.concatenate([np.full(n, 3e-3), np.full(n, 2.5)])
    z = least_squares(rest, np.zeros(2 * n), bounds=(-step, step), max_nfev=6, x_scale=step).x
    return nu * (1 + z[:n]), sigma * np.exp(z[n:])


def is_visible(nu_rad_s: float, sigma_rad_s: float, omega: Real) -> bool:
    """Whether a pole is a peak within the band, wide enough for the lines around it to tell."""
    return has_peak(nu_rad_s, sigma_rad_s, omega) and tells(nu_rad_s, sigma_rad_s, omega)


def has_peak(nu_rad_s: float, sigma_rad_s: float, omega: Real) -> bool:
    """Whether a pole is a peak within the band, however sharp."""
    return bool(nu_rad_s <= omega.max() and sigma_rad_s < 0.2 * nu_rad_s)


def tells(nu_rad_s: float, sigma_rad_s: float, omega: Real) -> bool:
    """Whether a peak is damped, and wide enough for the lines around it to tell."""
    near = float(np.sort(np.abs(np.unique(omega) - nu_rad_s))[:2].mean())
    return bool(sigma_rad_s > 1e-5 * nu_rad_s and sigma_rad_s > 0.02 * near)


def shapes_of(residue: Real, ki: Real) -> tuple[Real, Real]:
    """Shapes at bearings and sensors from one residue of the plant, as near to rank one as it is, (2,) each.

    The scale is split evenly; a later step puts it right.
    """
    left, singular, right = np.linalg.svd(residue / ki)
    bearing, sensor = right[0] * np.sqrt(singular[0]), left[:, 0] * np.sqrt(singular[0])
    sign = np.sign(bearing[np.argmax(np.abs(bearing))]) or 1.0
    return bearing * sign, sensor * sign
