"""Which sweeps of an experiment are fitted, and which one checks the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.experiment.speeds import at_standstill
from sim.errors import AmbError

NOT_PLANT = ("amplifier", "preliminary", "validation")
"""Comments of sweeps that the joint fit does not see."""


@dataclass(frozen=True)
class Joined:
    """A sweep, with what others add of axes that it does not excite: rigs are also measured plane by plane."""

    sweep: Sweep
    name: str
    """Of all that is in it, such as "sweeps/0 (main)"."""
    places: tuple[int, ...]
    """Which sweeps of the experiment are in it."""
    notes: tuple[str, ...] = ()
    """What could not be used, and why."""


@dataclass(frozen=True)
class Chosen:
    """Sweeps by what they are for."""

    main: Joined
    amplifier: Joined | None
    """Helps with the amplifiers."""
    validation: Joined | None
    """No step of any fit sees it."""
    speeds_rad_s: tuple[float, ...]
    """At which the plant was excited, slowest first."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of all of them."""
        every = (self.main, self.amplifier, self.validation)
        return tuple(note for one in every if one is not None for note in one.notes)


def chosen_sweeps(experiment: Experiment) -> Chosen:
    """The first sweep of the plant at the slowest speed, the one that checks it, and that of the amplifiers.

    Raises
    ------
    AmbError
        No sweep has an excited point.
    """
    excited = [k for k, s in enumerate(experiment.sweeps) if _excites(s)]
    if not excited:
        raise AmbError(f"experiment {experiment.rig!r} has no sweep with an excited point; nothing to identify")
    speeds = speeds_of(experiment)
    sweeps = experiment.sweeps
    slowest = [k for k in excited if not speeds or speed_of(sweeps[k]) == speeds[0]]
    plant = [k for k in slowest if sweeps[k].comment not in NOT_PLANT]
    main = joined_sweep(experiment, plant or [k for k in slowest if sweeps[k].comment != "amplifier"] or excited[:1])
    assert main is not None
    of_amplifiers = [k for k in excited if sweeps[k].comment == "amplifier" and k not in main.places]
    others = [k for k in slowest if k not in main.places and sweeps[k].comment not in ("amplifier", "preliminary")]
    checks = [k for k in others if sweeps[k].comment == "validation"]
    return Chosen(
        main, joined_sweep(experiment, of_amplifiers), joined_sweep(experiment, checks or others), tuple(speeds)
    )


def speeds_of(experiment: Experiment) -> list[float]:
    """Speeds at which the plant was excited, slowest first."""
    found = {speed_of(s) for s in experiment.sweeps if _excites(s) and s.comment not in NOT_PLANT}
    return sorted(found, key=abs)


def speed_of(sweep: Sweep) -> float:
    """Speed at which a sweep was measured, rad/s; 0 at standstill."""
    return 0.0 if at_standstill(sweep.speed_rad_s) else float(sweep.speed_rad_s)


def _excites(sweep: Sweep) -> bool:
    return sweep.kind != "noise" and bool(np.any(sweep.amplitude_a > 0))


def joined_sweep(experiment: Experiment, places: Sequence[int]) -> Joined | None:
    """The first of some sweeps, with the points of the others that excite axes which no sweep before them does.

    Parameters
    ----------
    places
        Of the sweeps in the experiment; None of none.
    """
    if not places:
        return None
    whole, used, notes = experiment.sweeps[places[0]], [places[0]], []
    for k in places[1:]:
        other = experiment.sweeps[k]
        new = (other.amplitude_a > 0) & ~np.isin(other.axis, whole.axis[whole.amplitude_a > 0])
        if not np.any(new):
            continue
        where = f"sweeps/{k} excites {', '.join(experiment.axes[a] for a in np.unique(other.axis[new]))}"
        first = ", ".join(f"sweeps/{u}" for u in used)
        if apart := _apart(whole, other):
            notes.append(
                f"{where}, which {first} does not, but has another {apart} and is left out; measure both alike, or "
                "identify each from a file of its own"
            )
            continue
        fewest = min(whole.U.shape[1], other.U.shape[1])
        if whole.U.shape[1] != other.U.shape[1]:
            notes.append(f"{where} and has another number of blocks than {first}: the first {fewest} of each are used")
        whole = _both(whole, other.select(new), fewest)
        used.append(k)
    return Joined(whole, ", ".join(_name(experiment, k) for k in used), tuple(used), tuple(notes))


def _apart(one: Sweep, other: Sweep) -> str:
    """What keeps two sweeps from being one; "" for nothing."""
    if one.kind != "stepped-sine" or other.kind != "stepped-sine":
        return "kind of excitation" if one.kind != other.kind else "set of lines that act together"
    if speed_of(one) != speed_of(other):
        return "speed"
    if not np.isclose(one.sample_rate_hz, other.sample_rate_hz):
        return "sample rate"
    if (one.I is None) != (other.I is None):
        return "set of signals (i)"
    return "" if 1 in one.harmonics and 1 in other.harmonics else "set of harmonics"


def _both(one: Sweep, other: Sweep, blocks: int) -> Sweep:
    """Points of two sweeps that were recorded alike, with the harmonics and the blocks that both have."""
    harmonics = tuple(h for h in one.harmonics if h in other.harmonics)

    def signals(name: str) -> np.ndarray:
        parts = (getattr(s, name)[:, :blocks][:, :, [s.harmonic(h) for h in harmonics]] for s in (one, other))
        return np.concatenate(list(parts))

    def per_point(name: str) -> np.ndarray | None:
        parts = [getattr(s, name) for s in (one, other)]
        return None if any(p is None for p in parts) else np.concatenate(parts)

    flags = tuple(flag for s in (one, other) for flag in (s.flags or ("",) * s.n_points))
    return replace(
        one,
        frequency_hz=np.concatenate([one.frequency_hz, other.frequency_hz]),
        axis=np.concatenate([one.axis, other.axis]),
        amplitude_a=np.concatenate([one.amplitude_a, other.amplitude_a]),
        harmonics=harmonics,
        R=signals("R"),
        U=signals("U"),
        I=None if one.I is None else signals("I"),
        Y=signals("Y"),
        flags=flags if any(flags) else (),
        block_samples=per_point("block_samples"),
        time_s=per_point("time_s"),
        point_speed_rad_s=per_point("point_speed_rad_s"),
    )


def _name(experiment: Experiment, place: int) -> str:
    comment = experiment.sweeps[place].comment
    return f"sweeps/{place} ({comment})" if comment else f"sweeps/{place}"
