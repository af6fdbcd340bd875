"""What a blind trial withholds: a rig with effects drawn from the catalogue or from beyond it, and its datasheet.

Only the trial imports this; the diagnosis sees the experiment and the datasheet, nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.gap.trial.unlisted_laws import UNLISTED, Drawn, Tampering
from sim.datasheet import Datasheet, Mode, Tolerance
from sim.effect import Effect, Parameter
from sim.effects import CATALOGUE, aliases
from sim.errors import AmbError, EffectError, LevitationError
from sim.reference import reference_rig
from sim.rig import FlexibleMode, Noise, Rig
from sim.stepping import Simulation

Generator = np.random.Generator

SHARES = (("single", 0.56), ("mixture", 0.14), ("clean", 0.14), ("unlisted", 0.16))
"""Kinds of cases and how often they come."""
TOLERANCE = Tolerance(
    mode_frequency=0.005,
    amplifier_frequency=0.01,
    amplifier_damping=0.02,
    amplifier_gain=0.005,
)
DRAWN_SIGMAS = 0.7
"""Errors of the datasheet are drawn this many of its tolerances wide: engineers state them with some margin."""
SPEED_RAD_S = (60.0, 300.0)
AT_SPEED = 0.1
"""Share of the other cases that are measured on a turning rotor."""
AXES = ("xA", "xB", "yA", "yB")
ATTEMPTS = 60
WEAKEST, STRONGEST = 0.1, 1.6
"""Strengths as shares of the catalogue's typical, plainly visible ones."""


@dataclass(frozen=True)
class Case:
    """One withheld truth and what goes with it."""

    number: int
    kind: str
    """"single", "mixture", "clean" or "unlisted"."""
    plain: Rig
    """The rig without what is withheld."""
    rig: Rig
    tampering: Tampering
    datasheet: Datasheet
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
    """(id, ((parameter, value), ...)) of the catalogue's effects in the rig."""
    law: str = ""
    """Name of an unlisted law."""
    law_parameters: tuple[tuple[str, float], ...] = ()

    def truth(self) -> dict[str, Any]:
        """What is sealed, as plain values."""
        return {
            "case": self.number,
            "kind": self.kind,
            "effects": [name for name, _ in self.effects],
            "parameters": {name: dict(values) for name, values in self.effects},
            "law": self.law,
            "law_parameters": dict(self.law_parameters),
            "speed_rad_s": self.plain.speed_rad_s,
        }


def draw(number: int, seed: int) -> Case:
    """Case ``number`` of the trial with that seed; the same two give the same case.

    Raises
    ------
    AmbError
        No rig that levitates was found, which a sound catalogue does not let happen.
    """
    g = np.random.default_rng([seed, number])
    # van der Corput's idea with the golden ratio: any number of cases has the kinds in their shares
    place, kind = (0.5 + number * 0.6180339887498949) % 1.0, ""
    for name, share in SHARES:
        if place < share:
            kind = name
            break
        place -= share
    kind = kind or SHARES[-1][0]
    for _ in range(ATTEMPTS):
        plain = base_rig(g)
        try:
            case = _case(number, kind, plain, g)
            Simulation(case.rig)
        except (EffectError, LevitationError):
            continue
        return case
    raise AmbError(f"case {number} of seed {seed}: no rig with its effects levitates; take another seed")


def _case(number: int, kind: str, plain: Rig, g: Generator) -> Case:
    if kind == "unlisted":
        law = str(g.choice(sorted(UNLISTED)))
        drawn: Drawn = UNLISTED[law](plain, g)
        sheet = datasheet_of(plain, g)
        numbers = tuple(sorted(drawn.parameters.items()))
        return Case(number, kind, plain, drawn.rig, drawn.tampering, sheet, (), law, numbers)
    count = {"single": 1, "mixture": 2, "clean": 0}[kind]
    chosen = _choose(count, plain, g)
    if any(e.needs_speed for e in chosen) and plain.speed_rad_s == 0:
        plain = replace(plain, speed_rad_s=float(g.uniform(*SPEED_RAD_S)))
    rig, drawn_effects = plain, []
    for e in chosen:
        values = strength(e, rig, g)
        rig = e.on(rig, **values)
        drawn_effects.append((e.id, tuple(sorted(values.items()))))
    return Case(number, kind, plain, rig, Tampering(), datasheet_of(plain, g), tuple(drawn_effects))


