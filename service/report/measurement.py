"""What the experiment did: displacement and current at every point, noise, time, and what was marked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import cycle, product

import numpy as np

from service.campaign.progress import PHASE_WORDS
from service.experiment.data import Experiment, Sweep
from service.report.figure import AXIS_COLOURS, BAD, MODEL, SECOND, THIRD, Figure, Real, line, log_magnitude, points
from service.report.format import MISSING, count, duration, number, table
from sim.datasheet import Datasheet

COLOURS = {"main": MODEL, "validation": SECOND, "amplifier": THIRD}
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross", "star")
"""Of sweeps with other comments: the next one once all colours are taken."""


def _name(experiment: Experiment, sweep: Sweep) -> str:
    if sweep.comment:
        return PHASE_WORDS.get(sweep.comment, sweep.comment)
    return f"sweep {next(k for k, s in enumerate(experiment.sweeps) if s is sweep)}"


def amplitude_figure(experiment: Experiment, datasheet: Datasheet) -> Figure:
    """Excitation, displacement and current of every point, against linear range and limits."""
    fig = Figure("amplitudes", 3, 1, 640, weights=(0.8, 1.1, 1.1))
    excited = [s for s in experiment.sweeps if s.kind != "noise" and s.comment != "preliminary" and s.n_points]
    looks = _looks(experiment, excited)
    shown: list[list[Real]] = [[], [], []]
    lows, highs = [], []
    for sweep in excited:
        driven = sweep.amplitude_a > 0
        hz, h = sweep.frequency_hz[driven], sweep.harmonic(1)
        if not len(hz):
            continue
        name = _name(experiment, sweep)
        symbol, colour = looks[name]
        y = 1e6 * np.abs(sweep.Y[driven][:, :, h].mean(axis=1)).max(axis=1)
        rows = [sweep.amplitude_a[driven], y]
        if sweep.I is not None:
            rows.append(np.abs(sweep.I[driven][:, :, h].mean(axis=1)).max(axis=1))
        for r, values in enumerate(rows):
            fig.add(r, 0, points(hz, values, name, colour, symbol=symbol, size=3.5))
            shown[r].append(values)
        lows.append(hz.min())
        highs.append(hz.max())
    limits = {1: 1e6 * datasheet.displacement_limit_m, 2: datasheet.current_limit_a}
    for r, title in enumerate(("excitation r, A", "displacement, µm", "coil current, A")):
        reach = [np.array([2.0 * limits[r]])] if r in limits else []
        fig.y(r, 0, title=title, **log_magnitude([*shown[r], *reach]))
        if lows:
            fig.frequency(r, 0, float(min(lows)), float(max(highs)), title=r == 2)
    linear = 1e6 * datasheet.linear_range_m
    fig.line_at(1, 0, y=linear, text="linear range" + (" and limit" if limits[1] == linear else ""), colour=BAD)
    if limits[1] != linear:
        fig.line_at(1, 0, y=limits[1], text="displacement limit", colour=BAD)
    fig.line_at(2, 0, y=limits[2], text="current limit", colour=BAD)
    fig.share_x(0)
    return fig


def _looks(experiment: Experiment, sweeps: Sequence[Sweep]) -> dict[str, tuple[str, str]]:
    """Symbol and colour of each name in the legend; they repeat only once every symbol had every colour."""
    own = {_name(experiment, s): (SYMBOLS[0], COLOURS[s.comment]) for s in sweeps if s.comment in COLOURS}
    free = cycle(look for look in product(SYMBOLS, AXIS_COLOURS) if look not in own.values())
    return {name: own.get(name) or next(free) for name in dict.fromkeys(_name(experiment, s) for s in sweeps)}


def noise_figure(experiment: Experiment) -> Figure | None:
    """Amplitude density of displacement and current without excitation, above 0 Hz; None without such a record."""
    sweep = next((s for s in experiment.sweeps if s.kind == "noise" and s.n_points), None)
    if sweep is None or sweep.block_samples is None:
        return None
    order = np.argsort(sweep.frequency_hz)
    order = order[sweep.frequency_hz[order] > 0]  # a mean value has no place on a logarithmic axis
    if not len(order):
        return None
    h = sweep.harmonic(1)
    seconds = sweep.block_samples / sweep.sample_rate_hz
    signals = [("displacement, nm/√Hz", sweep.Y, 1e9), ("coil current, mA/√Hz", sweep.I, 1e3)]
    known = [(title, x, scale) for title, x, scale in signals if x is not None]
    fig = Figure("noise", 1, len(known), 340, column_gap=0.1)
    hz = sweep.frequency_hz[order]
    for c, (title, x, scale) in enumerate(known):
        # one-sided density S of a complex amplitude over T seconds: E|X|^2 = 2 S / T
        power = np.mean(np.abs(x[:, :, h]) ** 2, axis=1) * seconds[:, None] / 2
        density = scale * np.sqrt(power)[order]
        for k, axis in enumerate(experiment.axes):
            fig.add(0, c, line(hz, density[:, k], axis, AXIS_COLOURS[k % 4], width=1.3))
        fig.y(0, c, title=title, **log_magnitude([density]))
        fig.frequency(0, c, float(hz[0]), float(hz[-1]))
    return fig


def sweep_table(experiment: Experiment) -> str:
    """Every sweep with its points, band, blocks, time on the rig and marks."""
    seconds = _seconds(experiment)
    rows = []
    for k, s in enumerate(experiment.sweeps):
        excited = s.kind != "noise"
        flags = [f for f in s.flags if f]
        lost = int(np.sum(s.amplitude_a <= 0)) if excited else 0
        rows.append(
            [
                _name(experiment, s) if excited else "noise, no excitation",
                str(s.n_points),
                f"{number(float(s.frequency_hz.min()), 4)} to {number(float(s.frequency_hz.max()), 4)}"
                if s.n_points
                else MISSING,
                f"{number(float(s.amplitude_a.min()), 3)} to {number(float(s.amplitude_a.max()), 3)}"
                if excited and s.n_points
                else MISSING,
                str(s.R.shape[1]),
                str(len(flags)) + (f", {lost} not measured" if lost else ""),
                duration(seconds[k]) if seconds[k] > 0 else MISSING,
            ]
        )
    head = ["sweep", "points", "Hz", "r, A", "blocks", "marked", "on the rig"]
    return table(head, rows)


def _seconds(experiment: Experiment) -> list[float]:
    """Time on the rig by sweep, from the times at which points ended; 0 where the file does not tell."""
    ends = [(float(t), k) for k, s in enumerate(experiment.sweeps) if s.time_s is not None for t in s.time_s if t > 0]
    out = [0.0] * len(experiment.sweeps)
    before = 0.0
    for t, k in sorted(ends):
        out[k] += t - before
        before = t
    return out


def flag_table(experiment: Experiment, most: int = 40) -> str:
    """What was marked, in short, and the marked points one by one (folded away)."""
    marked = [
        (s, k, part) for s in experiment.sweeps for k, flag in enumerate(s.flags) for part in flag.split("; ") if part
    ]
    if not marked:
        return (
            "<p>No point had to be marked: all settled, none tripped, none had to be repeated at another amplitude.</p>"
        )
    counts = Counter(part for _, _, part in marked)
    short = table(["mark", "points"], [[flag, str(n)] for flag, n in counts.most_common()])
    rows = [
        [
            _name(experiment, s),
            experiment.axes[int(s.axis[k])],
            number(float(s.frequency_hz[k]), 5),
            number(float(s.amplitude_a[k]), 3),
            part,
        ]
        for s, k, part in marked[:most]
    ]
    rest = f"<p class='small'>and {count(len(marked) - most, 'more')}</p>" if len(marked) > most else ""
    details = table(["sweep", "axis", "Hz", "r, A", "mark"], rows, left=2)
    return f"{short}<details><summary>The marked points</summary>{details}{rest}</details>"
