"""Effects on a foreign rig, by laws of its own, from barely visible (level 0) to gross (level 1).

Each function changes a Truth in place and returns what it did, for truth.json. Where physics leaves a choice of
law (a play operator or a loss angle, a pole or a delay, one housing or two), one is drawn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

from foreign.physics import N_LADDER, N_PLAYS
from foreign.rig import Truth, four
from foreign.shaft import gyroscopic_matrix, stations

Rng = np.random.Generator
Change = dict[str, object]


def size(level: float, low: float, high: float) -> float:
    """Between low and high on a logarithmic scale."""
    return float(low * (high / low) ** level)


def sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def some_axes(rng: Rng) -> list[int]:
    """All four axes, or one."""
    return [0, 1, 2, 3] if rng.random() < 0.6 else [int(rng.integers(4))]


def on_axes(axes: list[int], value: float, rest: float = 0.0) -> np.ndarray:
    out = four(rest)
    out[axes] = value
    return out


def loop_delay(t: Truth, rng: Rng, level: float) -> Change:
    tau = size(level, 0.4e-6, 40e-6)
    t.loop["delay"] = np.array([tau])
    return {"delay": tau}


def logging_offset(t: Truth, rng: Rng, level: float) -> Change:
    t.log["offset"] = int(rng.choice([1, 2, -1], p=[0.6, 0.25, 0.15]))
    return {"_log_offset": t.log["offset"]}


def amplifier_bandwidth(t: Truth, rng: Rng, level: float) -> Change:
    if rng.random() < 0.4:
        hz = size(level, 40e3, 6e3)
        t.plant["amp_extra"] = four(2 * np.pi * hz)
        return {"extra_pole_hz": hz}
    factor = 1 - size(level, 0.015, 0.25)
    t.plant["amp_w"] = lambda w: w * factor
    return {"amp_w": (t.amp_w * factor).tolist(), "relative": factor - 1}


def amplifier_voltage_limit(t: Truth, rng: Rng, level: float) -> Change:
    # what the tones ask for is up to 0.6 A x 2 pi 1 kHz = 3.8e3 A/s at the main amplitude
    limit = size(level, 5.5e3, 2.2e3)
    kind, r_over_l = [("slope", 0.0), ("slope", 80.0), ("slope", 250.0), ("PI", 0.0), ("P", 0.0)][int(rng.integers(5))]
    change: Change = {"kind": kind, "slew_a_per_s": limit}
    if kind != "slope":  # a coil under a current loop, its resistance as may be
        r_over_l = size(float(rng.random()), 20.0, 400.0)
        t.plant["coil"] = 1 if kind == "PI" else 2
    if kind == "P":
        t.plant["coil_gain"] = t.amp_w * float(rng.uniform(0.5, 2.0))
        change["p_over_l_per_s"] = t.plant["coil_gain"].tolist()
    t.plant["slew"], t.plant["slew_resistive"] = four(limit), four(r_over_l)
    return change | {"r_over_l_per_s": r_over_l}


def channel_crosstalk(t: Truth, rng: Rng, level: float) -> Change:
    e = size(level, 3e-4, 0.08) * sign(rng)
    mix, kind = np.eye(4), str(rng.choice(["b_in_a", "both"]))
    for plane in (0, 2):
        mix[plane, plane + 1] = e
        if kind == "both":
            mix[plane + 1, plane] = e * float(rng.uniform(0.5, 1.2))
    t.plant["u_mix"] = mix
    return {"share": e, "kind": kind}


def controller_mismatch(t: Truth, rng: Rng, level: float) -> Change:
    kind = str(rng.choice(["gain", "derivative", "filter"]))
    c = dict(t.control)
    e = size(level, 5e-4, 0.15) * sign(rng)
    if kind == "gain":
        for name in ("kp", "ki", "kd"):
            c[name] *= 1 + e
    elif kind == "derivative":
        c["kd"] *= 1 + e
    else:
        c["filter_hz"] *= 1 - abs(e) * 1.5
    t.running = c
    return {"kind": kind, "relative": e}


def _fit_ladder(law: Callable[[np.ndarray], np.ndarray], poles: np.ndarray) -> tuple[np.ndarray, float]:
    w = 2 * np.pi * np.geomspace(3, 4000, 200)
    columns = np.concatenate([1 / (1 + 1j * w[:, None] / poles), np.ones((200, 1))], axis=1)
    target = law(1j * w)
    dc = 300.0 * np.ones((1, len(poles) + 1))
    gain, _ = nnls(np.concatenate([columns.real, columns.imag, dc]), np.r_[target.real, target.imag, 300.0])
    return gain[:-1], float(gain[-1])


def eddy_currents(t: Truth, rng: Rng, level: float) -> Change:
    tau = size(level, 3e-9, 5e-6)
    poles = np.geomspace(60, 5e4, N_LADDER)
    gain, direct = _fit_ladder(lambda s: 1 / (1 + np.sqrt(s * tau)), poles)
    both = rng.random() < 0.4
    t.plant.update(ladder=2 if both else 1, ladder_pole=poles, ladder_gain=gain, ladder_direct=direct)
    return {"eddy_tau": tau, "on_displacement": bool(both)}


def magnetic_saturation(t: Truth, rng: Rng, level: float) -> Change:
    if rng.random() < 0.5:
        i_s = size(level, 14.0, 1.0)
        t.plant.update(saturation=1, sat_level=four(i_s))
        return {"sat_A": i_s}
    b, n = size(level, 2.4, 1.15), float(rng.choice([4.0, 6.0]))
    t.plant.update(saturation=2, sat_level=four(b), sat_power=n)
    # the bias point keeps its stiffness roughly, as a datasheet's identified values would have it
    t.plant["k"] = lambda k: k * (1 + b**-n)
    return {"flux_ratio": b, "power": n}


def magnetic_hysteresis(t: Truth, rng: Rng, level: float) -> Change:
    width = float(rng.uniform(0.1, 0.5))
    law = rng.random()
    share = size(level, 5e-4, 0.12)
    if law < 0.5:
        name, w = "play", np.full(N_PLAYS, width)
    elif law < 0.75:
        name, w = "rayleigh", width * 2.5 * np.arange(1, N_PLAYS + 1) / N_PLAYS
    else:  # two of each of three widths that are far apart
        name, w = "far apart", np.repeat(width * np.array([0.04, 0.25, 1.5]), N_PLAYS // 3)
    t.plant.update(play_share=four(share), play_width=w)
    return {"law": name, "share": share, "width_a": w.tolist()}


def off_centre_rotor(t: Truth, rng: Rng, level: float) -> Change:
    x = np.zeros(4)
    for a in rng.choice(4, size=int(rng.choice([1, 2, 4], p=[0.5, 0.3, 0.2])), replace=False):
        x[a] = size(level, 1e-6, 80e-6) * sign(rng) * float(rng.uniform(0.7, 1.0))
    t.plant["offset"] = x
    return {"x0": x.tolist()}


def thermal_drift(t: Truth, rng: Rng, level: float) -> Change:
    e = size(level, 6e-4, 0.1)
    kind = str(rng.choice(["gap", "k"]))
    t.drift = (-e if kind == "k" else 0.0, e if kind == "gap" else 0.0, float(rng.choice([0.3, 1.0, 20.0])))
    which = rng.choice(["all", "bearing", "axis"], p=[0.6, 0.25, 0.15])
    if which != "all":
        hot, end = int(rng.integers(4)), np.arange(4) % 2
        t.drifting = 1.0 * (end == hot % 2 if which == "bearing" else np.arange(4) == hot)
    return {
        "kind": kind,
        "relative": e,
        "time_constant_of_campaign": t.drift[2],
        "share_of_axes": t.drifting.tolist(),
    }


def magnetic_cross_coupling(t: Truth, rng: Rng, level: float) -> Change:
    e = size(level, 2e-4, 0.06) * sign(rng)
    kind = str(rng.choice(["rotation", "symmetric", "rotation_exact"]))
    m = np.eye(4)
    if kind == "rotation_exact":
        m *= np.cos(e)
    for end in (0, 1):
        m[end, end + 2] = -np.sin(e) if kind == "rotation_exact" else (-e if kind == "rotation" else e)
        m[end + 2, end] = np.sin(e) if kind == "rotation_exact" else e
    t.plant["force_mix"] = m
    return {"xy_mag": e, "kind": kind}


def rotor_inertia(t: Truth, rng: Rng, level: float) -> Change:
    e = size(level, 0.015, 0.2) * sign(rng)
    kind = str(rng.choice(["inertia", "mass", "both"]))
    if kind != "inertia":
        t.mass *= 1 + e
    if kind != "mass":
        t.inertia *= 1 + e
    return {"kind": kind, "relative": e, "mass": t.mass, "inertia": t.inertia}


def extra_flexible_mode(t: Truth, rng: Rng, level: float) -> Change:
    hz = float(np.exp(rng.uniform(np.log(60), np.log(1400))))
    a = size(level, 1.5e-3, 0.09) * np.sqrt(280.0 / t.mass)
    at_b = a * rng.uniform(0.4, 1.0, 2) * np.array([1.0, sign(rng)])
    at_s = at_b * rng.uniform(0.7, 1.3, 2) * (sign(rng) if rng.random() < 0.3 else 1.0)
    zeta = float(np.exp(rng.uniform(np.log(1e-3), np.log(2e-2))))
    t.modes = [*t.modes, (2 * np.pi * hz, zeta, tuple(at_b.tolist()), tuple(at_s.tolist()))]
    return {"hz": hz, "zeta": zeta, "bearings": at_b.tolist(), "sensors": at_s.tolist()}


def modal_damping(t: Truth, rng: Rng, level: float) -> Change:
    factor = size(level, 3.0, 15.0)
    which = int(rng.choice([0, 1, 2]))
    t.modes = [
        (w, z * factor if which in (2, k) else z, b, s) if k < 2 else (w, z, b, s)
        for k, (w, z, b, s) in enumerate(t.modes)
    ]
    return {"factor": factor, "modes": [0, 1] if which == 2 else [which]}


def support_resonance(t: Truth, rng: Rng, level: float) -> Change:
    t.housing = {
        "mass": size(level, 500.0, 2.5) * t.mass,
        "hz": float(np.exp(rng.uniform(np.log(15), np.log(800)))),
        "zeta": float(np.exp(rng.uniform(np.log(5e-3), np.log(8e-2)))),
    }
    law = rng.random()
    t.housing |= {"each": bool(law < 0.35), "ratio": float(rng.uniform(0.9, 1.1))}
    if law > 0.65:
        t.housing |= _rocking(t, rng)
    return {f"house_{k}": v for k, v in t.housing.items()}


def _rocking(t: Truth, rng: Rng) -> Change:
    """A housing that rocks, too: its inertia, centre and springs, as shares of half the distance of the bearings."""
    half, h = (t.d[0] + t.d[1]) / 2, t.housing or {}
    return {
        "rocks": True,
        "inertia": h["mass"] * (half * float(rng.uniform(0.6, 1.4))) ** 2,
        "tilt_hz": h["hz"] * float(np.exp(rng.uniform(np.log(0.5), np.log(2.5)))),
        "tilt_zeta": float(np.exp(rng.uniform(np.log(5e-3), np.log(8e-2)))),
        "centre_m": half * float(rng.uniform(-0.5, 0.5)),
        "spring_m": half * float(rng.uniform(-0.4, 0.4)) if rng.random() < 0.5 else 0.0,
    }


def touchdown_contact(t: Truth, rng: Rng, level: float) -> Change:
    gap = size(level, 25e-6, 7e-6)
    k, both = size(float(rng.random()), 3e5, 5e6) * t.mass / 280.0, bool(rng.random() < 0.6)
    t.plant.update(stop_gap=on_axes(some_axes(rng), gap, np.inf), stop_stiffness=k, stop_both=int(both))
    t.plant["stop_damping"] = float(rng.choice([0.0, 50.0]))
    return {"clearance": gap, "stiffness": k, "both_sides": both}


def sensor_lag(t: Truth, rng: Rng, level: float) -> Change:
    lag = size(level, 0.4e-6, 30e-6)
    if rng.random() < 0.6 and lag > 3e-6:  # a faster pole is a delay to RK4 and to anyone
        t.plant["sensor_w"] = four(1 / lag)
        return {"sensor_hz": 1 / lag / (2 * np.pi)}
    t.loop["sensor_delay"] = lag
    return {"sensor_delay": lag}


def sensor_gain(t: Truth, rng: Rng, level: float) -> Change:
    axis, e = int(rng.integers(4)), size(level, 0.025, 0.15) * sign(rng)
    t.loop["sensor_gain"] = on_axes([axis], 1 + e, 1.0)
    return {"axis": axis, "relative": e}


def sensor_position(t: Truth, rng: Rng, level: float) -> Change:
    shift = size(level, 2.5e-3, 20e-3) * sign(rng) * np.where(rng.random(2) < 0.7, 1.0, 0.0)
    if not shift.any():
        shift[0] = size(level, 2.5e-3, 20e-3)
    if rng.random() < 0.4:
        shift[1] *= -1
    moved = bool(rng.random() < 0.4)
    if moved:  # the shape where the sensor now is, by the slope between bearing and sensor
        modes = []
        for w, z, b, s in t.modes:
            slope = [(s[k] - b[k]) / (t.s[k] - t.d[k]) for k in (0, 1)]
            modes.append((w, z, b, tuple(s[k] + slope[k] * shift[k] for k in (0, 1))))
        t.modes = modes
    t.s = (t.s[0] + float(shift[0]), t.s[1] + float(shift[1]))
    return {"sA": t.s[0], "sB": t.s[1], "shift": shift.tolist(), "shapes_move": moved}


def mains_interference(t: Truth, rng: Rng, level: float) -> Change:
    hz = 50.0 * int(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1]))
    if rng.random() < 0.5:
        a = size(level, 3e-4, 0.1)
        t.plant.update(hum_a=four(a), hum_hz=hz, hum_phase=float(rng.uniform(0, 6)))
        return {"current_a": a, "hz": hz}
    a = size(level, 2e-9, 1.5e-6)
    t.loop.update(hum_m=four(a), hum_hz=hz, hum_phase=float(rng.uniform(0, 6)))
    return {"sensor_m": a, "hz": hz}


def gyroscopic_coupling(t: Truth, rng: Rng, level: float) -> Change:
    law = rng.random()
    if law < 0.35:
        t.gyroscopic = t.polar * size(level, 0.03, 5.0)
        return {"kind": "polar inertia", "polar_inertia_kgm2": t.gyroscopic}
    if law < 0.65:
        return _whole_shaft(t, rng, t.polar * size(level, 0.02, 1.5))
    # a disc where the modes have a slope: it couples all that tilts there
    slope = np.zeros(7)
    slope[1], slope[2:4] = 1.0, rng.choice([-1.0, 1.0], 2) * rng.uniform(0.1, 1.0, 2)
    disc = size(level, 0.02, 0.6) * t.mass / 280.0
    t.plant["gyro"] = lambda g: g + disc * np.outer(slope, slope)
    return {"kind": "disc", "polar_inertia_kgm2": disc, "slopes": slope[1:4].tolist()}


def _whole_shaft(t: Truth, rng: Rng, polar: float) -> Change:
    """Every slice turns: as its mass is spread, and in some rotors a wheel somewhere has a part of it."""
    z, mass = stations(t)
    wheel, at = float(rng.uniform(0.1, 0.7)) * (rng.random() < 0.6), int(rng.integers(len(z)))
    matrix = gyroscopic_matrix(t, polar * ((1 - wheel) * mass / mass.sum() + wheel * (np.arange(len(z)) == at)))
    # a slice resists tilting with half its polar inertia, a part of what tilt and modes weigh: G is below 2 M; here M
    root = np.sqrt(np.array([t.inertia, 1.0, 1.0]))
    most = np.linalg.eigvalsh(matrix[1:4, 1:4] / np.outer(root, root))[-1]
    polar, matrix = polar / max(1.0, most), matrix / max(1.0, most)
    t.plant["gyro"] = lambda g: g + matrix
    return {
        "kind": "whole shaft",
        "polar_inertia_kgm2": polar,
        "share_of_wheel": wheel,
        "wheel_at_m": float(z[at]),
        "of_tilt_and_modes": matrix[1:4, 1:4].tolist(),
    }


def internal_damping(t: Truth, rng: Rng, level: float) -> Change:
    zeta, which = size(level, 5e-4, 8e-3), int(rng.choice([0, 1, 2]))
    inner = np.zeros(7)
    for k in (0, 1):
        inner[2 + k] = 2 * zeta * t.modes[k][0] * (which in (2, k))
    t.plant["inner"] = inner
    return {"damping_ratio": zeta, "modes": [0, 1] if which == 2 else [which]}


def cross_coupled_stiffness(t: Truth, rng: Rng, level: float) -> Change:
    k = size(level, 2e3, 3e5) * sign(rng) * t.mass / 280.0
    at = str(rng.choice(["both", "A", "B", "between"]))
    where = np.array([at in ("both", "A"), at in ("both", "B"), at == "between"], dtype=float)
    by_speed = bool(t.spin and rng.random() < 0.5)
    if by_speed:  # the fluid is carried round
        t.plant["seal_by_speed"] = k / t.spin * where
    else:
        t.plant["seal"] = k * where
    return {"k_n_per_m": k, "at": at, "by_speed": by_speed}


def runout(t: Truth, rng: Rng, level: float) -> Change:
    a = size(level, 30e-9, 5e-6)
    twice = a * float(rng.choice([0.0, 0.3]))
    uneven = rng.uniform(0.7, 1.3, 4) if rng.random() < 0.3 else np.ones(4)
    t.loop.update(runout=np.stack([a * uneven, twice * uneven]), runout_phase=float(rng.uniform(0, 6)))
    return {"once_m": a, "twice_m": twice, "of_sensors": uneven.tolist()}


TURNING = {"gyroscopic_coupling", "internal_damping", "runout"}
"""Effects that a rotor at rest does not show, or not apart from others."""

CATALOGUE = {
    f.__name__: f
    for f in (
        loop_delay,
        logging_offset,
        amplifier_bandwidth,
        amplifier_voltage_limit,
        channel_crosstalk,
        controller_mismatch,
        eddy_currents,
        magnetic_saturation,
        magnetic_hysteresis,
        off_centre_rotor,
        thermal_drift,
        magnetic_cross_coupling,
        rotor_inertia,
        extra_flexible_mode,
        modal_damping,
        support_resonance,
        touchdown_contact,
        sensor_lag,
        sensor_gain,
        sensor_position,
        mains_interference,
        gyroscopic_coupling,
        internal_damping,
        cross_coupled_stiffness,
        runout,
    )
}

PATH = {
    "controller_mismatch": "controller",
    "logging_offset": "controller",
    "loop_delay": "amplifier",
    "amplifier_bandwidth": "amplifier",
    "amplifier_voltage_limit": "amplifier",
    "channel_crosstalk": "amplifier",
    "mains_interference": "additive",
    "runout": "additive",
}
"""The rest act in the plant."""


def clipped_log(t: Truth, rng: Rng, level: float) -> Change:
    t.log["clip"] = size(level, 13e-6, 7e-6)
    return {"_clip": t.log["clip"]}


def cubic_sensor(t: Truth, rng: Rng, level: float) -> Change:
    c = size(level, 1e6, 4e8) * sign(rng)
    t.loop["sensor_cubic"] = four(c)
    return {"cubic_per_m2": c}


def dead_band(t: Truth, rng: Rng, level: float) -> Change:
    band = size(level, 2e-4, 25e-3)
    t.plant["dead_band"] = four(band)
    return {"dead_band_a": band}


def friction(t: Truth, rng: Rng, level: float) -> Change:
    force = size(level, 0.03, 8.0) * t.mass / 280.0
    t.plant.update(friction=on_axes(some_axes(rng), force), friction_stiffness=1e6 * t.mass / 280.0)
    return {"friction_n": force, "presliding_n_per_m": 1e6}


def held_samples(t: Truth, rng: Rng, level: float) -> Change:
    t.log["held"] = int(rng.choice([4, 7, 11, 23]))
    return {"every": t.log["held"]}


def coarse_steps(t: Truth, rng: Rng, level: float) -> Change:
    step = size(level, 0.1e-6, 2e-6)
    in_loop = bool(rng.random() < 0.3)
    if in_loop:
        t.loop["sensor_step"] = step
    else:
        t.log["step"] = step
    return {"step_m": step, "in_loop": in_loop}


def stiffening_mode(t: Truth, rng: Rng, level: float) -> Change:
    cubic, k = np.zeros((2, 7)), int(rng.integers(2))
    # of the modal coordinate, m sqrt(kg): a tenth of a per cent of the frequency at its peak is plainly seen
    cubic[:, 2 + k] = size(level, 2e5, 2e7) * sign(rng)
    t.plant["cubic"] = cubic
    return {"mode": k, "cubic": float(cubic[0, 2 + k])}


def swinging_stiffness(t: Truth, rng: Rng, level: float) -> Change:
    e = size(level, 0.01, 0.15)
    t.plant.update(ks_swing=e, ks_swing_hz=37.0)
    return {"relative": e, "hz": 37.0}


def amplitude_damping(t: Truth, rng: Rng, level: float) -> Change:
    d, k = np.zeros((2, 7)), int(rng.integers(2))
    d[:, 2 + k] = size(level, 5e8, 1e11)
    t.plant["square_damping"] = d
    return {"mode": k, "per_q2": float(d[0, 2 + k])}


def demodulation_phase(t: Truth, rng: Rng, level: float) -> Change:
    axis, phase = int(rng.integers(4)), size(level, 0.02, 0.4) * sign(rng)
    t.log["phase"] = (axis, phase)
    return {"axis": axis, "phase_rad": phase}


def loose_connector(t: Truth, rng: Rng, level: float) -> Change:
    axis, e = int(rng.integers(4)), size(level, 0.02, 0.2) * sign(rng)
    at = float(rng.uniform(0.2, 0.6))
    t.log["loose"] = (axis, at, 1 + e)
    return {"axis": axis, "from_share_of_campaign": at, "relative": e}


def filtered_current_log(t: Truth, rng: Rng, level: float) -> Change:
    hz = size(level, 9e3, 1.5e3)
    t.log["current_filter"] = hz
    return {"current_log_hz": hz}


def limited_drive(t: Truth, rng: Rng, level: float) -> Change:
    """The current's command is cut off, at each amplifier."""
    limit = size(level, 0.6, 0.12)
    t.plant["drive_limit"] = four(limit)
    return {"limit_a": limit}