def _choose(count: int, rig: Rig, g: Generator) -> list[Effect]:
    """Distinct effects; two of a mixture are no aliases of each other and mostly act on different paths."""
    fitting = [e for e in CATALOGUE.values() if e.needs_axes <= rig.n_axes]
    while True:
        chosen = [fitting[k] for k in g.choice(len(fitting), count, replace=False)]
        if count < 2:
            return chosen
        a, b = chosen
        alike = aliases(a.id, b.id)
        if not alike and (a.path != b.path or g.uniform() < 0.3):
            return sorted(chosen, key=lambda e: e.id)


def strength(effect: Effect, rig: Rig, g: Generator) -> dict[str, float]:
    """Values of an effect's parameters, from barely to plainly visible.

    Strengths are shares of the typical values, of either sign where the range allows it; of an effect with one
    parameter per axis, one or two axes have it.
    """
    share = float(WEAKEST * (STRONGEST / WEAKEST) ** g.uniform())
    special = _special(effect.id, share, g)
    per_axis = [p.name for p in effect.parameters if any(f"_{axis}" in p.name for axis in rig.axes)]
    on = set(g.choice(per_axis, int(g.integers(1, 3)), replace=False)) if len(per_axis) > 2 else set(per_axis)
    sign = float(g.choice([-1.0, 1.0]))
    values = {}
    for p in effect.parameters:
        if p.name in special:
            values[p.name] = special[p.name]
        elif p.name in per_axis and p.name not in on:
            values[p.name] = p.null
        elif p.strength:
            signed = sign if p.low < 0 < p.high and -p.typical >= p.low else 1.0
            values[p.name] = _inside(p, p.null + signed * (p.typical - p.null) * share * float(g.uniform(0.6, 1.0)))
        else:
            values[p.name] = _inside(p, p.typical * 2.0 ** float(g.uniform(-1, 1)))
    return values


def _special(name: str, share: float, g: Generator) -> dict[str, float]:
    """Where a share of the typical value would make no sense: whole samples, mains, what the tones can reach."""
    if name == "logging_offset":
        return {"samples": float(g.choice([1.0, 2.0, -1.0]))}
    if name == "mains_interference":
        on_current = g.uniform() < 0.5
        hz = float(g.choice([50.0, 60.0]))
        return {"frequency_hz": hz, ("amplitude_m" if on_current else "amplitude_a"): 0.0}
    if name == "touchdown_contact":
        clearance, side = float(g.uniform(2e-6, 7e-6)), float(g.choice([0.0, 0.0, 1.0, -1.0]))
        return {"side": side, **{f"clearance_{axis}_m": clearance for axis in AXES}}
    if name == "support_resonance":
        pedestals, ratio = float(g.choice([0.0, 0.0, 1.0])), float(g.uniform(0.9, 1.1))
        return {"frequency_hz": 15.0 * 50.0 ** float(g.uniform()), "pedestals": pedestals, "frequency_ratio": ratio}
    if name == "extra_flexible_mode":
        at_b = 0.06 * share * g.uniform(0.4, 1.0, 2) * g.choice([-1.0, 1.0], 2)
        at_s = at_b * g.uniform(0.7, 1.3, 2)
        return {
            "frequency_hz": 60.0 * 20.0 ** float(g.uniform()),
            "bearing_A_per_sqrt_kg": float(at_b[0]),
            "bearing_B_per_sqrt_kg": float(at_b[1]),
            "sensor_A_per_sqrt_kg": float(at_s[0]),
            "sensor_B_per_sqrt_kg": float(at_s[1]),
        }
    if name == "eddy_currents":
        return {"corner_rad_s": float(g.choice([1.0, 10.0, 300.0]))}
    return {}


def _inside(p: Parameter, value: float) -> float:
    return float(np.clip(value, min(p.low, p.null), max(p.high, p.null)))


