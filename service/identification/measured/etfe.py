"""Empirical transfer function estimates: one matrix per frequency, one experiment per column, with covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_above
from service.identification.arrays import Complex, Real
from service.identification.measured.noise import block_noise
from service.identification.measured.points import PlanePoints, same_frequency
from sim.errors import AmbError

Path = Literal["u->i", "u->y", "i->y", "r->u", "r->y"]
MAX_CONDITION = 1e4


class SingularInputError(AmbError):
    """The inputs of no frequency, or not those of one that is wanted, tell the axes apart."""


@dataclass(frozen=True)
class FrequencyResponse:
    """A measured frequency response with the covariance of its entries."""

    omega: Real
    """(F,) rad/s, ascending."""
    value: Complex
    """(F, n_out, n_in)"""
    std: Real
    """(F, n_out, n_in) standard deviation of the complex entry, E|dG|^2 = std^2."""

    @property
    def frequency_hz(self) -> Real:
        """Frequencies, (F,)."""
        return self.omega / (2 * np.pi)

    def radius(self, level: float = 0.99) -> Real:
        """Radius of the circle that holds the true entry with that probability, (F, n_out, n_in)."""
        return np.asarray(self.std * np.sqrt(0.5 * chi2_above(1 - level, 2)))


def etfe(points: PlanePoints, path: Path) -> FrequencyResponse:
    """Frequency response of one plane, (F, 2, 2), at every frequency at which both axes were excited.

    G = Y U^-1 with one column per experiment (eq. 3.11); the covariance is that of the residual Y - G U across
    blocks, carried through U^-1.

    Raises
    ------
    SingularInputError
        No frequency with both inputs; a singular input matrix.
    AmbError
        No currents logged.
    """
    signals: Mapping[str, Complex | None] = {"u": points.U, "i": points.I, "y": points.Y, "r": points.R}
    source, target = path.split("->")
    x, z = signals[source], signals[target]
    if x is None or z is None:
        raise AmbError(f"plane {points.plane}: {path} needs the coil currents, which this experiment does not log")
    more = None
    if points.unsettled is not None and target in "iy":
        variances = np.einsum("pcc->pc", points.unsettled.mean).real
        more = variances[:, -2:] if target == "y" else variances[:, :2]
    return _estimate(x, z, points.omega, points.axis, f"plane {points.plane}", points.axes, path, more)


def _estimate(
    x: Complex,
    z: Complex,
    omega: Real,
    axis: NDArray[np.int64],
    where: str,
    axes: tuple[str, ...],
    path: str,
    more: Real | None = None,
) -> FrequencyResponse:
    """``more``: (P, n_out) variance of the means beside that of the noise."""
    n_in = x.shape[2]
    mean_x, mean_z = x.mean(axis=1), z.mean(axis=1)
    groups = [g for g in same_frequency(omega) if len(np.unique(axis[g])) == n_in]
    if not groups:
        raise SingularInputError(
            f"{where}: {path} needs every one of {', '.join(axes)} excited at the same frequency, and none has that"
        )
    value = np.empty((len(groups), z.shape[2], n_in), dtype=complex)
    gain = np.empty_like(z)  # the model of each point's own blocks
    inverses = []
    conditions = _conditions(mean_x, groups)
    for k, g in enumerate(groups):
        columns = mean_x[g].T  # (n_in, experiments)
        condition = conditions[k]
        if not condition < MAX_CONDITION:
            raise SingularInputError(
                f"{where}: the {path[0]} matrix at {omega[g[0]] / 2 / np.pi:.4g} Hz is singular (condition number "
                f"{condition:.2g}); excite the axes one at a time, or with independent phases, at this frequency"
            )
        inverse = np.linalg.inv(columns) if len(g) == n_in else np.linalg.pinv(columns)
        inverses.append(inverse)
        value[k] = mean_z[g].T @ inverse
        gain[g] = np.einsum("yx,pbx->pby", value[k], x[g])
    used = np.concatenate(groups)
    noise = block_noise((z - gain)[used], omega[used], correlated=False, magnitude=np.abs(gain[used].mean(axis=1)))
    variance = np.zeros((len(omega), z.shape[2]))
    variance[used] = np.asarray(noise.sigma) ** 2
    if more is not None:
        variance += more
    std = np.empty(value.shape)
    for k, g in enumerate(groups):
        std[k] = np.sqrt(variance[g].T @ np.abs(inverses[k]) ** 2)
    return FrequencyResponse(np.array([omega[g].mean() for g in groups]), value, std)


def _conditions(mean_x: Complex, groups: list[NDArray[np.int64]]) -> Real:
    """Condition number of each frequency's input matrix."""
    width = max(len(g) for g in groups)  # more experiments than inputs are welcome
    stacked = np.zeros((len(groups), mean_x.shape[1], width), dtype=complex)
    for k, g in enumerate(groups):
        stacked[k, :, : len(g)] = mean_x[g].T
    singular = np.linalg.svd(stacked, compute_uv=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(singular[:, 0] / singular[:, -1], nan=np.inf, posinf=np.inf))
