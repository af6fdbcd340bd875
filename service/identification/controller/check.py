"""Is a controller safe on this rig? Judged on the identified model and its uncertainty, before it is loaded.

The loop is closed with the model and with many others that the data allow as well (draws from the estimate's
covariance); what is reported holds for nearly all of them, not for the best guess. Where the model does not describe
the rig, or there is none of an axis, none of them tells whether the loop holds: the verdict is that it is not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from service.identification.arrays import Real
from service.identification.controller.at_speed import (
    AtSpeed,
    AxisAtSpeed,
    at_speed,
    inadequate_words,
    unstable_words,
)
from service.identification.loop.closed_loop import closed_loop_poles, slowest_decay
from service.identification.loop.loop_margins import margins_of_loops
from service.identification.loop.margins import axis_loops, loop_grid, sensitivity, sensitivity_peaks, zone
from service.identification.plane.model import PlaneModel
from service.identification.result.saved import (
    AT_STANDSTILL,
    SPEEDLESS,
    SavedPlane,
    SavedRotor,
    axes_without_model,
)
from service.identification.statistics.drawn import DRAWS, Interval, drawn, interval
from sim.datasheet import ISO_14839_3_DB, NOT_KNOWN
from sim.errors import AmbError

Verdict = Literal["safe", "unsafe", "not known"]

LATER_STEPS, LATER_TO = 20, 1e-4
"""Delays up to a sample that are tried, and how finely the first that is too long is found, in samples."""


@dataclass(frozen=True)
class AxisCheck:
    """One axis, the other loop of its plane closed."""

    axis: str
    sensitivity_peak: Interval
    peak_hz: float
    gain_margin_down_db: Interval
    """Negative: how far the gain may fall."""
    gain_margin_up_db: Interval
    phase_margin_deg: Interval
    delay_margin_s: Interval
    zone: str
    """Of the peak's upper end; not known where the loop above the measured band matters."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "sensitivity_peak": self.sensitivity_peak.document(),
            "sensitivity_peak_hz": self.peak_hz,
            "gain_margin_db": {
                "down": self.gain_margin_down_db.document(),
                "up": self.gain_margin_up_db.document(),
            },
            "phase_margin_deg": self.phase_margin_deg.document(),
            "delay_margin_s": self.delay_margin_s.document(),
            "iso_14839_3_zone": self.zone,
        }


@dataclass(frozen=True)
class ControllerCheck:
    """What loading a controller would do."""

    rig: str
    reasons: tuple[str, ...]
    """Why it is unsafe; empty when no model that the data allow says so."""
    not_known: tuple[str, ...]
    """Why no model tells whether it is safe."""
    warnings: tuple[str, ...]
    stable: bool
    """The best model's loop, at every speed that is judged."""
    stable_share: float
    """Share of the models drawn whose loop is stable."""
    slowest_decay_per_s: float
    axes: tuple[AxisCheck, ...] = ()
    delay_of_both_axes_s: dict[str, float | None] = field(default_factory=dict)
    """By plane, how much later both of its axes may be at once, as by a controller that computes longer; None: by a
    sample or more."""
    at_speed: AtSpeed | None = None
    """The turning rotor; None where the result has no model of it, and its margins are not known."""
    zones: tuple[tuple[str, float], ...] = ISO_14839_3_DB
    accepted_zone: str = "B"
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def verdict(self) -> Verdict:
        """Unsafe for any reason; safe only where it is known of the whole rig."""
        if self.reasons:
            return "unsafe"
        return "not known" if self.not_known else "safe"

    @property
    def safe(self) -> bool:
        """Whether it may be loaded."""
        return self.verdict == "safe"

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "format": "amb-controller-check",
            "version": 1,
            "rig": self.rig,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "not_known": list(self.not_known),
            "warnings": list(self.warnings),
            "stable": self.stable,
            "stable_share_of_models": self.stable_share,
            "slowest_decay_per_s": self.slowest_decay_per_s,
            "axes": {a.axis: a.document() for a in self.axes},
            "delay_of_both_axes_s": self.delay_of_both_axes_s,
            "at_speed": None if self.at_speed is None else self.at_speed.document(),
            "zones_db": {name: None if np.isinf(limit) else limit for name, limit in self.zones},
            "accepted_zone": self.accepted_zone,
            **({"provenance": self.provenance} if self.provenance else {}),
        }


