"""Is a controller safe at speed? Judged on the model of the turning rotor and on others that the data allow as well.

The four axes are one loop there: gyroscopic moments and damping that turns with the shaft couple the planes. Every
figure is the worst over the speeds of the Campbell diagram, which ISO 14839-3 asks of the whole range of speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import block_diagonal, slowest_decay
from service.identification.loop.loop_margins import margins_of_loops
from service.identification.loop.margins import axis_loops, beyond_lines, loop_grid, zone
from service.identification.plane.zoh import discrete_response
from service.identification.result.saved import SavedRotor
from service.identification.rotating.model import RotatingModel
from service.identification.rotating.whirl import loop_matrix
from service.identification.statistics.drawn import DRAWS, Interval, drawn, interval
from sim.wording import times

AXES = ("xA", "xB", "yA", "yB")
FIGURES = (
    (max, -np.inf),  # peak of S
    (max, -np.inf),  # gain downwards, negative
    (min, np.inf),  # gain upwards
    (min, np.inf),  # phase
    (min, np.inf),  # delay
)
"""Of each figure of an axis, which is the worst of several, and what the lack of one counts as: no such limit."""

Law = tuple[Real, Real]
Figures = tuple[float | None, ...]


@dataclass(frozen=True)
class Worst:
    """A figure where it is worst over the speeds."""

    figure: Interval
    speed_rad_s: float | None
    """Where the best model's is worst; None where it has no such figure at any speed."""

    def document(self) -> dict[str, float | None]:
        """As JSON."""
        return {**self.figure.document(), "at_speed_rad_s": self.speed_rad_s}


