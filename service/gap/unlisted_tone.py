"""A tone in the scatter of displacements at a frequency that no interference of the catalogue has.

A machine nearby shakes the base, or a converter hums, at any frequency. It is searched for at all of them, by its phase
from block to block as in `measured.coherent`. Noise has a share x of its scatter in such a pattern that has a beta
distribution (1, d - 1), so that -(d - 1) log(1 - x), summed over K cells, has a gamma distribution (K).

A resonance that rings, or that noise drives, has a frequency of its own, too. But a tone does not care for what is
excited: its amplitude is the same in every point, its blocks are alike, and it is heard in the other sweep as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from service.experiment.data import Sweep
from service.gap.interference import Interference, at_speed, once_a_turn_hz, quiet_cells
from service.gap.measured.coherent import LEAST_ADVANCE_RAD, MAIN_LOBE, OWN_SHARE, beside_hum, resolution_hz
from service.gap.measured.estimate import Estimate, plain_mean
from service.gap.measured.observation import usable
from sim.rig import Rig

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAINS_HZ = (50.0, 60.0)
"""Mains, whose multiples are no unlisted tone."""
FALSE_ALARM = 1e-9
"""Probability, of all frequencies together, at which noise would make a tone: that of six deviates."""
ALSO_HEARD = 1e-3
"""That at which it is heard in the other sweep at its one frequency."""
FEWEST_LINES = 3
"""Lines that must come near a tone: phases of one or two fit other frequencies, too, to which a resonance leaks."""
BY_CHANCE_ALIKE = 1e-4
"""Probability at which amplitudes of noise that a resonance makes narrow are as much alike in all points of both sweeps
as those of a tone. A resonance that rings has amplitudes of what is excited, and is less alike yet."""
LEAKS = 8.0
"""Distance from a tone, in resolutions of a block, up to which a strong one is searched by its leakage: lines are far
apart at low frequencies."""
ALSO_TURNS = 0.5
"""Log probability, relative to the least one, up to which a frequency's phases may be those of the same leakage."""
FALLS_ALIKE = 0.95
"""Share of the leakage that must fall off as a tone's does."""
STRONG = 0.5
"""Distance from a tone, in resolutions of a block, up to which its leakage is strong and tells its amplitude."""
FEWEST_BLOCKS = 4
"""Blocks of a point from which noise and a tone are distinguished."""
FINER = 60
"""Frequencies that are tried within a resolution, once a tone is heard there."""
COARSE = 3
"""Frequencies that are searched within a resolution."""


@dataclass(frozen=True)
class Tone:
    """An unlisted tone."""

    frequency_hz: float
    amplitude_m: Real
    """(n,) of each axis"""

    def in_words(self, axes: Sequence[str]) -> str:
        """Frequency and size."""
        k = int(np.argmax(self.amplitude_m))
        size = 1e6 * self.amplitude_m[k]
        return (
            f"a tone of {size:.2g} um in {axes[k]} at {self.frequency_hz:.4g} Hz is heard in the displacements, "
            "whatever is excited, at no multiple of the mains or of the speed: look for a machine that shakes the base"
        )


def unlisted_tone(sources: Sequence[Interference], main: Sweep, other: Sweep, rig: Rig) -> Tone | None:
    """The tone that both sweeps' displacements show beside the ``sources``, or None.

    ``other`` has to show it where its lines come near enough.
    """
    main, other = usable(main), usable(other)
    if not _in_blocks(main):
        return None
    here = _Heard.of(main, rig, at_speed(sources, main.speed_rad_s))
    there = _Heard.of(other, rig, at_speed(sources, other.speed_rad_s)) if _in_blocks(other) else None
    step = resolution_hz(main) / COARSE
    searched = np.arange(resolution_hz(main), here.at_hz.max(initial=0.0), step)
    if not len(searched):
        return None
    listed = _listed(searched, sources, (main, other), resolution_hz(main))
    far = here.log_chance(searched, LEAKS)
    return _near_lines(here, there, searched, listed, far) or _by_leakage(here, there, searched, listed, far)


def _in_blocks(sweep: Sweep) -> bool:
    return sweep.in_sequence and sweep.block_samples is not None and sweep.Y.shape[1] >= FEWEST_BLOCKS


