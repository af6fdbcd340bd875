"""What a pilot tells of a rig's model, and which lines and amplitudes of the main multisine follow from that. Pure.

The pilot is small, but all axes are in it for seconds: a joint fit has ki and ks to parts in a thousand and every peak
to a tenth of its width. That is enough to know where information is to be had (`identification.input_design`): on
the peaks, whose lines hardly move a rotor in its loop, and where a magnet's stiffness shows. A part of the power stays
with the profile that needs no model, so that lines everywhere tell what a model lacks. A pilot whose model
does not explain it leaves all of it there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.experiment.speeds import at_standstill
from service.identification.input_design import ClosedLoop, best_powers, closed_loop, line_information
from service.identification.joint.refine import Refined
from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.measured.points import PlanePoints, planes_of
from service.identification.plane.model import PlaneModel
from service.identification.plane_fit import fit_plane
from service.identification.statistics.least_squares import covariance_of
from sim.datasheet import Datasheet
from sim.errors import AmbError

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

FLOOR = 0.3
"""Share of the power that stays with the profile that needs no model."""
AGREES = 0.1
"""Misfit of the closed loop, relative, above which a model does not explain the pilot."""
BESIDE = 0.2
"""Error of a peak's place to be prepared for, in its half-widths; three standard deviations where that is more."""
AROUND = 3.0
"""Distance from a peak, in its half-widths, within which every line is played."""
LEFT = 0.01
"""Of the slowest oscillation of the loop, when a sweep has settled. What is less shows in no change from one period to
the next, and biases a damping ratio all the same: with a tenth of it left by one standard deviation."""
NARROW = 0.01
"""Of a peak's frequency: the most of that distance."""
DIGITS = 3
"""Of amplitudes: another machine's last digits ask no other questions."""


@dataclass(frozen=True)
class PlaneDesign:
    """A plane as the pilot knows it."""

    pair: tuple[int, int]
    models: tuple[PlaneModel, ...]
    """As fitted, and with the peaks to either side."""
    omega: Real
    """(P,) rad/s of the pilot's lines, rising, and (P, 4) the variance there of i and y in one second."""
    variance: Real


@dataclass(frozen=True)
class Design:
    """All planes as the pilot knows them."""

    planes: tuple[PlaneDesign, ...]
    controller: tuple[Real, Real]

    def peaks_hz(self) -> list[tuple[float, float]]:
        """(from, to) round every peak, Hz."""
        found = []
        for plane in self.planes:
            beside = np.abs(plane.models[1].modes[:, 0] - plane.models[0].modes[:, 0])
            for (nu, sigma), error in zip(plane.models[0].modes[:, :2], beside, strict=True):
                reach = min(AROUND * abs(sigma) + error, NARROW * nu)
                found.append(((nu - reach) / (2 * np.pi), (nu + reach) / (2 * np.pi)))
        return found

    def settle_s(self) -> float:
        """Time in which the loop's slowest oscillation falls to `LEFT`, s; inf where it would not, by the model."""
        slowest = np.inf
        for plane in self.planes:
            z = closed_loop_poles(plane.models[0], self.controller)
            swinging = np.abs(z[z.imag > 0])
            slowest = min(slowest, float(-np.log(swinging.max()) / plane.models[0].known.sample_time_s))
        return float(np.log(1 / LEFT) / slowest) if slowest > 0 else np.inf

    def responses(self, frequency_hz: Real, measured: dict[str, Complex]) -> dict[str, Complex]:
        """(L, n, n) of "u", "i", "y" as modelled within each plane, and as measured between planes."""
        out = {s: v.copy() for s, v in measured.items()}
        for plane in self.planes:
            loop = closed_loop(plane.models[0], self.controller, 2 * np.pi * frequency_hz)
            for s in out:
                place = slice(plane.pair[0], plane.pair[1] + 1)
                out[s][:, place, place] = getattr(loop, s)
        return out

    def amplitudes(self, frequency_hz: Real, usual: Real, displacement: float, current: float, top: float) -> Real:
        """Relative amplitudes of the lines, (L, n).

        Parameters
        ----------
        usual
            (L, n) those that need no model.
        displacement, current, top
            Limits of y, of i and of r, in any proportion to those of their root mean squares.
        """
        out = np.array(usual, dtype=float)
        omega = 2 * np.pi * frequency_hz
        for plane in self.planes:
            pair = list(plane.pair)
            loop = closed_loop(plane.models[0], self.controller, omega)
            own = np.broadcast_to(np.eye(2), loop.y.shape)
            use = np.concatenate(
                [np.abs(x) ** 2 / limit**2 for x, limit in ((loop.y, displacement), (loop.i, current), (own, top))],
                axis=1,
            )
            variance = np.stack([np.interp(omega, plane.omega, v) for v in plane.variance.T], axis=1)
            known = [line_information(m, self.controller, omega, variance, float(omega.max())) for m in plane.models]
            flat = out[:, pair] ** 2
            flat = flat / np.max(np.einsum("lsj,lj->s", use, flat))
            power = (1 - FLOOR) * best_powers(known, use) + FLOOR * flat
            out[:, pair] = np.sqrt(power)
        return _rounded(out)


