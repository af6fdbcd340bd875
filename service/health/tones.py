"""Which few tones tell most of a rig's health: frequencies chosen for the Fisher information that they carry.

The campaign gives every tone the same relative accuracy, so what a frequency tells of a figure follows from the
commissioned model alone: the exact Jacobian of its currents and displacements at the excitation that the closed loop
lets through. Frequencies are picked one by one so that the product of the figures' variances falls fastest per second
of rig time, every other parameter of the plane being unknown too (Ds-optimality: Atkinson, Donev, Tobias, Optimum
Experimental Designs, with SAS, 2007, section 10.3; greedy choice and exchange: Fedorov 1972). A rig that has changed
is the one that matters, so the information is averaged over rigs whose modes have moved and whose damping differs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.campaign.aims import Profile
from service.campaign.frequencies import CLEARANCE_HZ, DIGITS, grid, mains_harmonics, off_lines
from service.errors import JobError
from service.health import budget
from service.health.monitored import plane_figures
from service.identification.arrays import Real
from service.identification.measured.known import as_identified
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Points
from service.identification.priors.split import Split, log_ratios, split_rows
from service.identification.result.saved import SavedPlane, saved_planes
from service.identification.statistics.derivatives import central_differences
from service.identification.synthetic import closed_loop_points
from sim.datasheet import Datasheet
from sim.errors import AmbError

ACCURACY = 0.003
"""Relative standard deviation that every tone aims at."""
COARSE_POINTS = 8
"""A coarse sweep comes first all the same: it finds the amplitudes that the rig bears today."""
FEWEST, MOST = 9, 24
"""Tones of a check: fewer leave no residual to judge the model by."""
CANDIDATES = 90
BLOCKS = 6
OVERHEAD_S = 3.0 + 2.5
"""Noise record and periodic records of a campaign over four axes."""
BLOCK_S = 0.05
RAMP_S = 0.08
SETTLING = 10.0
"""Time constants of the commissioned closed loop that a tone waits: to a thousandth even where a change of the rig,
which a check is there to find, has made the loop ring half as long again."""
WOKEN_HZ = 10.0
REPEATED = 1.75
"""Attempts at a tone, on average: amplitudes and settling are corrected by trying."""
DRIFT, MODE_DRIFT, DAMPING_DRIFT = 0.3, 0.02, 2.0
"""Relative changes that may have come since the commissioning, one sigma: of any parameter, of a mode's frequency, of
its damping. No baseline guides a check more closely than that."""
TOO_SMALL = "budget too small"
ROUNDING = 1e-9
"""Relative error of a sum of times, by which its order may not decide."""
SCENARIOS = ((0.0, 1.0), (4e-3, 1.0), (-4e-3, 1.0), (0.0, 2.0), (0.0, 0.5))
"""Relative shift of every mode's frequency, and factor on its damping."""


