"""Draw a rig, its withheld effects and its datasheet; measure; write a case folder."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from foreign.detect import detectability
from foreign.effects import CATALOGUE, PATH, TURNING, UNKNOWN
from foreign.measure import LeftLimits, measure, plan
from foreign.rig import CONTROLLERS, TS, Truth, pid, slowest, small_signal

AXES = ["xA", "xB", "yA", "yB"]
TOLERANCE = {
    "current_stiffness": 0.2,
    "position_stiffness": 0.2,
    "mode_frequency": 0.005,
    "mode_damping": 0.5,
    "mode_shape": 0.1,
    "mass": 0.005,
    "transverse_inertia": 0.01,
    "sensor_position_m": 0.001,
    "sensor_gain": 0.01,
    "amplifier_frequency": 0.01,
    "amplifier_damping": 0.02,
    "amplifier_gain": 0.005,
}
# what the practice cases' datasheets are off by, one sigma: less than their tolerances, and nothing in the geometry
PRACTICE = {
    "current_stiffness": 0.1,
    "position_stiffness": 0.1,
    "mode_frequency": 0.0025,
    "mode_damping": 0.15,
    "mode_shape": 0.03,
    "amplifier_frequency": 0.005,
    "amplifier_damping": 0.005,
}


def levitates(t: Truth, *spins: float) -> bool:
    """Eigenvalues of the small-signal loop inside the circle, with some damping left for the fast ones.

    At its own speed and at other ``spins``, rad/s.
    """
    return all(slowest(small_signal(*replace(t, spin=w).build()).a) < 1 - 1e-5 for w in (t.spin, *spins))


def other_rotor(rng: np.random.Generator) -> Truth:
    """Another machine: mass, geometry, modes, magnets and a controller that holds it."""
    while True:
        t = Truth()
        scale = float(np.exp(rng.uniform(np.log(0.08), np.log(3.0))))
        t.mass, t.polar, t.inertia = 280.0 * scale, 1.9 * scale, 10.87 * scale * float(rng.uniform(0.7, 1.4))
        stretch = float(rng.uniform(0.9, 1.1))
        t.d = (0.418 * stretch, 0.404 * stretch * float(rng.uniform(0.9, 1.1)))
        t.s = (t.d[0] + float(rng.uniform(0.03, 0.07)), t.d[1] + float(rng.uniform(0.03, 0.07)))
        shift = rng.uniform(0.85, 1.3, 2)
        t.modes = [
            (
                w * shift[k],
                z * float(rng.uniform(0.7, 4.0)),
                tuple((np.array(b) * rng.uniform(0.8, 1.2, 2) / np.sqrt(scale)).tolist()),
                tuple((np.array(s) * rng.uniform(0.8, 1.2, 2) / np.sqrt(scale)).tolist()),
            )
            for k, (w, z, b, s) in enumerate(t.modes)
        ]
        t.bias = float(rng.uniform(1.5, 4.0))
        gap = float(rng.uniform(250e-6, 500e-6))
        t.ks = 1.7e6 * scale * rng.uniform(0.85, 1.15, 4) * float(rng.uniform(0.8, 1.2))
        t.ki = t.ks * gap / t.bias
        t.amp_w = 2 * np.pi * float(rng.uniform(1300, 2200)) * rng.uniform(0.97, 1.03, 4)
        t.amp_zeta = rng.uniform(0.65, 0.95) * rng.uniform(0.97, 1.03, 4)
        gain = float(np.mean(t.ks / t.ki)) / (1.745e6 / 187.0)
        base = dict(CONTROLLERS[str(rng.choice(list(CONTROLLERS)))])
        for name in ("kp", "ki", "kd"):
            base[name] *= gain
        base["notch_hz"] *= float(rng.uniform(0.85, 1.25))
        base["kd"] *= float(rng.uniform(0.8, 1.2))
        t.control = base
        if levitates(t):
            return t


def datasheet(t: Truth, rng: np.random.Generator, sigma: dict) -> dict:
    """The rig's values, each off by its own draw; what ``sigma`` does not name is exact."""

    def off(name: str, value: object) -> list:
        v = np.atleast_1d(np.asarray(value, dtype=float))
        e = np.clip(rng.standard_normal(v.shape), -2.5, 2.5)
        return (v * (1 + sigma.get(name, 0.0) * e)).tolist()

    def damped(value: float) -> float:
        return float(value * (1 + sigma.get("mode_damping", 0.0) * np.clip(rng.standard_normal(), -1.5, 2.0)))

    b, a = pid(**t.control)
    p = sigma.get("sensor_position_m", 0.0) * rng.standard_normal(2)
    return {
        "rotor": {
            "mass_kg": off("mass", t.mass)[0],
            "transverse_inertia_kgm2": off("transverse_inertia", t.inertia)[0],
            "polar_inertia_kgm2": t.polar,
            "bearing_from_cog_m": list(t.d),
            "sensor_from_cog_m": [t.s[0] + float(p[0]), t.s[1] + float(p[1])],
        },
        "modes": [
            {
                "frequency_hz": off("mode_frequency", w / (2 * np.pi))[0],
                "damping_ratio": damped(z),
                "shape_at_bearings": off("mode_shape", at_b),
                "shape_at_sensors": off("mode_shape", at_s),
            }
            for w, z, at_b, at_s in t.modes[:2]
        ],
        "bearings": {
            "current_stiffness_n_per_a": off("current_stiffness", t.ki),
            "position_stiffness_n_per_m": off("position_stiffness", t.ks),
            "bias_current_a": t.bias,
            "linear_range_m": 8e-05,
        },
        "amplifier": {
            "gain": 1.0,
            "natural_frequency_hz": off("amplifier_frequency", t.amp_w / (2 * np.pi)),
            "damping_ratio": off("amplifier_damping", t.amp_zeta),
        },
        "sensor": {"gain": 1.0},
        "controller": {
            "sample_time_s": TS,
            "computing_delay_s": 0.0,
            "numerator": b.tolist(),
            "denominator": a.tolist(),
        },
        "limits": {"displacement_m": t.limit_y, "current_a": t.limit_i},
        "tolerance": TOLERANCE,
    }