def _rounded(amplitudes: Real) -> Real:
    digits = 10.0 ** (DIGITS - 1 - np.floor(np.log10(np.maximum(amplitudes, 1e-300))))
    return np.asarray(np.round(amplitudes * digits) / digits)


def design_of(
    pilot: Sweep, datasheet: Datasheet, to_hz: float, say: Callable[[str], None] = lambda _: None
) -> Design | None:
    """Model of every plane from the pilot, or None where one cannot be had, or does not explain the pilot.

    Parameters
    ----------
    pilot
        All axes at once; its lines above ``to_hz`` help with the amplifiers.
    say
        Told why there is none.
    """
    axes, controller = tuple(datasheet.axes), (np.array(datasheet.numerator), np.array(datasheet.denominator))
    if not at_standstill(pilot.speed_rad_s):
        say("at speed, planes are coupled")
        return None
    low, high = (pilot.select(k) for k in (pilot.frequency_hz <= to_hz, pilot.frequency_hz > to_hz))
    planes = []
    for plane, pair in planes_of(axes).items():
        try:
            found = fit_plane(low, high if high.n_points else None, None, axes, plane, datasheet)
        except (AmbError, np.linalg.LinAlgError) as error:
            say(f"plane {plane}: {error}")
            return None
        refined = found.selected.refined
        misfit = _misfit(closed_loop(refined.model, controller, refined.points.omega), refined.points)
        if refined.relative or misfit > AGREES:
            say(f"plane {plane}: the model leaves {100 * misfit:.2g} % of the pilot")
            return None
        block_s = float(np.median(low.block_samples)) / low.sample_rate_hz if low.block_samples is not None else 1.0
        seconds = block_s * refined.points.n_blocks * len(axes)
        std = np.sqrt(np.diag(covariance_of(refined.fit.jacobian)))
        planes.append(
            PlaneDesign(
                pair,
                tuple(_beside(refined, std, k) for k in (0.0, 1.0, -1.0)),
                refined.points.omega,
                np.einsum("pcc->pc", refined.noise.covariance).real * seconds,
            )
        )
    return Design(tuple(planes), controller)


def _misfit(loop: ClosedLoop, points: PlanePoints) -> float:
    """Of currents and displacements per excitation, relative, beyond what blocks scatter by; the larger one."""
    at, r = np.arange(len(points.omega)), points.r[np.arange(len(points.omega)), points.axis]
    pairs = [(loop.y, points.Y)] + ([] if points.I is None else [(loop.i, points.I)])
    ratios = []
    for modelled, blocks in pairs:
        measured, count = blocks.mean(axis=1), blocks.shape[1]
        wanted = modelled[at, :, points.axis] * r[:, None]
        chance = np.sum(np.abs(blocks - measured[:, None]) ** 2) / (count * (count - 1))
        left, whole = np.sum(np.abs(measured - wanted) ** 2) - chance, np.sum(np.abs(measured) ** 2) - chance
        ratios.append(float(np.sqrt(max(left, 0.0) / whole)) if whole > 0 else np.inf)
    return max(ratios)


def _beside(refined: Refined, std: Real, side: float) -> PlaneModel:
    """The model with all peaks to one side, by as much as the pilot may have misplaced them."""
    model, theta = refined.model, refined.model.theta.copy()
    for k in range(model.layout.n_modes):
        place = model.layout.mode(k).start
        error = 3 * std[np.searchsorted(np.flatnonzero(refined.fit.free), place)]
        theta[place] += side * max(error, BESIDE * abs(theta[place + 1]))
    return model.at(theta)
