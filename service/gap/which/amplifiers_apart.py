"""Amplifiers that each changed on their own: starts of a fit with the bandwidth that each of them shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from sim import imbalance
from sim.effects import CATALOGUE
from sim.errors import AmbError

Real = NDArray[np.float64]

AMPLIFIERS = "amplifier_bandwidth"
OF_ANOTHER_ORDER = ("first_order_share", "second_order_term")
"""Parameters of its law for amplifiers that the datasheet states to be of another order: their frequency is no longer
the datasheet's times what has changed."""
STEP = 1e-3
"""Relative step of an amplifier's bandwidth for its derivative."""


def with_amplifiers_apart(ground: Ground, found: Sequence[Candidate]) -> Iterator[Task]:
    """Task to fit amplifiers of which each has its own bandwidth; none where ``found`` has no such explanation.

    As an even change and one that a bearing or a plane has more of explain them, they are told by two further shapes of
    the law, which few rigs need.
    """
    for c in found:
        if c.effects != (AMPLIFIERS,) or any(c.fit.values[0][name] for name in OF_ANOTHER_ORDER):
            continue
        with suppress(AmbError, np.linalg.LinAlgError):  # a rig that is impossible nearby has no such derivatives
            changes = _bandwidths(ground, c) - 1
            if changes.any():
                start = {**c.fit.values[0], **_apart(changes, ground.nuisance.rig.axes)}
                yield Task(ground, c.effects, ((start,),), c.fit.theta, (EXACT,))


def _apart(changes: Real, axes: Sequence[str]) -> dict[str, float]:
    """Parameters at which every amplifier's bandwidth has changed by so much, (n,), relative."""
    largest = float(changes[np.argmax(np.abs(changes))])
    of_axes = changes / largest
    opposite = float(max(-of_axes.min(), 0.0))
    shares = dict(zip(axes, (of_axes + opposite) / (1 + opposite), strict=True))
    law = {p.name: p for p in CATALOGUE[AMPLIFIERS].parameters}
    known = {"frequency_change": largest, "opposite_share": opposite, **imbalance.of_shares(shares)}
    return {name: float(np.clip(value, law[name].low, law[name].high)) for name, value in known.items()}


def _bandwidths(ground: Ground, c: Candidate) -> Real:
    """Each amplifier's bandwidth over that of the datasheet with its fitted deviations, (n,), to first order."""
    problem, rig = Problem.of(ground, c.fit), c.fit.rig
    linear, frequency = problem.linearised(c.fit), rig.amplifiers.natural_frequency_rad_s
    moved = [
        replace(rig, amplifiers=replace(rig.amplifiers, natural_frequency_rad_s=frequency * (1 + STEP * one)))
        for one in np.eye(rig.n_axes)
    ]
    rows = []
    for o, w in zip(problem.observations, linear.weights, strict=True):
        here, there = (np.stack([problem.model.predict(r, o, closed=False) for r in rigs]) for rigs in ([rig], moved))
        rows.append(stacked(np.moveaxis(((there - here) * w / STEP)[:, :, o.fundamental], 0, -1)))
    left = np.concatenate([stacked(r[..., None])[:, 0] for r in linear.residuals])
    by = np.linalg.lstsq(np.concatenate(rows), left)[0]
    plain = ground.fitted_rig(c.fit.theta, c.fit.inherited).amplifiers.natural_frequency_rad_s
    return np.asarray(frequency / plain * (1 + by))
