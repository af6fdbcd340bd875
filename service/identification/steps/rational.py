"""The measured plant as poles and residues: the rigid rotor's, one of each peak, and what lies beyond the band.

Given the poles everything else is linear, so this has no false minimum that a wrong stiffness could lead to. Peaks are
added one after another where what is left calls loudest for one (orthogonal matching pursuit over a grid of frequencies
and damping ratios), every pole is polished by variable projection each time (Kaufman's Jacobian), and the description
length says when to stop. What comes out are starts; joint fits decide (`service.identification.joint.selection`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from service.identification.arrays import Complex, Real
from service.identification.measured.etfe import FrequencyResponse
from service.identification.steps.flexible import DAMPING_GRID, PoleResidue, candidate_poles, has_peak, is_visible

LEVEL = 0.003
"""Relative model error that counts beside the noise: what lags and neighbours leave is no mode."""
MAX_PEAKS = 8
CLEAR = 10.0
"""Fall of the description length that a further peak has to bring."""
LONE_LINE = 0.8
"""A pole that owes more than this share of its worth to a single line is taken for an outlier."""
MAX_LONE_LINES = 5
RIGID_REACH, FREQUENCY_REACH, BEYOND_REACH, DAMPING_REACH = 0.7, 3e-3, 0.6, 2.5
"""How far the logarithm of a rigid pole may lie from where it is looked for; and how far one polish may move a
frequency within the band and one beyond it, relative, and the logarithm of a damping."""
BEYOND = np.geomspace(1.005, 1.8, 18)
"""Where poles beyond the band are looked for, in units of its end; what lies further is in the remainder."""


@dataclass(frozen=True)
class Rational:
    """P = sum over rigid poles of (R + s/p V)/(s^2 - p^2) + peaks + a remainder C0 + C1 s + C2 s^2."""

    rigid_rad_s: Real
    """(2,) p."""
    rigid: Real
    """(2, 2, 2) R."""
    rigid_lags: Real
    """(2, 2, 2) V."""
    peaks: PoleResidue
    remainder: Real
    """(3, 2, 2) C."""
    rms: float
    """Residual over noise and level together."""

    def flexible_response(self, omega: Real) -> Complex:
        """Peaks and remainder, (F, 2, 2)."""
        s = 1j * omega[:, None, None]
        c = self.remainder
        rest: Complex = np.asarray(c[0] + s * c[1] + s**2 * c[2], dtype=np.complex128)
        return rest + self.peaks.response(omega) if self.peaks.n_modes else rest


@dataclass(frozen=True)
class _Poles:
    rigid: Real
    nu: Real
    sigma: Real

    def moved(self, z: Real) -> _Poles:
        n = len(self.nu)
        return _Poles(self.rigid * np.exp(z[:2]), self.nu * (1 + z[2 : 2 + n]), self.sigma * np.exp(z[2 + n :]))

    def with_one(self, nu: float, sigma: float) -> _Poles:
        order = np.argsort(np.append(self.nu, nu))
        return _Poles(self.rigid, np.append(self.nu, nu)[order], np.append(self.sigma, sigma)[order])


@dataclass(frozen=True)
class _Problem:
    omega: Real
    target: Real
    """(2 F, 4) weighted entries, real parts then imaginary ones."""
    weight: Real
    """(F,)"""
    rigid_rad_s: Real
    """(2,) where the rigid poles are looked for."""

    def columns(self, poles: _Poles) -> Complex:
        """(F, m): rigid, rigid lags, peaks, their lags, remainder."""
        s = 1j * self.omega[:, None]
        rigid, flexible = 1.0 / (s**2 - poles.rigid**2), 1.0 / (s**2 + 2 * poles.sigma * s + poles.nu**2)
        rest = (s / self.omega.max()) ** np.arange(3) / self.omega.max() ** 2
        return np.hstack([rigid, rigid * s / poles.rigid, flexible, flexible * s / poles.nu, rest])

    def solved(self, poles: _Poles) -> tuple[Real, Real, Real]:
        """Coefficients (m, 4), residuals (2 F, 4), and an orthonormal basis of the columns."""
        matrix = _stacked(self.columns(poles) * self.weight[:, None])
        scale = np.linalg.norm(matrix, axis=0)
        left, singular, right = np.linalg.svd(matrix / scale, full_matrices=False)
        keep = singular > 1e-10 * singular[0]
        q = left[:, keep]
        along = q.T @ self.target
        coefficients = (right[keep].T @ (along / singular[keep, None])) / scale[:, None]
        return coefficients, self.target - q @ along, q

    def polished(self, poles: _Poles, most: int = 10) -> _Poles:
        """Poles after a few steps of variable projection."""
        n = len(poles.nu)
        at_z: dict[bytes, tuple[Real, Real, Real]] = {}  # a slope is asked for where the rest was just before

        def solved(z: Real) -> tuple[Real, Real, Real]:
            key = z.tobytes()
            if key not in at_z:
                at_z.clear()
                at_z[key] = self.solved(poles.moved(z))
            return at_z[key]

        def rest(z: Real) -> Real:
            return np.asarray(solved(z)[1].T.ravel())

        def slope(z: Real) -> Real:
            at = poles.moved(z)
            c, _, q = solved(z)
            s = 1j * self.omega
            out = np.empty((len(z), *self.target.shape))
            for k in range(2 + 2 * n):
                if k < 2:
                    p = at.rigid[k]
                    b = 1.0 / (s**2 - p**2)
                    d = 2 * p**2 * b**2
                    change = d[:, None] * c[k] + (d - b)[:, None] * (s / p)[:, None] * c[2 + k]
                else:
                    j = (k - 2) % n
                    nu, sigma = at.nu[j], at.sigma[j]
                    b = 1.0 / (s**2 + 2 * sigma * s + nu**2)
                    by_nu = k < 2 + n
                    d = -(2 * nu * poles.nu[j] if by_nu else 2 * s * sigma) * b**2
                    d_lag = d * s / nu - (b * s * poles.nu[j] / nu**2 if by_nu else 0.0)
                    change = d[:, None] * c[4 + j] + d_lag[:, None] * c[4 + n + j]
                column = _stacked(change * self.weight[:, None])
                out[k] = -(column - q @ (q.T @ column))
            return np.asarray(out.transpose(0, 2, 1).reshape(len(z), -1).T)

        beyond = poles.nu > self.omega.max()
        far = np.where(beyond, BEYOND_REACH, FREQUENCY_REACH)
        reach = np.concatenate([np.full(2, RIGID_REACH), far, np.full(n, DAMPING_REACH)])
        centre = np.concatenate([np.log(self.rigid_rad_s / poles.rigid), np.zeros(2 * n)])
        begin = np.clip(0.0, centre - 0.99 * reach, centre + 0.99 * reach)
        z = least_squares(
            rest, begin, slope, bounds=(centre - reach, centre + reach), max_nfev=most, x_scale=reach, method="trf"
        ).x
        return poles.moved(z)


def rational_fit(plant: FrequencyResponse, rigid_rad_s: Real, lowest_rad_s: float, sharp: bool = False) -> Rational:
    """Poles and residues of a measured plant.

    Parameters
    ----------
    plant
        From coil current to y.
    rigid_rad_s
        (2,) where the rigid poles are looked for.
    lowest_rad_s
        No peak is looked for below.
    sharp
        Whether peaks count, too, that are sharper than the lines around them can tell. What such a one does to the
        lines on either side tells its frequency; its damping is a guess.
    """
    omega = plant.omega
    size = np.linalg.norm(plant.value, axis=(1, 2)) / 2
    weight = 1.0 / np.sqrt(np.mean(plant.std**2, axis=(1, 2)) + (LEVEL * size) ** 2)
    problem = _problem(plant, weight, rigid_rad_s)
    now = problem.polished(_Poles(rigid_rad_s, np.empty(0), np.empty(0)))
    rest = problem.solved(now)[1]
    grids = _grids(omega, lowest_rad_s)
    gap = np.diff(omega) / omega[1:]
    close = np.minimum(np.append(gap, np.inf), np.append(np.inf, gap)) < 0.03
    lone_lines = 0
    while len(now.nu) < MAX_PEAKS:
        tried = [problem.polished(p) for p in _candidates(problem, now, rest, grids)]
        tried = [p for p in tried if all(_shows(p, k, omega, sharp) for k in range(len(p.nu)))]
        if not tried:
            break
        costs = [float(np.sum(problem.solved(p)[1] ** 2)) for p in tried]
        more = tried[int(np.argmin(costs))]
        after = problem.solved(more)[1]
        gain = np.sum(np.abs(_unstacked(rest)) ** 2 - np.abs(_unstacked(after)) ** 2, axis=1)
        lone = int(np.argmax(gain))
        if close[lone] and gain[lone] > LONE_LINE * max(gain.sum(), 1e-300) and lone_lines < MAX_LONE_LINES:
            # a mode has a foot on either side; this is one line that disagrees with its neighbours
            lone_lines += 1
            weight = np.where(np.arange(len(omega)) == lone, 0.0, problem.weight)
            problem = _problem(plant, weight, rigid_rad_s)
            rest = problem.solved(now)[1]
            continue
        if _length(after, more) > _length(rest, now) - CLEAR:
            break
        now, rest = more, after
    return _rational(problem, _pruned(problem, now))


def _grids(omega: Real, lowest_rad_s: float) -> list[tuple[Real, Real, Complex]]:
    """Frequencies, dampings and responses (F, C) of candidates within the band, and beyond it."""
    nu, sigma = candidate_poles(omega, above=1.0)
    inside = (nu >= lowest_rad_s) & (nu < omega.max())
    zeta = np.array(DAMPING_GRID)
    outside = omega.max() * BEYOND
    out = []
    for n, d in (
        (nu[inside], sigma[inside]),
        (np.repeat(outside, len(zeta)), (outside[:, None] * zeta).ravel()),
    ):
        if len(n):
            out.append((n, d, np.asarray(1.0 / (-(omega[:, None] ** 2) + 2j * d * omega[:, None] + n**2))))
    return out


def _candidates(problem: _Problem, now: _Poles, rest: Real, grids: list[tuple[Real, Real, Complex]]) -> list[_Poles]:
    """The poles with the one more that the rest calls loudest for, within the band and beyond it."""
    left, out = _unstacked(rest), []
    for nu, sigma, response in grids:
        power = (np.abs(response) ** 2).T @ problem.weight**2
        along = (response.conj() * problem.weight[:, None]).T @ left
        score = np.sum(np.abs(along) ** 2, axis=1) / power
        score[np.min(np.abs(nu[:, None] - now.nu) / nu[:, None], axis=1, initial=1.0) < 1e-4] = -1.0
        best = int(np.argmax(score))
        out.append(now.with_one(float(nu[best]), float(sigma[best])))
    return out


def _shows(poles: _Poles, k: int, omega: Real, sharp: bool) -> bool:
    """Whether a pole lies beyond the band, or has a peak: one that the lines around it can show, or any."""
    nu, sigma = float(poles.nu[k]), float(poles.sigma[k])
    return bool(nu > omega.max() or (has_peak(nu, sigma, omega) if sharp else is_visible(nu, sigma, omega)))


def _problem(plant: FrequencyResponse, weight: Real, rigid_rad_s: Real) -> _Problem:
    return _Problem(plant.omega, _stacked(plant.value.reshape(-1, 4) * weight[:, None]), weight, rigid_rad_s)


def _pruned(problem: _Problem, now: _Poles) -> _Poles:
    """The poles without those that were added before others made them needless."""
    k = 0
    while k < len(now.nu):
        fewer = problem.polished(_Poles(now.rigid, np.delete(now.nu, k), np.delete(now.sigma, k)))
        if _length(problem.solved(fewer)[1], fewer) < _length(problem.solved(now)[1], now) + CLEAR:
            now, k = fewer, 0
        else:
            k += 1
    return now


def _rational(problem: _Problem, poles: _Poles) -> Rational:
    c, rest, _ = problem.solved(poles)
    n = len(poles.nu)
    entries = c.reshape(-1, 2, 2)
    scale = problem.omega.max() ** (2.0 + np.arange(3))
    peaks = PoleResidue(poles.nu, poles.sigma, entries[4 : 4 + n], entries[4 + n : 4 + 2 * n])
    return Rational(
        poles.rigid,
        entries[:2],
        entries[2:4],
        peaks,
        entries[4 + 2 * n :] / scale[:, None, None],
        float(np.sqrt(2 * np.mean(rest**2))),
    )


def _length(rest: Real, poles: _Poles) -> float:
    n, k = rest.size, 2 + 2 * len(poles.nu) + 4 * (7 + 2 * len(poles.nu))
    # beyond the level of noise and model error nothing is gained
    return float(n * np.log(max(np.sum(rest**2) / n, 0.25)) + k * np.log(n))


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _unstacked(values: Real) -> Complex:
    half = len(values) // 2
    return np.asarray(values[:half] + 1j * values[half:])
