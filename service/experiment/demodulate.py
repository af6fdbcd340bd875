"""Records to complex amplitudes: blocks of whole periods, harmonics 0 to 3, by least squares in every block.

Where a block holds a whole number of periods and of samples the fit is the discrete Fourier transform's line;
where it does not, the least squares fit of all harmonics together has no leakage between them either. The time
origin is moved so that the excitation at harmonic 1 is real and positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

HARMONICS = (0, 1, 2, 3)
ROUNDING = 1e-9
"""Phase, rad, that is left as it is, so that what was written is read back unchanged."""
BLOCKS = 6
"""Blocks of a point whose record does not say how many it holds; fewer where there are fewer periods."""


@dataclass(frozen=True)
class BlockPlan:
    """How a record is cut: ``blocks`` blocks of ``samples`` samples, the last one at the end of the record."""

    start: int
    """First sample used; what comes before does not fill a block."""
    samples: int
    blocks: int


def block_plan(n_samples: int, periods_per_sample: float, blocks: int) -> BlockPlan:
    """Cut of a record of ``n_samples`` into ``blocks`` blocks of as many whole periods as fit.

    Parameters
    ----------
    n_samples
        Length of the record.
    periods_per_sample
        Frequency divided by the sample rate.
    blocks
        Wanted number of blocks; the caller makes sure that each can hold one period.

    >>> block_plan(1030, 0.01, 5)
    BlockPlan(start=30, samples=200, blocks=5)
    """
    # the small number forgives rounding in a frequency that was stored as periods * rate / samples
    periods = max(1, int(np.floor(n_samples * periods_per_sample / blocks + 1e-6)))
    samples = min(round(periods / periods_per_sample), n_samples // blocks)
    return BlockPlan(n_samples - samples * blocks, samples, blocks)


def whole_periods(n_samples: int, periods_per_sample: float) -> int:
    """Number of whole periods in a record."""
    return int(np.floor(n_samples * periods_per_sample + 1e-6))


def amplitudes(signals: Real, plan: BlockPlan, periods_per_sample: float, harmonics: tuple[int, ...]) -> Complex:
    """Complex amplitudes of every block by least squares, phase against the first sample of the record.

    Parameters
    ----------
    signals
        (N, n) records.
    plan
        Cut of the record.
    periods_per_sample
        Frequency divided by the sample rate.
    harmonics
        Harmonics wanted. All are fitted together with the constant. One at or above the Nyquist frequency
        cannot be told from a lower one and is returned as zero.

    Returns
    -------
    amplitudes
        (blocks, H, n), x(t) = Re(X exp(j h w t)).
    """
    seen = [h for h in harmonics if h > 0 and h * periods_per_sample < 0.5 * (1 - 1e-9)]
    k = np.arange(plan.samples)
    angle = 2 * np.pi * periods_per_sample * np.multiply.outer(k, np.array(seen, dtype=float))
    basis = np.concatenate([np.ones((plan.samples, 1)), np.cos(angle), np.sin(angle)], axis=1)
    n = signals.shape[1]
    blocks = signals[plan.start : plan.start + plan.samples * plan.blocks].reshape(plan.blocks, plan.samples, n)
    stacked = blocks.transpose(1, 0, 2).reshape(plan.samples, -1)
    fitted = np.linalg.solve(basis.T @ basis, basis.T @ stacked).reshape(-1, plan.blocks, n)
    start = plan.start + plan.samples * np.arange(plan.blocks)
    out = np.zeros((plan.blocks, len(harmonics), n), dtype=np.complex128)
    for position, h in enumerate(harmonics):
        if h == 0:
            out[:, position] = fitted[0]
        elif h in seen:
            j = seen.index(h)
            value = fitted[1 + j] - 1j * fitted[1 + len(seen) + j]
            out[:, position] = value * np.exp(-2j * np.pi * h * periods_per_sample * start)[:, None]
    return out


def time_origin(R: Complex, harmonics: tuple[int, ...], axis: int) -> Complex:
    """Factor (..., H, 1) that makes R at harmonic 1 of the excited axis real and positive in every block.

    R has shape (..., H, n_axes). Where R is zero or real but for rounding, or harmonic 1 was not measured, the factor
    is one.
    """
    shape = (*R.shape[:-1], 1)
    if 1 not in harmonics:
        return np.ones(shape, dtype=np.complex128)
    first = R[..., harmonics.index(1), axis]
    phase = np.angle(first)
    phase = np.where(np.abs(phase) < ROUNDING, 0.0, phase)
    factor: Complex = np.exp(-1j * phase[..., None] * np.array(harmonics, dtype=float))
    return factor[..., None]


def demodulate(
    records: dict[str, Real],
    frequency_hz: float,
    sample_rate_hz: float,
    axis: int,
    blocks: int = BLOCKS,
    harmonics: tuple[int, ...] = HARMONICS,
) -> dict[str, Complex]:
    """One point's records r, u, i, y as complex amplitudes of whole-period blocks.

    Parameters
    ----------
    records
        (N, n_axes) each; must hold "r".
    frequency_hz, sample_rate_hz
        Excited frequency and sample rate.
    axis
        Excited axis: its R at harmonic 1 becomes real and positive.
    blocks
        Number of blocks.
    harmonics
        Harmonics wanted.

    Returns
    -------
    amplitudes
        For every record, (blocks, H, n_axes).

    Raises
    ------
    ValueError
        The record holds fewer whole periods than blocks, or too few samples.
    """
    ratio = frequency_hz / sample_rate_hz
    n_samples = len(records["r"])
    if whole_periods(n_samples, ratio) < blocks:
        raise ValueError(f"{n_samples} samples hold fewer than {blocks} periods of {frequency_hz:g} Hz")
    plan = block_plan(n_samples, ratio, blocks)
    if plan.samples < 2 * len(harmonics) + 1:
        raise ValueError(f"a block of {plan.samples} samples is too short to tell {len(harmonics)} harmonics apart")
    names = list(records)
    n_axes = records["r"].shape[1]
    stacked = amplitudes(np.concatenate([records[k] for k in names], axis=1), plan, ratio, harmonics)
    out = {k: stacked[:, :, j * n_axes : (j + 1) * n_axes] for j, k in enumerate(names)}
    origin = time_origin(out["r"], harmonics, axis)
    return {k: v * origin for k, v in out.items()}