def check_controller(
    rig: str,
    planes: Mapping[str, SavedPlane],
    controller: tuple[Real, Real],
    sample_time_s: float | None = None,
    zones: Sequence[tuple[str, float]] = ISO_14839_3_DB,
    accepted_zone: str = "B",
    draws: int = DRAWS,
    seed: int = 0,
    computing_delay_s: float | None = None,
    rotor: SavedRotor | None = None,
) -> ControllerCheck:
    """Judge a controller on every identified plane of a rig.

    Parameters
    ----------
    controller
        Numerator and denominator of the discrete law from -y to u in every axis, highest power of z first.
    sample_time_s
        For which it was designed; the rig's without it.
    zones, accepted_zone
        Limits of the sensitivity peak, dB, rising, and the worst zone that is safe.
    draws, seed
        Models drawn from the uncertainty.
    computing_delay_s
        How long the controller computes; as long as the one that was identified without it.
    rotor
        The turning rotor, where the result has one: its loop must hold, in an accepted zone, at every speed of its
        Campbell diagram.

    Raises
    ------
    AmbError
        The controller is no proper transfer function, its sample time is not the rig's, its computing delay is
        negative, or no such zone is in the table.
    """
    law, limits = _checked_law(controller), tuple(zones)
    order = [name for name, _ in limits]
    if accepted_zone not in order:
        raise AmbError(f"zone {accepted_zone!r} is not in the table of zones {', '.join(order)}")
    if not planes:
        raise AmbError(f"the result of rig {rig} has no plane; identify the rig first")
    for s in planes.values():
        _require_sample_time(rig, s, sample_time_s)
    if computing_delay_s is not None:
        if not 0 <= computing_delay_s < np.inf:
            raise AmbError(f"a controller cannot compute for {1e6 * computing_delay_s:g} us; state a delay from 0 on")
        planes = {name: _computing_for(computing_delay_s, s) for name, s in planes.items()}
    others = {name: drawn(s.model, s.uncertain, s.covariance, draws, seed) for name, s in planes.items()}
    checks = [_check_plane(s, law, others[name], limits) for name, s in planes.items()]
    axes = tuple(axis for c in checks for axis in c.axes)

    def beyond(found: str) -> bool:
        return order.index(found) > order.index(accepted_zone)

    reasons = [reason for c in checks for reason in c.reasons]
    reasons += [_beyond_zone(a, accepted_zone) for a in axes if beyond(a.zone)]
    highest_hz = min((s.highest_hz for s in planes.values() if s.highest_hz is not None), default=None)
    # planes that were measured on a turning rotor lack what couples them, which its own model has, at standstill too
    instead = rotor is not None and rotor.adequate and not all(s.adequate for s in planes.values())
    turning = (
        None if rotor is None else at_speed(rotor, law, limits, draws, seed, computing_delay_s, highest_hz, instead)
    )
    if turning is not None:
        reasons += [reason for reason in (turning.unstable, turning.others_unstable) if reason]
        reasons += [_beyond_zone_at_speed(a, accepted_zone) for a in turning.axes if beyond(a.zone)]
    not_known = [*_without_model(planes.values())]
    if not instead:
        not_known += [_inadequate(s) for s in planes.values() if not s.adequate]
    not_known += [f"plane {c.plane}: {c.beyond}" for c in checks if c.beyond]
    if turning is not None:
        not_known += turning.not_known
        if turning.beyond:
            not_known.append(f"at speed: {turning.beyond}")
            turning = replace(turning, axes=tuple(replace(a, zone=NOT_KNOWN) for a in turning.axes))
    unclear = {axis.axis for c in checks if c.beyond for axis in c.axes}
    notes = dict.fromkeys(note for s in planes.values() for note in s.notes)
    if turning is None and SPEEDLESS not in notes:
        notes[AT_STANDSTILL] = None
    if highest_hz is not None:
        notes[_not_measured(highest_hz)] = None
    judged: tuple[_PlaneCheck | AtSpeed, ...] = tuple(checks) if turning is None else (*checks, turning)
    slowest = min(c.decay_per_s for c in judged)
    return ControllerCheck(
        rig,
        reasons=tuple(reasons),
        not_known=tuple(not_known),
        warnings=tuple(notes),
        stable=slowest > 0,
        stable_share=min(c.stable_share for c in judged),
        slowest_decay_per_s=slowest,
        axes=tuple(replace(a, zone=NOT_KNOWN) if a.axis in unclear else a for a in axes),
        delay_of_both_axes_s={c.plane: c.later_s for c in checks if c.decay_per_s > 0},
        at_speed=turning,
        zones=limits,
        accepted_zone=accepted_zone,
    )