def cable_resonance(t: Truth, rng: Rng, level: float) -> Change:
    """A share of each amplifier's drive goes through a resonant filter."""
    share, hz = size(level, 1e-3, 0.1), float(np.exp(rng.uniform(np.log(150), np.log(900))))
    t.plant.update(cable_share=four(share), cable_w=2 * np.pi * hz, cable_zeta=float(rng.uniform(0.02, 0.2)))
    return {"share": share, "hz": hz, "damping_ratio": t.plant["cable_zeta"]}


def rubber_ring(t: Truth, rng: Rng, level: float) -> Change:
    """A soft ring around the shaft at some bearings: a stiffness that grows by the square of the swing."""
    cubic = size(level, 1e-3, 0.3) * float(np.mean(t.ks)) / 1e-5**2
    t.plant["ring_cubic"] = on_axes(some_axes(rng), cubic)
    return {"cubic_n_per_m3": t.plant["ring_cubic"].tolist()}


def ring_damping(t: Truth, rng: Rng, level: float) -> Change:
    """A damper beside some bearings, as a fluid in the gap would be."""
    damping = size(level, 0.003, 0.3) * np.sqrt(float(np.mean(t.ks)) * t.mass)
    t.plant["ring_damping"] = on_axes(some_axes(rng), damping)
    return {"damping_ns_per_m": t.plant["ring_damping"].tolist()}


UNKNOWN = {
    f.__name__: f
    for f in (
        clipped_log,
        cubic_sensor,
        dead_band,
        friction,
        held_samples,
        coarse_steps,
        stiffening_mode,
        swinging_stiffness,
        amplitude_damping,
        demodulation_phase,
        loose_connector,
        filtered_current_log,
        limited_drive,
        cable_resonance,
        rubber_ring,
        ring_damping,
    )
}
