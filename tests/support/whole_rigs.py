"""Rigs that nobody chose, whole: rotor, magnets, amplifiers, sampling rate, and a controller that levitates them.

Masses from 4 kg to 2 t, levitation from soft to stiff, 5 to 25 kHz, air gaps from 0.2 to 0.6 mm, rotors as `rotors`
draws them; datasheets up to 22 % off in ki and ks, no mode known.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.loop.margins import sensitivity_peaks
from sim.datasheet import Datasheet
from sim.reference import pid_with_biquad, reference_datasheet, reference_rig
from sim.rig import ControlLaw, FlexibleMode, Rig
from tests.support.planes import plane_model_of
from tests.support.rotors import shaft

HIGHEST_PEAK = 5.0
"""Of |S|, upper limit of zone C of ISO 14839-3."""
LAWS = 80
"""Controllers tried for one rig."""
AXES = 4


def drawn_rig(rng: np.random.Generator) -> Rig:
    """A rig without a controller that suits it."""

    def draw(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    mass, pole = draw(4, 2000), draw(60, 400)  # rad/s, at which the rotor falls into its magnets
    sample_time = 1.0 / rng.choice([5e3, 10e3, 20e3, 25e3] if pole < 200 else [10e3, 20e3, 25e3])
    rotor = shaft(
        np.repeat([draw(0.5, 1.0), 1.0, draw(0.7, 1.4), 1.0, draw(0.5, 1.0)], (5, 4, 6, 4, 5)),
        (rng.uniform(0.3, 0.7), rng.uniform(0.0, 0.3)),
        None,
    )
    first = draw(max(80.0, pole), 900.0)
    w = rotor.w * 2 * np.pi * first / rotor.w[0]
    keep = w < 2 * np.pi * min(3000.0, 0.3 / sample_time)
    length = draw(0.6, 1.6) * (mass / 100.0) ** (1 / 3)
    bearing = np.array([draw(0.68, 0.85) * rotor.z[0], draw(0.68, 0.85) * rotor.z[-1]])
    sensor = np.clip(bearing + np.array([-draw(0.02, 0.06), draw(0.02, 0.06)]), 0.98 * rotor.z[0], 0.98 * rotor.z[-1])
    at_bearing, at_sensor = (rotor.shape_at(*p)[keep] / np.sqrt(mass) for p in (bearing, sensor))

    def modes() -> tuple[FlexibleMode, ...]:
        return tuple(
            FlexibleMode(float(f) * rng.uniform(0.999, 1.001), draw(5e-4, 5e-3), tuple(b), tuple(s))
            for f, b, s in zip(w[keep], at_bearing, at_sensor, strict=True)
        )

    bias, gap = draw(1.0, 4.0), draw(2e-4, 6e-4)
    ks = mass / 2 * pole**2 * rng.uniform(0.85, 1.15, AXES)
    rig = reference_rig()
    return replace(
        rig,
        name="drawn",
        rotor=replace(
            rig.rotor,
            mass_kg=mass,
            transverse_inertia_kgm2=mass * rotor.inertia * length**2,
            polar_inertia_kgm2=0.1 * mass * rotor.inertia * length**2,
            bearing_from_cog_m=(-float(bearing[0]) * length, float(bearing[1]) * length),
            sensor_from_cog_m=(-float(sensor[0]) * length, float(sensor[1]) * length),
            modes=(modes(), modes()),
        ),
        magnets=replace(
            rig.magnets,
            ki=ks * gap / bias * rng.uniform(0.9, 1.1, AXES),
            ks=ks,
            bias_current_a=np.full(AXES, bias),
            current_limit_a=2 * bias,
        ),
        amplifiers=replace(
            rig.amplifiers,
            natural_frequency_rad_s=2 * np.pi * np.full(AXES, draw(800, 3000)) * rng.uniform(0.95, 1.05, AXES),
        ),
        controller=replace(rig.controller, sample_time_s=float(sample_time)),
        displacement_limit_m=0.3 * gap,
        current_limit_a=2 * bias,
        linear_range_m=0.3 * gap,
    )


def controlled(rig: Rig, rng: np.random.Generator) -> tuple[Rig, float] | None:
    """The rig with the law of the lowest sensitivity peak of some tried, and that peak; None where all are too high."""
    m, r, best = rig.magnets, rig.rotor, None
    ks, ki = float(np.mean(m.ks)), float(np.mean(m.ki))
    pole = np.sqrt(2 * ks / r.mass_kg)
    nyquist = 0.5 / rig.controller.sample_time_s
    for _ in range(LAWS):
        stiff, damped = rng.uniform(0.4, 2.0), rng.uniform(0.3, 1.2)
        law = pid_with_biquad(
            (1 + stiff) * ks / ki,
            (1 + stiff) * ks / ki * pole * rng.uniform(0.01, 0.05),
            2 * damped * np.sqrt(r.mass_kg / 2 * stiff * ks) / ki,
            min(pole / (2 * np.pi) * rng.uniform(15, 200), 0.9 * nyquist),
            min(r.modes[0][0].natural_frequency_rad_s / (2 * np.pi) * rng.uniform(0.7, 2.5), 0.8 * nyquist),
            (rng.uniform(0.1, 0.6), rng.uniform(0.5, 0.9)),
            rig.controller.sample_time_s,
        )
        tried = replace(rig, controller=ControlLaw(*law, rig.controller.sample_time_s))
        planes = [plane_model_of(tried, p) for p in "xy"]
        if any(np.abs(closed_loop_poles(p, law)).max() >= 1 - 1e-6 for p in planes):
            continue
        peak = max(s.value for p in planes for s in sensitivity_peaks(p, law))
        if best is None or peak < best[1]:
            best = tried, peak
    return best if best and best[1] < HIGHEST_PEAK else None


def datasheet_of(rig: Rig, rng: np.random.Generator) -> Datasheet:
    """What is known of it before."""
    r, m, c = rig.rotor, rig.magnets, rig.controller
    off = np.exp(rng.uniform(-0.2, 0.2, 2))
    return replace(
        reference_datasheet(),
        name=rig.name,
        mass_kg=r.mass_kg,
        transverse_inertia_kgm2=r.transverse_inertia_kgm2,
        bearing_from_cog_m=r.bearing_from_cog_m,
        sensor_from_cog_m=r.sensor_from_cog_m,
        current_stiffness_n_per_a=(float(np.mean(m.ki) * off[0]),) * AXES,
        position_stiffness_n_per_m=(float(np.mean(m.ks) * off[1]),) * AXES,
        bias_current_a=tuple(m.bias_current_a.tolist()),
        linear_range_m=rig.linear_range_m,
        amplifier_natural_frequency_hz=(float(np.mean(rig.amplifiers.natural_frequency_rad_s)) / (2 * np.pi) * 1.1,)
        * AXES,
        sample_time_s=c.sample_time_s,
        numerator=tuple(c.numerator.tolist()),
        denominator=tuple(c.denominator.tolist()),
        displacement_limit_m=rig.displacement_limit_m,
        current_limit_a=rig.current_limit_a,
    )


def levitating(seeds: Iterable[int]) -> Iterator[tuple[int, Rig, Datasheet, float]]:
    """Rigs that levitate, of these seeds: seed, rig, datasheet and peak of |S|."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        found = controlled(drawn_rig(rng), rng)
        if found:
            yield seed, found[0], datasheet_of(found[0], rng), found[1]