@dataclass(frozen=True)
class AxisAtSpeed:
    """One axis, the other three loops closed."""

    axis: str
    sensitivity_peak: Worst
    peak_hz: float
    gain_margin_down_db: Worst
    gain_margin_up_db: Worst
    phase_margin_deg: Worst
    delay_margin_s: Worst
    zone: str
    """Of the peak's upper end."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "sensitivity_peak": self.sensitivity_peak.document(),
            "sensitivity_peak_hz": self.peak_hz,
            "gain_margin_db": {"down": self.gain_margin_down_db.document(), "up": self.gain_margin_up_db.document()},
            "phase_margin_deg": self.phase_margin_deg.document(),
            "delay_margin_s": self.delay_margin_s.document(),
            "iso_14839_3_zone": self.zone,
        }


@dataclass(frozen=True)
class AtSpeed:
    """What loading a controller would do to the turning rotor."""

    speeds_rad_s: tuple[float, ...]
    """That were judged, from the slowest to the fastest."""
    decay_per_s: float
    """Slowest, of the best model's loops."""
    stable_share: float
    """Share of the models drawn whose loop is stable at every speed."""
    unstable: str = ""
    """Why the best model's loop does not hold, in words; empty where it does."""
    others_unstable: str = ""
    """The same of models that the data allow as well."""
    not_known: tuple[str, ...] = ()
    """Why none of the models tells whether it does."""
    axes: tuple[AxisAtSpeed, ...] = ()
    beyond: str = ""
    """Why its margins hang on what lies above the measured band, in words; "" where they do not."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "speeds_rad_s": list(self.speeds_rad_s),
            "stable": self.decay_per_s > 0,
            "stable_share_of_models": self.stable_share,
            "slowest_decay_per_s": self.decay_per_s,
            "axes": {a.axis: a.document() for a in self.axes},
        }


def at_speed(
    rotor: SavedRotor,
    law: Law,
    limits: tuple[tuple[str, float], ...],
    draws: int = DRAWS,
    seed: int = 0,
    computing_delay_s: float | None = None,
    highest_hz: float | None = None,
    still: bool = False,
) -> AtSpeed:
    """Judge a controller at every speed of the Campbell diagram; at standstill, where the planes tell, if asked to.

    Stability is judged at every speed with every model; margins of the other models at those speeds at which one of
    the best model's is worst.

    Parameters
    ----------
    law
        Numerator and denominator of the discrete law from -y to u in every axis.
    limits
        Zones of the sensitivity peak, dB, rising.
    draws, seed
        Models drawn from the uncertainty.
    computing_delay_s
        How long the controller computes; as long as the one that was identified without it.
    highest_hz
        Up to which the rotor was measured; anything above it, without.
    still
        Whether standstill is among the speeds, as where the planes' own models do not describe the rig.
    """
    model = rotor.model
    if computing_delay_s is not None:
        x, y = (replace(k, computing_delay_s=computing_delay_s) for k in model.known)
        model = replace(model, known=(x, y))
    speeds = tuple(sorted((float(w) for w in rotor.speeds_rad_s if w or still), key=abs))
    period = model.known[0].sample_time_s
    poles = {w: _poles(model, law, w) for w in speeds}
    decays = {w: slowest_decay(p, period) for w, p in poles.items()}
    slowest = min(decays.values(), default=np.inf)
    not_known: tuple[str, ...] = ()
    if not rotor.adequate:
        not_known = (f"at speed: the model of the turning rotor {inadequate_words(rotor.rms_over_sigma)}",)
    lost = next((w for w in speeds if decays[w] <= 0), None)
    if lost is not None:
        how = unstable_words(poles[lost], period)
        words = f"at {lost:.4g} rad/s, with gyroscopic coupling, the loop is unstable, {how}"
        return AtSpeed(speeds, slowest, 0.0, words, not_known=not_known)
    grids = {w: _grid(model, p) for w, p in poles.items()}
    beyond = ""
    if highest_hz is not None:
        told = (beyond_lines(g, sensitivity_at_speed(model, law, g, w), AXES, highest_hz) for w, g in grids.items())
        beyond = next(filter(None, (b.either for b in told)), "")
    others = drawn(model, rotor.free, rotor.covariance, draws, seed)
    lost_at = [next((w for w in speeds if slowest_decay(_poles(m, law, w), period) <= 0), None) for m in others]
    held = [m for m, w in zip(others, lost_at, strict=True) if w is None]
    return AtSpeed(
        speeds,
        slowest,
        len(held) / max(len(others), 1),
        "",
        _others_words([w for w in lost_at if w is not None], len(others)),
        not_known,
        _axes(model, law, held, grids, limits),
        beyond,
    )


def unstable_words(poles: Complex, period_s: float) -> str:
    """What an unstable sampled loop does, by its fastest growing pole."""
    worst = poles[np.argmax(np.abs(poles))]
    rate = np.log(np.abs(worst)) / period_s
    hz = abs(np.angle(worst)) / period_s / (2 * np.pi)
    how = f"a motion of {hz:.4g} Hz" if hz > 0.5 else "the rotor leaves its place"
    return f"{how}, growing at {rate:.3g} 1/s"


def sensitivity_at_speed(model: RotatingModel, law: Law, omega: Real, speed_rad_s: float) -> Complex:
    """S = (I + G C)^-1 of the four axes at a speed, u = S r, (P, 4, 4)."""
    period = model.known[0].sample_time_s
    g = model.response(omega, speed_rad_s)
    mixed = block_diagonal([k.chain.crosstalk for k in model.known])
    loop = g @ mixed * discrete_response(*law, omega, period)[:, None, None]
    return np.asarray(np.linalg.inv(np.eye(4) + loop), dtype=np.complex128)


def _poles(model: RotatingModel, law: Law, speed_rad_s: float) -> Complex:
    return np.asarray(np.linalg.eigvals(loop_matrix(model, law, speed_rad_s)[0]), dtype=np.complex128)


def inadequate_words(rms_over_sigma: float) -> str:
    """What a model that does not describe the rig does, and what that is to a controller.

    >>> inadequate_words(85.3)
    'leaves residuals 85 times the noise: it does not describe the rig, and what it lacks this check does not see'
    """
    left = (
        f"leaves residuals {times(rms_over_sigma)} times the noise"
        if rms_over_sigma > 1  # otherwise in units of noise and that error together
        else "has an error that had to be allowed for beside the noise"
    )
    return f"{left}: it does not describe the rig, and what it lacks this check does not see"


def _others_words(lost_at: Sequence[float], draws: int) -> str:
    if not draws:
        return (
            "at speed: the turning rotor is known so badly that no other model which the data allow can be computed; "
            "identify it from more data"
        )
    if not lost_at:
        return ""
    first = min(lost_at, key=abs)
    return (
        f"at speed, from {first:.4g} rad/s on, {len(lost_at)} of {draws} models that the data allow as well are "
        "unstable with it"
    )


def _grid(model: RotatingModel, poles: Complex) -> Real:
    """Frequencies that show every peak of the loop, rad/s: those of both planes, and about each whirl that rings."""
    return np.unique(np.concatenate([loop_grid(p, poles) for p in model.planes]))


def _axes(
    model: RotatingModel,
    law: Law,
    held: Sequence[RotatingModel],
    grids: dict[float, Real],
    limits: tuple[tuple[str, float], ...],
) -> tuple[AxisAtSpeed, ...]:
    best = {w: _figures(model, law, omega, w) for w, omega in grids.items()}
    places = [[_worst_at({w: b[j][k] for w, b in best.items()}, k) for k in range(len(FIGURES))] for j in range(4)]
    speeds = {w for row in places for w in row if w is not None}
    others = [{w: _figures(m, law, grids[w], w) for w in speeds} for m in held]
    found = []
    for j, axis in enumerate(AXES):
        peaks, down, up, phase, delay = (
            Worst(
                interval(
                    None if at is None else best[at][j][k],
                    [_worst([o[w][j][k] for w in speeds], k) for o in others],
                    FIGURES[k][1],
                ),
                at,
            )
            for k, at in enumerate(places[j])
        )
        at = places[j][0]
        assert at is not None  # every axis has a peak
        peak, hz = _peak(model, law, grids[at], at, j)
        # a draw's peak is read at the grid: only its ratio to the best model's, read there too, counts
        share = peak / float(best[at][j][0] or peak)
        low, high = (None if v is None else share * v for v in (peaks.figure.low, peaks.figure.high))
        top = Worst(Interval(peak, low, high), at)
        found.append(AxisAtSpeed(axis, top, hz, down, up, phase, delay, zone(high or peak, limits)))
    return tuple(found)


def _figures(model: RotatingModel, law: Law, omega: Real, speed_rad_s: float) -> list[Figures]:
    """Peak, gain margins down and up, phase margin, delay margin of each axis."""

    def of(w: Real) -> Complex:
        return sensitivity_at_speed(model, law, w, speed_rad_s)

    s = of(omega)
    loops = margins_of_loops(omega, axis_loops(s), lambda w: axis_loops(of(w)))
    return [(float(np.abs(s[:, j, j]).max()), *loop.values()) for j, loop in enumerate(loops)]


def _worst(values: Sequence[float | None], k: int) -> float | None:
    pick, _ = FIGURES[k]
    return pick((v for v in values if v is not None), default=None)


def _worst_at(values: dict[float, float | None], k: int) -> float | None:
    """Speed at which a figure is worst."""
    worst = _worst(list(values.values()), k)
    return None if worst is None else next(w for w, v in values.items() if v == worst)


def _peak(model: RotatingModel, law: Law, omega: Real, speed_rad_s: float, j: int) -> tuple[float, float]:
    """The best model's peak between the grid's lines, and its frequency, Hz."""
    grid = omega
    for _ in range(2):
        size = np.abs(sensitivity_at_speed(model, law, grid, speed_rad_s)[:, j, j])
        k = int(np.argmax(size))
        top = float(size[k]), float(grid[k]) / (2 * np.pi)
        grid = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 41)
    return top