@dataclass(frozen=True)
class ShortPlan:
    """A short experiment and what it should reach."""

    profile: Profile
    """For `service.campaign.run.run_campaign`."""
    std_percent: dict[str, float]
    """Expected standard deviation of every monitored figure, percent of its value."""
    expected_s: float
    """Rig time that it should need."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "frequencies_hz": list(self.profile.frequencies_hz),
            "expected_rig_seconds": self.expected_s,
            "expected_std_percent": dict(self.std_percent),
        }


def short_plan(
    datasheet: Datasheet, baseline_document: Mapping[str, Any], budget_s: float = budget.USUAL_S
) -> ShortPlan:
    """Plan of a health check.

    Parameters
    ----------
    datasheet, baseline_document
        Of the rig: its rig.toml, and the result.json of its commissioning.
    budget_s
        Rig time that the check may take, s; about a tenth of a commissioning's is plenty.

    Raises
    ------
    JobError
        The budget holds too few tones.
    AmbError
        The document has no parameters, or no tones of which they can be told.
    """
    times = _Times(datasheet, baseline_document)
    times.must_suffice(budget_s)
    candidates, seconds = times.candidates, times.seconds
    designs = [_Design(s, times.datasheet) for s in times.planes.values()]
    for design in designs:
        design.prepare(candidates)
    found = _greedy(designs, seconds, budget_s - times.first)
    if len(found) < FEWEST:
        raise AmbError(f"the baseline tells of only {len(found)} tones that a check could learn from; commission anew")
    chosen = sorted(_exchanged(designs, seconds, found))
    frequencies = candidates[chosen]
    total = times.first + float(seconds[chosen].sum())
    profile = Profile(
        accuracy=ACCURACY,
        points=len(frequencies),
        from_hz=float(frequencies[0]),
        to_hz=float(frequencies[-1]),
        validation_points=0,
        amplifier_points=0,
        coarse_points=COARSE_POINTS,
        blocks=BLOCKS,
        rig_seconds=BLOCK_S * BLOCKS * 2 * 4 * (len(frequencies) + COARSE_POINTS / 2),
        peak_points=0,
        frequencies_hz=tuple(float(f) for f in frequencies),
        settle_s=tuple(float(s) for s in times.settling[chosen]),
    )
    std = {k: v for d in designs for k, v in d.std_percent(chosen).items()}
    return ShortPlan(profile, std, total)


def must_suffice(datasheet: Datasheet, baseline_document: Mapping[str, Any], budget_s: float) -> None:
    """Refuse a budget in which no check of a rig fits, long before its plan is made; parameters as of `short_plan`.

    Raises
    ------
    JobError
        It is too small; names the least that will do.
    """
    _Times(datasheet, baseline_document).must_suffice(budget_s)


class _Times:
    """Frequencies that a rig may be checked at, and the rig time that each of them takes."""

    def __init__(self, datasheet: Datasheet, baseline_document: Mapping[str, Any]) -> None:
        self.planes = saved_planes(baseline_document, datasheet)
        self.datasheet = as_identified(datasheet, baseline_document)[0].datasheet
        n_axes, law = self.datasheet.n_axes, _law(self.datasheet)
        self.candidates = candidate_frequencies(self.planes, self.datasheet)
        self.settling = np.max([_settling_s(s.model, law, self.candidates) for s in self.planes.values()], axis=0)
        first, last = self.candidates[[0, -1]]
        coarse = np.interp(np.geomspace(first, last, COARSE_POINTS), self.candidates, self.settling)
        self.first = (OVERHEAD_S / 4 + REPEATED * float(np.sum(coarse + BLOCKS * BLOCK_S / 2 + RAMP_S))) * n_axes
        """Of what comes before the tones, s."""
        per_axis = self.settling + RAMP_S + BLOCKS * np.maximum(BLOCK_S, 1 / self.candidates)
        self.seconds = n_axes * REPEATED * per_axis
        """Of each candidate, s."""
        self.least = self.first + float(np.sum(np.sort(self.seconds)[:FEWEST]))
        """Of a check of the fewest tones, whichever they are, s."""

    def must_suffice(self, budget_s: float) -> None:
        """Refuse a budget that holds too few tones."""
        if budget_s < self.least * (1 - ROUNDING):
            remedy = f"give a budget_s of at least {math.ceil(self.least)}"
            if self.least > budget.LARGEST_S:
                remedy = f"that is more than the {budget.LARGEST_S:g} s of any check: commission it anew instead"
            raise JobError(
                TOO_SMALL,
                f"{budget_s:g} s of rig time hold no health check of this rig: its coarse sweep and {FEWEST} tones "
                f"take {self.least:.0f} s; {remedy}",
            )


def candidate_frequencies(planes: Mapping[str, SavedPlane], datasheet: Datasheet) -> Real:
    """Frequencies to choose from, clear of the mains, Hz: a log-spaced grid, and a comb across every mode."""
    top = min(1000.0, 0.4 * datasheet.sample_rate_hz)
    spread = off_lines(grid(10.0, top, CANDIDATES), CLEARANCE_HZ, mains_harmonics(top))
    near = []
    for s in planes.values():
        for mode in s.model.modes[list(s.rotor_modes)]:
            centre, half = mode[0] / (2 * np.pi), max(mode[1], 5e-4 * mode[0]) / (2 * np.pi)
            near.append(centre + half * np.array([-12, -5, -2.0, -0.9, -0.3, 0.3, 0.9, 2.0, 5, 12]))
    comb = np.concatenate(near) if near else np.empty(0)
    # a mode on a harmonic of the mains is measured all the same: the lock-in sees the line only when it is hit
    comb = off_lines(comb[(comb > 10.0) & (comb < top)], 0.3, mains_harmonics(top))
    # both planes may have a mode at one frequency but for the last digit: which of two that are one is no choice
    return np.unique(np.round(np.concatenate([spread, comb]), DIGITS))


class _Design:
    """Information matrices of one plane at every candidate frequency, for every scenario."""

    def __init__(self, saved: SavedPlane, datasheet: Datasheet) -> None:
        self.saved = saved
        self.controller = _law(datasheet)
        self.figures = plane_figures(saved, self.controller)
        self.values = self.figures.of(saved.model)
        self.models = [_moved(saved, shift, damping) for shift, damping in SCENARIOS]
        self.gradients = [_gradient(self, m) for m in self.models]
        rows = split_rows(saved.model, Split(log_ratios(saved.model)))[1][:, saved.free]
        self.prior = np.diag(1 / _drift(saved.model)[saved.free] ** 2) + rows.T @ rows
        self.information = np.zeros((len(self.models), 0, 0, 0))

    def prepare(self, frequencies_hz: Real) -> None:
        """Information of each frequency, both axes of the plane excited: (scenarios, candidates, n, n)."""
        omega = 2 * np.pi * frequencies_hz
        self.information = np.stack([self._at(m, omega) for m in self.models])

    def _at(self, model: PlaneModel, omega: Real) -> Real:
        total = 0.0
        for axis in range(2):
            where = np.full(len(omega), axis)
            u, i, y = closed_loop_points(model, self.controller, omega, where, np.full(len(omega), 1e-6), rounds=0)
            p = model.predict(Points(omega, u), gradient=True)
            assert p.d_i is not None
            assert p.d_y is not None
            # half of the relative variance is the displacement's, half the current's
            sd_y = ACCURACY * np.linalg.norm(y, axis=1) / 2
            sd_i = ACCURACY * np.abs(i[np.arange(len(omega)), axis]) / 2
            d = np.concatenate([p.d_i / sd_i[:, None, None], p.d_y / sd_y[:, None, None]], axis=1)[
                :, :, self.saved.free
            ]
            total = total + 2 * np.einsum("pca,pcb->pab", d.conj(), d).real
        return np.asarray(total)

    def criterion(self, chosen: Real) -> Real:
        """Mean log variance of the figures for sums of information, (..., scenarios, n, n) -> (...)."""
        cov = np.linalg.inv(chosen + self.prior)
        out = np.zeros(chosen.shape[:-3])
        for k, g in enumerate(self.gradients):
            variance = np.einsum("ka,...ab,kb->...k", g, cov[..., k, :, :], g)
            out = out + np.log(variance).sum(axis=-1)
        return np.asarray(out / len(self.gradients))

    def std_percent(self, chosen: list[int]) -> dict[str, float]:
        """Expected standard deviations on the commissioned rig."""
        cov = np.linalg.inv(self.information[0, chosen].sum(axis=0) + self.prior)
        g = self.gradients[0]
        std = np.sqrt(np.einsum("ka,ab,kb->k", g, cov, g))
        return {name: 100 * float(s) for name, s in zip(self.figures.ids, std, strict=True)}


def _law(datasheet: Datasheet) -> tuple[Real, Real]:
    """The controller, numerator and denominator."""
    return np.array(datasheet.numerator), np.array(datasheet.denominator)


def _settling_s(model: PlaneModel, controller: tuple[Real, Real], frequencies_hz: Real) -> Real:
    """Time, s, after which the closed loop's transient is small beside a tone, (candidates,).

    The relative slope of the response peaks at every closed-loop pole with the pole's time constant. A ramp of
    some tens of milliseconds wakes the poles within some ten hertz.
    """
    dense = np.arange(frequencies_hz[0], 1.1 * frequencies_hz[-1], 0.5)
    omega = 2 * np.pi * dense
    slope = np.zeros(len(omega))
    for axis in range(2):
        where, small = np.full(len(omega), axis), np.full(len(omega), 1e-6)
        y, near = (
            closed_loop_points(model, controller, w, where, small, rounds=0)[2] for w in (omega, omega * (1 + 1e-5))
        )
        change = np.linalg.norm(near - y, axis=1) / np.linalg.norm(y, axis=1) / (1e-5 * omega)
        slope = np.maximum(slope, change)
    poles = 1 + np.flatnonzero((slope[1:-1] > slope[:-2]) & (slope[1:-1] >= slope[2:]))
    distance = (frequencies_hz[:, None] - dense[poles]) / WOKEN_HZ
    waits = SETTLING * slope[poles] / (1 + distance**2)
    return np.asarray(np.max(waits, axis=1, initial=0.03))


def _drift(model: PlaneModel) -> Real:
    """How far every parameter may be from where it was, (size,)."""
    size = DRIFT * np.abs(model.theta)
    size[model.layout.delay] = model.known.sample_time_s
    for k in range(model.layout.n_modes):
        at = model.layout.mode(k).start
        size[at], size[at + 1] = MODE_DRIFT * model.theta[at], DAMPING_DRIFT * abs(model.theta[at + 1])
        for shape in (slice(at + 2, at + 4), slice(at + 4, at + 6)):
            size[shape] = DRIFT * np.linalg.norm(model.theta[shape])
    return np.maximum(size, 1e-12)


def _moved(saved: SavedPlane, shift: float, damping: float) -> PlaneModel:
    """The commissioned plane with other modes."""
    theta = saved.model.theta.copy()
    for k in saved.rotor_modes:
        at = saved.model.layout.mode(k).start
        theta[at] *= 1 + shift
        theta[at + 1] *= damping
    return saved.model.at(theta)


def _gradient(design: _Design, model: PlaneModel) -> Real:
    """Derivatives of the figures, relative to their values, to the free parameters, (K, n)."""
    saved = design.saved
    sd = np.sqrt(np.diag(saved.covariance_from_data))
    steps = np.maximum(np.minimum(0.3 * sd, 1e-5 * np.abs(model.theta[saved.free])), 1e-12)
    of = design.figures.beside(model)
    gradient = central_differences(lambda theta: of(model.at(theta)), model.theta, saved.free, steps)
    return gradient / np.abs(design.values)[:, None]


def _greedy(designs: list[_Design], seconds: Real, budget_s: float) -> list[int]:
    """Frequencies one by one, each the one that lowers the criterion most per second, while the budget lasts.

    What leaves too little for the fewest tones is not chosen: a budget that holds them gives them.
    """
    chosen: list[int] = []
    sums = [np.zeros_like(d.information[:, 0]) for d in designs]
    now = sum(float(d.criterion(s)) for d, s in zip(designs, sums, strict=True))
    while len(chosen) < MOST:
        after = sum(d.criterion(s + np.swapaxes(d.information, 0, 1)) for d, s in zip(designs, sums, strict=True))
        gain = (now - np.asarray(after)) / seconds
        gain[seconds + _reserve(seconds, chosen) > budget_s * (1 + ROUNDING)] = -np.inf
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        if not np.isfinite(gain[best]) or gain[best] <= 0:
            break
        chosen.append(best)
        budget_s -= float(seconds[best])
        sums = [s + d.information[:, best] for d, s in zip(designs, sums, strict=True)]
        now = float(np.asarray(after)[best])
    return chosen


def _reserve(seconds: Real, chosen: list[int]) -> Real:
    """Least rig time of the tones that a check still needs beside each candidate, once that one is chosen, too, s."""
    missing = FEWEST - len(chosen) - 1
    if missing <= 0:
        return np.zeros(len(seconds))
    left = np.setdiff1d(np.arange(len(seconds)), chosen)
    cheapest = left[np.argsort(seconds[left], kind="stable")][: missing + 1]
    # a candidate among the cheapest does not stand in for itself
    among = np.isin(np.arange(len(seconds)), cheapest[:missing])
    total = float(seconds[cheapest[:missing]].sum())
    return np.where(among, total + seconds[cheapest[-1]] - seconds, total)


def _exchanged(designs: list[_Design], seconds: Real, chosen: list[int]) -> list[int]:
    """One round of exchanges: each frequency against every other that takes no longer."""
    for place in range(len(chosen)):
        rest = [c for k, c in enumerate(chosen) if k != place]
        after = sum(d.criterion(d.information[:, rest].sum(axis=1) + np.swapaxes(d.information, 0, 1)) for d in designs)
        score = np.where(seconds <= 1.02 * seconds[chosen[place]], np.asarray(after), np.inf)
        score[rest] = np.inf
        chosen[place] = int(np.argmin(score))
    return chosen