@dataclass(frozen=True)
class _PlaneCheck:
    """What loading the controller would do to one plane."""

    plane: str
    decay_per_s: float
    """slowest, of the best model's loop; 0 or less: unstable"""
    stable_share: float
    reasons: tuple[str, ...] = ()
    axes: tuple[AxisCheck, ...] = ()
    beyond: str = ""
    """why its margins hang on what lies above the measured band, in words"""
    later_s: float | None = None
    """how much longer the controller may compute; None: a sample or more"""


def _check_plane(
    s: SavedPlane, law: tuple[Real, Real], others: list[PlaneModel], limits: tuple[tuple[str, float], ...]
) -> _PlaneCheck:
    """One plane's loop closed with the best model and with ``others`` that the data allow as well."""
    poles, period = closed_loop_poles(s.model, law), s.model.known.sample_time_s
    decay = slowest_decay(poles, period)
    if decay <= 0:
        reason = f"plane {s.plane}: the loop is unstable, {unstable_words(poles, period)}"
        return _PlaneCheck(s.plane, decay, 0.0, (reason,))
    every = [(m, closed_loop_poles(m, law)) for m in others]
    held = [(m, loop_grid(m, p)) for m, p in every if slowest_decay(p, period) > 0]
    reasons: tuple[str, ...] = ()
    if not others:
        reasons = (
            f"plane {s.plane}: the model is known so badly that no other one which the data allow can be computed; "
            "identify it from more data",
        )
    elif len(held) < len(others):
        reasons = (
            f"plane {s.plane}: {len(others) - len(held)} of {len(others)} models that the data allow as well are "
            "unstable with it",
        )
    share, axes = len(held) / max(len(others), 1), tuple(_axes(s, law, loop_grid(s.model, poles), held, limits))
    return _PlaneCheck(s.plane, decay, share, reasons, axes, s.beyond_measured(s.model, law).either, _later(s, law))


def _inadequate(s: SavedPlane) -> str:
    return f"plane {s.plane}: the model {inadequate_words(s.rms_over_sigma)}"


def _not_measured(highest_hz: float) -> str:
    return (
        f"nothing was measured above {highest_hz:.4g} Hz: a sharp mode of the rotor there, which the controller that "
        "ran may hold and this one not, shows in no model"
    )


def _without_model(planes: Iterable[SavedPlane]) -> tuple[str, ...]:
    """That axes of the rig are in none of the planes."""
    missing = axes_without_model(planes)
    if not missing:
        return ()
    return (
        f"the commissioning has no model of {', '.join(missing)}: whether the loop holds there is not known; "
        "commission every axis",
    )


def _beyond_zone(a: AxisCheck, accepted_zone: str) -> str:
    p = a.sensitivity_peak
    return (
        f"axis {a.axis}: sensitivity peak {p.value:.2f} ({_up_to(p)}) at {a.peak_hz:.4g} Hz is in zone {a.zone}; "
        f"accepted is {accepted_zone} or better"
    )


def _beyond_zone_at_speed(a: AxisAtSpeed, accepted_zone: str) -> str:
    p = a.sensitivity_peak
    return (
        f"axis {a.axis} at {p.speed_rad_s:.4g} rad/s: sensitivity peak {p.figure.value:.2f} ({_up_to(p.figure)}) at "
        f"{a.peak_hz:.4g} Hz is in zone {a.zone}; accepted is {accepted_zone} or better"
    )