def toml(name: str, sheet: dict) -> str:
    lines = ["[rig]", f"name = {json.dumps(name)}", f"axes = {json.dumps(AXES)}", ""]
    for section, content in sheet.items():
        for table in content if isinstance(content, list) else [content]:
            lines.append(f"[[{section}]]" if isinstance(content, list) else f"[{section}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()] + [""]
    return "\n".join(lines)


def kind_of(index: int) -> str:
    """About 58 % single, 13 % mixtures, 13 % clean, 16 % unknown, spread evenly whatever the count."""
    place = ((index + 1) * 0.6180339887498949) % 1.0
    return "single" if place < 0.58 else "mixture" if place < 0.71 else "clean" if place < 0.84 else "unknown"


def draw_kind(index: int, rng: np.random.Generator) -> tuple[list[str], str]:
    """Which effects case ``index`` has: single and unknown ones take turns, so that every law comes up."""
    kind = kind_of(index)
    turn = sum(kind_of(k) == kind for k in range(index))
    if kind == "single":
        return [list(CATALOGUE)[turn % len(CATALOGUE)]], kind
    if kind == "unknown":
        return [list(UNKNOWN)[turn % len(UNKNOWN)]], kind
    while kind == "mixture":
        a, b = (str(n) for n in rng.choice(list(CATALOGUE), 2, replace=False))
        if PATH.get(a, "plant") != PATH.get(b, "plant") or rng.random() < 0.1:
            return sorted([a, b]), kind
    return [], kind


def named_kind(names: list[str]) -> str:
    if not names:
        return "clean"
    if not set(names) <= set(CATALOGUE):
        return "unknown"
    return "single" if len(names) == 1 else "mixture"


def draw_speeds(names: list[str], rng: np.random.Generator) -> tuple[float, float | None]:
    """Speed of the main sweep, rad/s, and that of the other one where it is another.

    What shows by speed turns, and some others.
    """
    if not set(names) & TURNING and rng.random() > 0.15:
        return 0.0, None
    spin = float(rng.uniform(60.0, 500.0))
    return spin, None if rng.random() < 0.5 else float(np.clip(spin * rng.choice([0.0, 0.5, 1.6]), 0.0, 500.0))


def make(index: int, seed: int, out: Path, effects: list[str] | None = None) -> dict:
    """Write case ``index`` into ``out``; the truth."""
    rng = np.random.default_rng([seed, index])
    names, kind = draw_kind(index, rng)
    if effects is not None:
        names, kind = effects, named_kind(effects)
    spin, other_spin = draw_speeds(names, np.random.default_rng([seed, index, 1]))
    level_cap, tries = 1.0, 0
    while True:
        tries += 1
        varied = bool(rng.random() < 1 / 3)
        nominal = other_rotor(rng) if varied else Truth()
        wide = varied and rng.random() < 0.5
        sheet = datasheet(nominal, rng, {k: 0.7 * v for k, v in TOLERANCE.items()} if wide else PRACTICE)
        noise = float(np.exp(rng.uniform(0, np.log(10)))) if rng.random() < 0.3 else 1.0
        nominal.noise_y *= noise
        nominal.noise_i *= noise
        nominal.spin = spin
        plain = copy.deepcopy(nominal)
        factor = float(rng.uniform(1.5, 4.0)) if rng.random() < 0.8 else float(rng.uniform(0.4, 0.7))
        sweeps = plan(nominal, rng, factor, other_spin=other_spin)
        levels = [float(rng.uniform(0, level_cap)) for _ in names]
        changes, without = {}, {n: copy.deepcopy(nominal) for n in names if len(names) > 1}
        for n, x in zip(names, levels, strict=True):
            for other, t in without.items():
                if other != n:
                    (CATALOGUE | UNKNOWN)[n](t, copy.deepcopy(rng), x)
            changes[n] = (CATALOGUE | UNKNOWN)[n](nominal, rng, x)
        level_cap = max(0.3, level_cap * 0.93)  # what does not levitate comes back smaller
        if tries > 200:
            raise RuntimeError(f"case {index} with {names}: no rig that levitates")
        if not levitates(nominal, *([] if other_spin is None else [other_spin])):
            continue
        before = copy.deepcopy(rng)
        try:
            data = measure(nominal, sweeps, rng)
            quiet = {n: measure(t, sweeps, copy.deepcopy(before)) for n, t in without.items()}
        except LeftLimits:
            continue
        break
    seen = detectability(plain, data, measure(plain, sweeps, before), TOLERANCE) if names else 0.0
    each = {n: detectability(t, data, quiet[n], TOLERANCE) for n, t in without.items()}
    name = f"c{index + 1:03d}"
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(toml(name, sheet))
    truth = {
        "effects": ["none_of_these"] if kind == "unknown" else names,
        "kind": kind,
        "laws": names,
        "changes": changes,
        "level": levels,
        "other_rotor": varied,
        "wide_datasheet": bool(wide),
        "noise_factor": noise,
        "detectability": seen,
        "each": each,
        "amplitude_factor": factor,
        "speeds_rad_s": [spin, spin if other_spin is None else other_spin],
        "path": sorted({PATH.get(n, "plant") for n in names}) if kind in ("single", "mixture") else [],
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    with h5py.File(folder / "experiment.h5", "w") as f:
        f.attrs.update(format="amb-experiment", version=1, rig=name, axes=json.dumps(AXES))
        for k, (sweep, comment) in enumerate(zip(data, ("main", "other amplitude"), strict=True)):
            g = f.create_group(f"sweeps/{k}")
            spun = sweep.pop("speed_rad_s")
            g.attrs.update(kind="stepped-sine", comment=comment, sample_rate_hz=1 / TS, speed_rad_s=spun)
            g["harmonics"] = np.arange(4, dtype=np.int8)
            for key, value in sweep.items():
                g.create_dataset(key, data=value, compression="gzip")
    return truth
