"""Values in another unit than the one that their field has: such data fit, but the rig is another one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Experiment
from service.experiment.errors import ExperimentFileError
from sim.datasheet import Datasheet
from sim.rig import Magnets

BEYOND = 5.0
"""Times a rig's own limit that no amplitude reaches: of y the stops, of i the supply would have ended it before."""
FAR = 30.0
"""Factor from which a stiffness is not off, but in another unit, the least of which is 1000."""
SPAN = (0.1, 20.0)
"""Distance of the bearings from the centre of gravity over the radius of gyration: 1.7 for a uniform rotor between
bearings at its ends, 0.5 for a disc between close ones, 10 for a small disc on a long shaft."""
APART = 5.0
"""Distance of a bearing over that of its sensor, or the other way round, from which they are not beside each other; one
of them near the centre of gravity may look so, both of them not."""

SLOWEST_HZ, SLOWEST = 1.0, 1e-4
"""Frequency that some tone of an experiment reaches, and that over the controller's sampling rate: 1 Hz at 10 kHz."""
AIR_GAP_M = (5e-6, 2e-2)
"""Air gaps that magnets have: from those of micromachines, tens of um, to a few mm."""
DAMPED = 0.05
"""Damping ratio that no flexible mode of a shaft has: 1e-4 to 1e-3 for steel, some 0.01 with shrunk laminations."""
LOOSE, TIGHT = 1.0, 1e-6
"""Relative tolerance from which a value may be anything, and below which no maker of a rig knows it."""


def must_be_in_si(experiment: Experiment, datasheet: Datasheet) -> None:
    """Refuse amplitudes and frequencies that the rig cannot have had.

    Raises
    ------
    ExperimentFileError
        Displacements or currents far beyond the limits of the datasheet, or tones far beyond what its controller can
        play; names dataset, field and the unit that it may be in.
    """
    room_m = max(datasheet.displacement_limit_m, datasheet.linear_range_m)
    for k, sweep in enumerate(experiment.sweeps):
        if not sweep.n_points:
            continue
        h = sweep.harmonic(1)
        where = f"sweeps/{k}"
        told = f"{where}: Y reaches {{}} m, the limit of displacement is {{}} m"
        _must_stay(_largest(sweep.Y, h), room_m, told, "m")
        for name, x in (("R", sweep.R), ("U", sweep.U), ("I", sweep.I)):
            if x is not None:
                told = f"{where}: {name} reaches {{}} A, the limit of current is {{}} A"
                _must_stay(_largest(x, h), datasheet.current_limit_a, told, "A")
        if float(sweep.frequency_hz.max()) * datasheet.sample_time_s > 1:
            raise ExperimentFileError(
                f"{where} has tones up to {sweep.frequency_hz.max():.4g} Hz, which a controller with the datasheet's "
                f"sample_time_s of {datasheet.sample_time_s:.4g} s cannot play: is that in ms?"
            )
    _must_reach_the_rotor(experiment, datasheet.sample_time_s)


def odd_rotor(datasheet: Datasheet) -> list[str]:
    """What mass, inertia and distances of a datasheet tell together, where they are no rotor's; a sentence."""
    gyration_m = math.sqrt(datasheet.transverse_inertia_kgm2 / datasheet.mass_kg)
    bearings_m, sensors_m = (0.5 * sum(d) for d in (datasheet.bearing_from_cog_m, datasheet.sensor_from_cog_m))
    of_mass = (
        f"mass_kg {datasheet.mass_kg:.4g} and transverse_inertia_kgm2 {datasheet.transverse_inertia_kgm2:.4g}, which "
        f"make a radius of gyration of {gyration_m:.3g} m"
    )
    pairs = zip(datasheet.bearing_from_cog_m, datasheet.sensor_from_cog_m, strict=True)
    ratios = [bearing / sensor for bearing, sensor in pairs]
    if min(ratios) > APART or max(ratios) < 1 / APART:
        right, wrong = "bearing_from_cog_m", "sensor_from_cog_m"
        if _is_worse(bearings_m, sensors_m, gyration_m):
            right, wrong = wrong, right
        return [
            f"the datasheet's bearing_from_cog_m {_pair(datasheet.bearing_from_cog_m)} and sensor_from_cog_m "
            f"{_pair(datasheet.sensor_from_cog_m)} are not beside each other at either end, and {right} goes better "
            f"with {of_mass}: is {wrong} in another unit than m, or its decimal point elsewhere?"
        ]
    if SPAN[0] <= bearings_m / gyration_m <= SPAN[1]:
        return []
    return [
        f"the datasheet's {of_mass}, do not go with bearings {bearings_m:.3g} m and sensors {sensors_m:.3g} m from the "
        "centre of gravity: is one of them in g, t or kg mm², or are bearing_from_cog_m and sensor_from_cog_m in mm or "
        "cm?"
    ]