def base_rig(g: Generator) -> Rig:
    """The reference rig, or one of its kind: magnets, modes and amplifiers of its own, noise up to three times."""
    rig = reference_rig()
    loud = float(np.exp(g.uniform(0, math.log(3))))
    n = rig.noise
    rig = replace(
        rig, noise=Noise(n.displacement_m * loud, n.current_a * loud, n.displacement_step_m, n.current_step_a)
    )
    if g.uniform() < AT_SPEED:
        rig = replace(rig, speed_rad_s=float(g.uniform(*SPEED_RAD_S)))
    if g.uniform() < 0.6:
        return rig
    moved = g.uniform(0.97, 1.03, 2)

    def other(m: FlexibleMode, k: int) -> FlexibleMode:
        return replace(m, natural_frequency_rad_s=m.natural_frequency_rad_s * moved[k])

    modes = tuple(tuple(other(m, k) for k, m in enumerate(plane)) for plane in rig.rotor.modes)
    m, a = rig.magnets, rig.amplifiers
    return replace(
        rig,
        rotor=replace(rig.rotor, modes=modes),
        magnets=replace(m, ki=m.ki * g.uniform(0.93, 1.07, rig.n_axes), ks=m.ks * g.uniform(0.9, 1.1, rig.n_axes)),
        amplifiers=replace(a, natural_frequency_rad_s=a.natural_frequency_rad_s * g.uniform(0.98, 1.1)),
    )


def datasheet_of(rig: Rig, g: Generator, tolerance: Tolerance = TOLERANCE) -> Datasheet:
    """What an engineer knows of a rig: its values, each off by a draw within its tolerance."""

    def off(values: Any, sigma: float) -> tuple[float, ...]:
        v = np.atleast_1d(np.asarray(values, dtype=float))
        e = np.clip(g.standard_normal(v.shape), -2.5, 2.5)
        return tuple((v * (1 + DRAWN_SIGMAS * sigma * e)).tolist())

    r, t = rig.rotor, tolerance
    modes = []
    for same in zip(*r.modes, strict=True):  # the same mode in every plane
        mode = same[0]
        frequency = float(np.mean([m.natural_frequency_rad_s for m in same])) / (2 * math.pi)
        damping = float(np.mean([m.damping_ratio for m in same]))
        error = max(0.2, 1 + DRAWN_SIGMAS * t.mode_damping * float(np.clip(g.standard_normal(), -2, 2)))
        bearings, sensors = off(mode.shape_at_bearings, t.mode_shape), off(mode.shape_at_sensors, t.mode_shape)
        modes.append(
            Mode(
                off(frequency, t.mode_frequency)[0],
                damping * error,
                (bearings[0], bearings[1]),
                (sensors[0], sensors[1]),
            )
        )
    sensor = np.array(r.sensor_from_cog_m) + DRAWN_SIGMAS * t.sensor_position_m * g.standard_normal(2)
    zeta = rig.amplifiers.damping_ratio
    n = rig.n_axes
    return Datasheet(
        name="withheld",
        axes=rig.axes,
        mass_kg=off(r.mass_kg, t.mass)[0],
        transverse_inertia_kgm2=off(r.transverse_inertia_kgm2, t.transverse_inertia)[0],
        polar_inertia_kgm2=r.polar_inertia_kgm2,
        bearing_from_cog_m=r.bearing_from_cog_m,
        sensor_from_cog_m=(float(sensor[0]), float(sensor[1])),
        modes=tuple(modes),
        current_stiffness_n_per_a=off(rig.magnets.ki, t.current_stiffness),
        position_stiffness_n_per_m=off(rig.magnets.ks, t.position_stiffness),
        bias_current_a=tuple(rig.magnets.bias_current_a.tolist()),
        linear_range_m=rig.linear_range_m,
        amplifier_gain=(1.0,) * n,
        amplifier_natural_frequency_hz=off(
            rig.amplifiers.natural_frequency_rad_s / (2 * math.pi), t.amplifier_frequency
        ),
        amplifier_damping_ratio=None if zeta is None else off(zeta, t.amplifier_damping),
        sensor_gain=(1.0,) * n,
        sensor_bandwidth_hz=None,
        sample_time_s=rig.controller.sample_time_s,
        computing_delay_s=0.0,
        numerator=tuple(rig.controller.numerator.tolist()),
        denominator=tuple(rig.controller.denominator.tolist()),
        displacement_limit_m=rig.displacement_limit_m,
        current_limit_a=rig.current_limit_a,
        tolerance=t,
        tolerance_stated=True,
    )


def described(effects: Mapping[str, Mapping[str, float]]) -> str:
    """Effects and their values in one line.

    >>> described({"loop_delay": {"delay_s": 3.5e-05}})
    'loop_delay (delay_s 3.5e-05)'
    """
    shown = (f"{name} ({', '.join(f'{k} {v:.3g}' for k, v in values.items())})" for name, values in effects.items())
    return " + ".join(shown) or "nothing"
