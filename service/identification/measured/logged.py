"""Whether the log holds the control signal that the controller computed: u = r - C y, to the last digit.

Whatever rotor and amplifiers are, a digital controller computes u from r and y. A log that is some samples off, a block
with lost or wrong samples and a controller that is not the datasheet's all show in u - r + C y, where next to no noise
is (Ljung, System Identification, 2nd ed., Prentice Hall 1999, chapter 14, on preprocessing of data). The first two are
mended before anything is fitted, all three are told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Experiment, Sweep
from service.identification.arrays import Complex, Real
from service.identification.plane.zoh import discrete_response
from sim.chain import Chain
from sim.datasheet import Datasheet

OFFSETS = range(-3, 4)
"""Samples by which a log may be off: the range of the effect `logging_offset`."""
CURED = 0.2
"""Share of u - r + C y that may be left once the log is moved: no other controller is a pure delay so nearly."""
DIFFERS = 0.01
"""Share of u from which u - r + C y is worth a word: predicted loop and margins are then off by as much."""
BEYOND_NOISE = 5.0
"""And how many times the noise of its mean it must be."""
SPOILT = 3.0
"""Times that of the blocks before it, from which u - r + C y of a block is no chance: the median over the points, each
of which is compared with itself, so that sixteen are enough."""
WORTH = 5e-4
"""Share of u below which u - r + C y of a block does no harm."""
BLOCKS_LEFT = 3
"""Blocks without which there is no noise estimate."""


@dataclass(frozen=True)
class Checked:
    """An experiment whose control signals were compared with the controller's."""

    experiment: Experiment
    chain: Chain
    """With the offset of the log, so that `known.led_back` moves u to where it belongs."""
    warnings: tuple[str, ...]
    controller_differs: bool = False
    """Whether u is not r - C y with the datasheet's controller C, once it is moved."""


def checked(experiment: Experiment, datasheet: Datasheet, chain: Chain) -> Checked:
    """The experiment without blocks that the log has spoilt, and by how many samples its u is off.

    Parameters
    ----------
    experiment
        As logged; what excites nothing is left alone.
    datasheet
        Of the same axes; its controller counts.
    chain
        What is known of the axes; its offset of the log is the one that is expected.
    """
    law = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    sample_time_s = datasheet.sample_time_s
    found = [_Difference.of(s, law, sample_time_s) for s in experiment.sweeps]
    seen = [d for d in found if d is not None]
    if not seen:
        return Checked(experiment, chain, ())
    offset, warnings = _offset(seen, chain.logging_offset_samples)
    sweeps = list(experiment.sweeps)
    for k, difference in enumerate(found):
        if difference is None or sweeps[k].kind != "stepped-sine":
            continue
        spoilt = _spoilt(difference, offset)
        if len(spoilt):
            sweeps[k], sentence = _without(sweeps[k], spoilt)
            warnings.append(f"sweeps/{k}: {sentence}")
    other = _other_controller(seen, offset, experiment.axes)
    chain = replace(chain, logging_offset_samples=offset)
    return Checked(replace(experiment, sweeps=tuple(sweeps)), chain, (*warnings, *other), bool(other))


@dataclass(frozen=True)
class _Difference:
    """u and r - C y of the excited axes at the excited lines."""

    axis: NDArray[np.int64]
    """(P,)"""
    turn: Complex
    """(P,) what a delay of one sample does."""
    u: Complex
    """(P, B) A, as logged."""
    r: Complex
    """(P, B) A."""
    fed_back: Complex
    """(P, B) A, C y."""

    @classmethod
    def of(cls, sweep: Sweep, law: tuple[Real, Real], sample_time_s: float) -> _Difference | None:
        """Of a sweep; None where it has nothing to compare."""
        if sweep.kind == "noise" or 1 not in sweep.harmonics:
            return None
        points = np.arange(sweep.n_points)
        r, u, y = (x[points, :, sweep.harmonic(1), sweep.axis].astype(complex) for x in (sweep.R, sweep.U, sweep.Y))
        usable = (sweep.amplitude_a > 0) & (sweep.frequency_hz > 0) & np.isfinite(r + u + y).all(axis=1)
        usable &= np.abs(u).min(axis=1, initial=np.inf) > 0
        if not np.any(usable):
            return None
        omega = 2 * np.pi * np.asarray(sweep.frequency_hz, dtype=float)[usable]
        c = discrete_response(*law, omega, sample_time_s)[:, None]
        turn = np.exp(-1j * omega * sample_time_s)
        return cls(np.asarray(sweep.axis)[usable], turn, u[usable], r[usable], c * y[usable])

    def at(self, offset_samples: float, turned: str = "") -> Complex:
        """u - r + C y, (P, B) A, of a u that was logged so many samples early, and a signal ``turned`` in sign."""
        u, r, fed_back = ((-1 if turned == name else 1) * x for name, x in zip("ury", self._signals, strict=True))
        return np.asarray(u * self.turn[:, None] ** offset_samples - (r - fed_back))

    def share(self, offset_samples: float, turned: str = "") -> Real:
        """Its mean over the blocks, as a share of u, (P,)."""
        return np.asarray(np.abs(self.at(offset_samples, turned).mean(axis=1)) / np.abs(self.u.mean(axis=1)))

    @property
    def _signals(self) -> tuple[Complex, Complex, Complex]:
        return self.u, self.r, self.fed_back