def _require_sample_time(rig: str, s: SavedPlane, sample_time_s: float | None) -> None:
    period = s.model.known.sample_time_s
    if sample_time_s is not None and abs(sample_time_s / period - 1) > 1e-6:
        raise AmbError(
            f"the controller is for a sample time of {1e6 * sample_time_s:g} us, the rig {rig} samples every "
            f"{1e6 * period:g} us; discretise it anew"
        )


def _computing_for(delay_s: float, s: SavedPlane) -> SavedPlane:
    """The plane with a controller that computes so long."""
    return replace(s, model=replace(s.model, known=replace(s.model.known, computing_delay_s=delay_s)))


def _later(s: SavedPlane, law: tuple[Real, Real]) -> float | None:
    """How much longer a controller may compute before the plane's loop is unstable, s; None where a sample does not do.

    By eigenvalues, both axes late at once: it may be half of what each axis alone would bear.
    """
    period, now = s.model.known.sample_time_s, s.model.known.computing_delay_s

    def holds(more_s: float) -> bool:
        model = _computing_for(now + more_s, s).model
        return slowest_decay(closed_loop_poles(model, law), period) > 0

    steps = np.linspace(0.0, period, LATER_STEPS + 1)
    lost = next((k for k, more in enumerate(steps) if not holds(float(more))), None)
    if lost is None:
        return None
    low, high = float(steps[lost - 1]), float(steps[lost])
    while high - low > LATER_TO * period:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _up_to(peak: Interval) -> str:
    return "and how far it may be is not known" if peak.high is None else f"up to {peak.high:.2f}"


def _checked_law(controller: tuple[Real, Real]) -> tuple[Real, Real]:
    numerator, denominator = (np.atleast_1d(np.asarray(x, dtype=float)) for x in controller)
    if not (np.all(np.isfinite(numerator)) and np.all(np.isfinite(denominator))):
        raise AmbError("the controller has a coefficient that is not finite")
    if not len(denominator) or denominator[0] == 0:
        raise AmbError("the controller's denominator must begin with a coefficient that is not zero")
    if len(np.trim_zeros(numerator, "f")) > len(denominator):
        raise AmbError("the controller's numerator has a higher order than its denominator: it is not causal")
    return numerator, denominator


def _axes(
    saved: SavedPlane,
    law: tuple[Real, Real],
    omega: Real,
    held: list[tuple[PlaneModel, Real]],
    limits: tuple[tuple[str, float], ...],
) -> list[AxisCheck]:
    """Both axes from lines ``omega`` that show the best model's loop, and other models, each with its own."""
    best_peaks = sensitivity_peaks(saved.model, law)
    best = _figures(saved.model, law, omega)
    others = list(zip(*(_figures(m, law, own) for m, own in held), strict=True)) or [(), ()]
    found = []
    for j in range(2):
        # a draw's peak is read at the grid: only its ratio to the best model's, read there too, counts
        on_grid = np.array([o[0] for o in others[j]], dtype=float) * best_peaks[j].value / float(best[j][0] or 1.0)
        peak = interval(best_peaks[j].value, on_grid.tolist())
        # no such margin is one beyond any: of gain downwards that is the lowest, of all else the highest
        ends = (-np.inf, np.inf, np.inf, np.inf)
        down, up, phase, delay = (
            interval(best[j][k], [o[k] for o in others[j]], none) for k, none in enumerate(ends, start=1)
        )
        hz = best_peaks[j].omega / (2 * np.pi)
        worst = zone(peak.high or best_peaks[j].value, limits)
        found.append(AxisCheck(saved.axes[j], peak, hz, down, up, phase, delay, worst))
    return found


Figures = tuple[float | None, float | None, float | None, float | None, float | None]


def _figures(model: PlaneModel, law: tuple[Real, Real], omega: Real) -> tuple[Figures, Figures]:
    """Peak, gain margins down and up, phase margin, delay margin of both axes."""
    whole = sensitivity(model, law, omega)
    loops = margins_of_loops(omega, axis_loops(whole), lambda w: axis_loops(sensitivity(model, law, w)))
    a, b = ((float(np.abs(whole[:, j, j]).max()), *loop.values()) for j, loop in enumerate(loops))
    return a, b