def odd_air_gap(datasheet: Datasheet) -> list[str]:
    """What the magnets' factors of a datasheet tell together, where no magnet has them; a sentence."""
    magnets = Magnets.plain(
        ki=np.array(datasheet.current_stiffness_n_per_a),
        ks=np.array(datasheet.position_stiffness_n_per_m),
        bias_current_a=np.array(datasheet.bias_current_a),
        current_limit_a=datasheet.current_limit_a,
    )
    gap_m = float(np.median(magnets.gap_m))
    if AIR_GAP_M[0] < gap_m < AIR_GAP_M[1]:
        return []
    return [
        f"the datasheet's magnets would have an air gap of {gap_m:.3g} m (bias_current_a times "
        "current_stiffness_n_per_a over position_stiffness_n_per_m), which no bearing has: is one of them in another "
        "unit, as a stiffness in N/mm or N/µm or a current in mA?"
    ]


def odd_modes(datasheet: Datasheet) -> list[str]:
    """Flexible modes of a datasheet that are damped as no shaft is; a sentence."""
    damped = [(m.frequency_hz, m.damping_ratio) for m in datasheet.modes if m.damping_ratio > DAMPED]
    if not damped:
        return []
    told = ", ".join(f"{ratio:.3g} at {hz:.4g} Hz" for hz, ratio in damped)
    return [
        f"the datasheet's modes have a damping_ratio of {told}, which no shaft has, and what a mode lacks of it looks "
        "like an effect: is it in per cent? A ratio is 0.001 for 0.1 %"
    ]


def _is_worse(one_m: float, other_m: float, gyration_m: float) -> bool:
    """Whether a distance is further, as a factor, from that of a usual rotor's ends than another one."""
    usual_m = math.sqrt(3) * gyration_m  # a uniform rotor's
    return abs(math.log(one_m / usual_m)) > abs(math.log(other_m / usual_m))


def _pair(values: tuple[float, float]) -> str:
    return f"[{values[0]:.4g}, {values[1]:.4g}]"


def odd_tolerances(datasheet: Datasheet) -> list[str]:
    """Stated tolerances that let a value be anything, or nothing else than stated; a sentence for each kind."""
    if not datasheet.tolerance_stated:
        return []
    relative = asdict(datasheet.tolerance)
    relative["sensor_position_m"] /= min(datasheet.sensor_from_cog_m)
    loose = [name for name, sigma in relative.items() if sigma > LOOSE]
    tight = [name for name, sigma in relative.items() if sigma < TIGHT]
    told = []
    if loose:
        told.append(
            f"the datasheet's tolerance of {', '.join(loose)} lets values be anything, and what is wrong with them is "
            "no gap then: a tolerance is a fraction, 0.2 for 20 %, and sensor_position_m in m"
        )
    if tight:
        told.append(
            f"the datasheet's tolerance of {', '.join(tight)} takes values for certain that nobody knows so well: what "
            "they are off by is laid to effects then, or to another rig; state what they may be off by"
        )
    return told


def odd_stiffness(found_over_datasheet: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """What identified ki and ks are of the datasheet's, where all are off by a factor that only a unit makes.

    Parameters
    ----------
    found_over_datasheet
        By "ki" and "ks", identified over stated of every axis; positive.
    """
    factor = {name: float(np.exp(np.median(np.log(x)))) for name, x in found_over_datasheet.items() if len(x)}
    off = [name for name, x in factor.items() if max(x, 1 / x) > FAR]
    if not off:
        return []
    told = " and ".join(f"{name} {factor[name]:.1g} times" for name in off)
    remedies = {
        "ki": "current_stiffness_n_per_a, or of the currents or displacements of the experiment (mA, mm, µm)",
        "ks": "position_stiffness_n_per_m (N/mm, N/µm), or of bearing_from_cog_m and sensor_from_cog_m (mm, cm)",
    }
    both = (
        "mass_kg and transverse_inertia_kgm2 (g, t), of bearing_from_cog_m and sensor_from_cog_m (mm, cm), or of both "
        "stiffnesses"
    )
    remedy = both if len(off) > 1 else remedies[off[0]]
    return [f"identified are {told} the datasheet's, which is no tolerance: check the unit of {remedy}"]


def _must_reach_the_rotor(experiment: Experiment, sample_time_s: float) -> None:
    tones_hz = [float(s.frequency_hz.max()) for s in experiment.sweeps if s.kind != "noise" and s.n_points]
    if tones_hz and max(tones_hz) < max(SLOWEST_HZ, SLOWEST / sample_time_s):
        raise ExperimentFileError(
            f"the tones end at {max(tones_hz):.4g} Hz, where nothing of a rotor shows whose controller has a "
            f"sample_time_s of {sample_time_s:.4g} s: is frequency_hz in kHz?"
        )


def _largest(x: NDArray[np.complex128], harmonic: int) -> float:
    size = np.abs(x[:, :, harmonic].mean(axis=1))
    return float(size[np.isfinite(size)].max(initial=0.0))  # a point that is no number is left out later, and told


def _must_stay(largest: float, limit: float, told: str, unit: str) -> None:
    if largest <= BEYOND * limit:
        return
    other = f"µ{unit}" if largest > 1000 * limit and unit == "m" else f"m{unit}"
    raise ExperimentFileError(
        f"{told.format(f'{largest:.3g}', f'{limit:.3g}')}: is it in {other}? Both hold {unit}; scale the "
        "one that is wrong"
    )