def _offset(seen: Sequence[_Difference], expected: float) -> tuple[float, list[str]]:
    """By how many samples u is early, and what there is to say of it."""

    def size(offset: float) -> float:
        return float(np.median(np.concatenate([d.share(offset) for d in seen])))

    best = min(OFFSETS, key=size)
    if best == expected or size(best) > CURED * size(expected):
        return expected, []
    n = abs(best)
    where = f"{n} sample{'s' if n > 1 else ''} {'early' if best > 0 else 'late'}"
    said = (
        f"u is logged {where} of r and y: u - r + C y, with the datasheet's controller C, falls from "
        f"{100 * size(expected):.2g} % of u to {100 * size(best):.2g} % when it is moved, and for the fit it was; "
        f"mend the log, or name logging_offset with samples = {best} in the twin"
    )
    return float(best), [said]


def _spoilt(difference: _Difference, offset: float) -> NDArray[np.int64]:
    """Blocks whose control signal is further from the controller's than in every block before.

    What rings, and what it leaves at the ends of blocks, decays from block to block: a later block is no worse for it.
    """
    share = np.abs(difference.at(offset)) / np.abs(difference.u)
    before, spoilt = share[:, 0], []
    for k, here in enumerate(share.T[1:], start=1):  # each point beside itself: their noise differs by far more
        if np.median(here) > WORTH and np.median(here / np.maximum(before, 1e-300)) > SPOILT:
            spoilt.append(k)
        else:
            before = np.maximum(before, here)
    return np.array(spoilt, dtype=np.int64)


def _without(sweep: Sweep, spoilt: NDArray[np.int64]) -> tuple[Sweep, str]:
    """The sweep without some blocks, where enough are left, and what is said of it."""
    n = sweep.U.shape[1]
    which = f"block {spoilt[0] + 1}" if len(spoilt) == 1 else f"blocks {', '.join(str(k + 1) for k in spoilt)}"
    seen = f"u of {which} of {n} is not r - C y, as it is in the blocks before: samples were lost"
    if n - len(spoilt) < BLOCKS_LEFT:
        return sweep, f"{seen}; measure again"
    keep = np.setdiff1d(np.arange(n), spoilt)
    current = None if sweep.I is None else sweep.I[:, keep]
    left = replace(sweep, R=sweep.R[:, keep], U=sweep.U[:, keep], I=current, Y=sweep.Y[:, keep])
    return left, f"{seen}; {'it is' if len(spoilt) == 1 else 'they are'} left out"


def _other_controller(seen: Sequence[_Difference], offset: float, axes: tuple[str, ...]) -> list[str]:
    """Axes whose u is not that of the datasheet's controller, and those with a signal of the wrong sign, in words."""
    differing: list[str] = []
    turned: dict[str, list[str]] = {}
    for place, name in enumerate(axes):
        of_axis = [(d, d.axis == place) for d in seen if np.any(d.axis == place)]
        if not of_axis:
            continue
        share = np.concatenate([d.share(offset)[at] for d, at in of_axis])
        noise = np.concatenate([_noise(d, offset)[at] for d, at in of_axis])
        if np.median(share) > DIFFERS and np.median(share / np.maximum(noise, 1e-300)) > BEYOND_NOISE:
            left = {x: np.median(np.concatenate([d.share(offset, x)[at] for d, at in of_axis])) for x in "ury"}
            signal = min(left, key=lambda x: left[x])
            if left[signal] < CURED * np.median(share):
                turned.setdefault(signal, []).append(name)
            else:
                differing.append(f"{name} ({100 * np.median(share):.2g} % of u)")
    said = [
        f"{signal} of {', '.join(names)} is logged with the opposite sign of what the controller had: with {signal} "
        "turned, u is r - C y; turn it in the log, or everything that is found is of another rig"
        for signal, names in turned.items()
    ]
    if not differing:
        return said
    where = ", ".join(differing)
    return [
        *said,
        f"u is not r - C y, C being the datasheet's controller, on {where}: either another one ran, and the predicted "
        "loop, its margins and damping are off (give the one that ran), or u, r or y are not logged as it had them, "
        "and the plant is off too (ambit gap diagnose)",
    ]


def _noise(difference: _Difference, offset: float) -> Real:
    """Standard deviation of `_Difference.share` by the scatter of the blocks, (P,)."""
    e = difference.at(offset)
    scatter = np.sqrt(np.sum(np.abs(e - e.mean(axis=1, keepdims=True)) ** 2, axis=1) / max(e.shape[1] - 1, 1))
    return np.asarray(scatter / np.sqrt(e.shape[1]) / np.abs(difference.u.mean(axis=1)))