def _near_lines(here: _Heard, there: _Heard | None, searched: Real, listed: Mask, far: Real) -> Tone | None:
    """A tone that lines come near to. Its power tells it from a resonance; ``far`` its leakage from a listed tone's."""
    chance = np.where(listed, 0.0, here.log_chance(searched))
    best = int(np.argmin(chance))
    if chance[best] + np.log(len(searched)) > np.log(FALSE_ALARM):
        return None
    leaking = listed & (np.abs(searched - searched[best]) < LEAKS * searched[0])  # which is a block's resolution
    if far[leaking].min(initial=0.0) < far[best]:  # whose leakage turns alike at whole turns a block from it
        return None
    finer = _about(searched, best)
    hz = float(finer[np.argmin(here.log_chance(finer))])
    powers = [here.powers(hz)]
    if there is not None:
        if there.lines_near(hz) and there.log_chance(np.array([hz]))[0] > np.log(ALSO_HEARD):
            return None
        powers.append(there.powers(hz))
    power = np.concatenate(powers)
    return Tone(hz, np.sqrt(power.mean(axis=0))) if _alike(power.sum(axis=1)) else None


def _by_leakage(here: _Heard, there: _Heard | None, searched: Real, listed: Mask, far: Real) -> Tone | None:
    """A loud tone that no lines come near to: at low frequencies they are far apart, and blocks are long.

    Its leakage turns alike at frequencies that are whole turns a block apart, but how it falls off with the distance is
    that of one alone; and that of a resonance also differs with what is excited.
    """
    best = int(np.argmin(far))
    if far[best] + np.log(len(searched)) > np.log(FALSE_ALARM):
        return None
    turning = np.flatnonzero(far < ALSO_TURNS * far[best])
    place = int(max(turning, key=lambda k: here.fall(float(searched[k]))[0]))
    if listed[place]:
        return None
    finer = _about(searched, place)
    hz = float(finer[np.argmin(here.log_chance(finer, LEAKS))])
    falls = [heard.fall(hz) for heard in (here, there) if heard is not None]
    alike = all(share > FALLS_ALIKE for share, _ in falls)
    return Tone(hz, np.mean([amplitude for _, amplitude in falls], axis=0)) if alike else None


def _about(searched: Real, k: int) -> Real:
    """Finer frequencies about one that was searched."""
    step = searched[1] - searched[0] if len(searched) > 1 else 0.0
    return np.asarray(searched[k] + step * np.linspace(-1, 1, 2 * FINER // COARSE + 1))


def _alike(power: Real) -> bool:
    """Whether powers (K,) are more alike than noise's, which have an exponential distribution: Bartlett's test."""
    count = len(power)
    if count < 2:
        return False
    unlike = 2 * count * (np.log(power.mean()) - np.log(power).mean()) / (1 + (count + 1) / (6 * count))
    return bool(gammainc((count - 1) / 2, unlike / 2) < BY_CHANCE_ALIKE)


def _listed(hz: Real, sources: Sequence[Interference], sweeps: Sequence[Sweep], resolution: float) -> Mask:
    """Which frequencies are multiples of the mains, of a sweep's speed or of a source, (F,)."""
    known = {*MAINS_HZ, *(once_a_turn_hz(s.speed_rad_s) for s in sweeps if s.speed_rad_s)}
    known |= {s.frequency_hz for s in sources}
    out = np.zeros(len(hz), dtype=bool)
    for f in known:
        out |= np.abs(hz - f * np.maximum(np.round(hz / f), 1)) < resolution
    return out


@dataclass(frozen=True)
class _Heard:
    """Cells (a harmonic of a point) whose scatter may show a tone, C of them."""

    at_hz: Real
    """(C,)"""
    block_s: Real
    """(C,)"""
    scatter: NDArray[np.complex128]
    """(C, B, n) deviations of the displacements from their estimate"""
    by: Estimate
    """of the cells"""

    @classmethod
    def of(cls, sweep: Sweep, rig: Rig, sources: Sequence[Interference]) -> _Heard:
        """The cells of a sweep, without its loudest source and where that can be taken off."""
        points, blocks = sweep.Y.shape[:2]
        by = beside_hum(sweep, sources[0].frequency_hz) if sources else plain_mean(points, blocks)
        cells = quiet_cells(sweep, rig)
        if sources:
            cells &= ((by.dof > 1) & (by.dof < blocks - 1))[:, None]
        p, h = np.nonzero(cells)
        assert sweep.block_samples is not None
        scatter = np.einsum("kbc,kcn->kbn", by.residual_map[p], sweep.Y[p, :, h])
        at = sweep.frequency_hz[p] * np.array(sweep.harmonics)[h]
        return cls(at, sweep.block_samples[p] / sweep.sample_rate_hz, scatter, by.select(p))

    def _near(self, hz: Real, lobes: float = MAIN_LOBE) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of frequencies and cells that are near and turn enough from block to block: indices of each."""
        reach = lobes / self.block_s
        low, high = np.searchsorted(hz, self.at_hz - reach), np.searchsorted(hz, self.at_hz + reach)
        count = high - low
        cell = np.repeat(np.arange(len(count)), count)
        f = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - low, count)
        advance = 2 * np.pi * hz[f] * self.block_s[cell]
        turns = np.abs((advance + np.pi) % (2 * np.pi) - np.pi) > LEAST_ADVANCE_RAD
        return f[turns], cell[turns]

    def _along(self, hz: Real, cell: NDArray[np.int64]) -> tuple[NDArray[np.complex128], Real, Real]:
        """Amplitude (K, n) of the tone in cells, its share (K,) of their scatter, and the size (K,) of its pattern."""
        blocks = self.scatter.shape[1]
        turning = np.exp(2j * np.pi * (hz * self.block_s[cell])[:, None] * np.arange(blocks))
        pattern = np.einsum("kbc,kc->kb", self.by.residual_map[cell], turning)
        size = (np.abs(pattern) ** 2).sum(axis=1)
        along = np.einsum("kb,kbn->kn", pattern.conj(), self.scatter[cell]) / np.maximum(size, 1e-12)[:, None]
        whole = (np.abs(self.scatter[cell]) ** 2).sum(axis=(1, 2))
        share = (np.abs(along) ** 2).sum(axis=1) * size / np.maximum(whole, 1e-300)
        return along, np.clip(share, 0.0, 1 - 1e-12), size

    def log_chance(self, hz: Real, lobes: float = MAIN_LOBE) -> Real:
        """Log probability (F,), at most, of noise to have as much of a tone at the frequencies (F,), which ascend.

        In cells up to so many ``lobes``, resolutions of a block, from a frequency.
        By Chernoff's bound of a gamma distribution, as the probability itself may be smaller than a number can be.
        """
        f, cell = self._near(hz, lobes)
        _, share, size = self._along(hz[f], cell)
        own = size > OWN_SHARE * self.scatter.shape[1]
        f, cell, share = f[own], cell[own], share[own]
        total = np.bincount(f, -(self.by.dof[cell] - 1) * np.log1p(-share), len(hz))
        count = np.bincount(f, None, len(hz))
        per_cell = np.maximum(total / np.maximum(count, 1), 1.0)
        lines = np.unique(np.stack([f, np.unique(self.at_hz, return_inverse=True)[1][cell]]), axis=1)
        enough = np.bincount(lines[0], None, len(hz)) >= FEWEST_LINES
        return np.where(enough, count * (1 - per_cell + np.log(per_cell)), 0.0)

    def lines_near(self, hz: float) -> bool:
        """Whether enough lines come near a frequency for `log_chance`."""
        _, cell = self._near(np.array([hz]))
        return len(np.unique(self.at_hz[cell])) >= FEWEST_LINES

    def fall(self, hz: float) -> tuple[float, Real]:
        """How much of a tone's leakage into all cells that it reaches falls off with the distance as a tone's does.

        With its amplitude (n,). Blocks are not windowed: a tone d resolutions from a cell leaks to it by sinc(d).
        """
        _, cell = self._near(np.array([hz]), LEAKS)
        along, _, _ = self._along(np.full(len(cell), hz), cell)
        leak = np.abs(np.sinc((self.at_hz[cell] - hz) * self.block_s[cell]))
        amplitude = (np.abs(along) * leak[:, None]).sum(axis=0) / max((leak**2).sum(), 1e-12)
        whole = float((np.abs(along) ** 2).sum())
        return float((amplitude**2).sum() * (leak**2).sum()) / max(whole, 1e-300), amplitude

    def powers(self, hz: float) -> Real:
        """Squared amplitudes (K, n) of a tone at a frequency in all cells that it leaks strongly to, noise included."""
        _, cell = self._near(np.array([hz]))
        distance = np.abs(self.at_hz[cell] - hz) * self.block_s[cell]
        cell, distance = cell[distance < STRONG], distance[distance < STRONG]
        along, _, _ = self._along(np.full(len(cell), hz), cell)
        return np.asarray((np.abs(along) / np.sinc(distance)[:, None]) ** 2)
