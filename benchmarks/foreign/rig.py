"""A foreign rig's parameters, the reference values, other rotors, and the small-signal check that it levitates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import eigh, expm
from scipy.signal import bilinear

from foreign.physics import C0, F0, I0, L0, N_LADDER, N_PLAYS, N_STATES, P0, PLANT, S0, Z0, Loop, derivative

TS = 1e-4


def pid(kp: float, ki: float, kd: float, filter_hz: float, notch_hz: float, depth: float, width: float) -> tuple:
    """PID with filtered derivative and a biquad, Tustin: (b, a)."""
    wf, wn = 2 * np.pi * filter_hz, 2 * np.pi * notch_hz
    num = np.polymul([kp + kd * wf, kp * wf + ki, ki * wf], [1, 2 * depth * wn, wn**2])
    den = np.polymul([1, wf, 0], [1, 2 * width * wn, wn**2])
    b, a = bilinear(num, den, 1 / TS)
    return b, a


CONTROLLERS = {
    "reference": {"kp": 18e3, "ki": 36e3, "kd": 80.0, "filter_hz": 3e3, "notch_hz": 750.0, "depth": 0.2, "width": 0.7},
    "late": {"kp": 16e3, "ki": 36e3, "kd": 60.0, "filter_hz": 4e3, "notch_hz": 620.0, "depth": 0.2, "width": 0.8},
}


def four(value: float | list | np.ndarray) -> np.ndarray:
    return np.array(np.broadcast_to(value, 4), dtype=float)


def _absent() -> dict:
    """Fields of Plant where nothing but the plain rig is there."""
    return {
        "cubic": np.zeros((2, 7)),
        "square_damping": np.zeros((2, 7)),
        "offset": np.zeros(4),
        "saturation": 0,
        "sat_level": np.ones(4),
        "sat_power": 2.0,
        "play_share": np.zeros(4),
        "play_width": np.zeros(N_PLAYS),
        "ladder": 0,
        "ladder_pole": np.ones(N_LADDER),
        "ladder_gain": np.zeros(N_LADDER),
        "ladder_direct": 1.0,
        "force_mix": np.eye(4),
        "amp_gain": np.ones(4),
        "amp_extra": np.zeros(4),
        "slew": four(np.inf),
        "slew_resistive": np.zeros(4),
        "coil": 0,
        "coil_gain": np.zeros(4),
        "u_mix": np.eye(4),
        "dead_band": np.zeros(4),
        "drive_limit": four(np.inf),
        "cable_share": np.zeros(4),
        "cable_w": 1.0,
        "cable_zeta": 0.1,
        "ring_cubic": np.zeros(4),
        "ring_damping": np.zeros(4),
        "stop_gap": four(np.inf),
        "stop_stiffness": 0.0,
        "stop_damping": 0.0,
        "stop_both": 1,
        "friction": np.zeros(4),
        "friction_stiffness": 1.0,
        "ks_swing": 0.0,
        "ks_swing_hz": 37.0,
        "hum_a": np.zeros(4),
        "hum_hz": 50.0,
        "hum_phase": 0.0,
        "sensor_w": np.zeros(4),
        "inner": np.zeros(7),
        "seal": np.zeros(3),
        "seal_by_speed": np.zeros(3),
    }


def _plain_loop() -> dict:
    """Fields of Loop beside the controllers, likewise."""
    return {
        "sample_time": TS,
        "delay": np.zeros(1),
        "sensor_delay": 0.0,
        "sensor_gain": np.ones(4),
        "sensor_cubic": np.zeros(4),
        "sensor_step": 0.0,
        "hum_m": np.zeros(4),
        "hum_hz": 50.0,
        "hum_phase": 0.0,
        "runout": np.zeros((2, 4)),
        "runout_phase": 0.0,
    }


class Stator(NamedTuple):
    """One way in which what bears magnets and sensors moves: where it takes them per unit, and on what spring."""

    at_bearings: np.ndarray
    at_sensors: np.ndarray
    inverse_mass: float
    w: float
    zeta: float


def stators(h: dict, d: tuple, s: tuple) -> list[Stator]:
    """One housing that shifts, one per bearing, or one that shifts and rocks."""
    if h.get("rocks"):
        return rocking(h, np.array([d[0], -d[1]]), np.array([s[0], -s[1]]))
    moved = np.eye(2) if h["each"] else np.ones((1, 2))
    w = 2 * np.pi * h["hz"] * np.array([1.0, h.get("ratio", 1.0)])
    return [Stator(m, m, 1 / h["mass"], float(w[k]), h["zeta"]) for k, m in enumerate(moved)]


def rocking(h: dict, bearings: np.ndarray, sensors: np.ndarray) -> list[Stator]:
    """Both modes of a rigid housing on springs, of unit modal mass; places in m from the rotor's centre of gravity.

    Its mass and inertia are at ``centre_m``, its springs and dampers across ``spring_m`` beyond that: a force away from
    there tilts it, against springs and dampers of its own, and with ``spring_m`` either mode shifts and tilts it.
    """
    mass = np.diag([h["mass"], h["inertia"]])
    across, tilting = np.array([1.0, h["spring_m"]]), np.array([0.0, 1.0])
    w, w_tilt = 2 * np.pi * h["hz"], 2 * np.pi * h["tilt_hz"]

    def joined(shift: float, tilt: float) -> np.ndarray:
        return h["mass"] * shift * np.outer(across, across) + h["inertia"] * tilt * np.outer(tilting, tilting)

    squares, shapes = eigh(joined(w**2, w_tilt**2), mass)
    damping = joined(2 * h["zeta"] * w, 2 * h["tilt_zeta"] * w_tilt)
    return [
        Stator(
            v[0] + v[1] * (bearings - h["centre_m"]),
            v[0] + v[1] * (sensors - h["centre_m"]),
            1.0,
            float(np.sqrt(square)),
            float(v @ damping @ v / (2 * np.sqrt(square))),  # what it couples between both modes is left out: light
        )
        for square, v in zip(squares, shapes.T, strict=True)
    ]


@dataclass
class Truth:
    """The rig as it is. Modes: (frequency rad/s, zeta, shape at bearings, shape at sensors); both planes alike."""

    mass: float = 280.0
    inertia: float = 10.87
    d: tuple = (0.418, 0.404)
    s: tuple = (0.484, 0.470)
    modes: list = field(
        default_factory=lambda: [
            (3097.0, 0.001, (0.0806, 0.0457), (0.080, 0.1416)),
            (5708.0, 0.001, (0.21, 0.0827), (0.20, 0.0189)),
        ]
    )
    ki: np.ndarray = field(default_factory=lambda: np.array([181.0, 186.0, 184.0, 198.0]))
    ks: np.ndarray = field(default_factory=lambda: np.array([1.68e6, 1.73e6, 1.69e6, 1.88e6]))
    bias: float = 2.75
    amp_w: np.ndarray = field(default_factory=lambda: np.array([9244.0, 9640.0] * 2))
    amp_zeta: np.ndarray = field(default_factory=lambda: np.array([0.8068, 0.8308] * 2))
    control: dict = field(default_factory=lambda: dict(CONTROLLERS["reference"]))
    noise_y: float = 20e-9
    noise_i: float = 2e-3
    limit_y: float = 80e-6
    limit_i: float = 6.0
    plant: dict = field(default_factory=dict)
    """Fields of Plant that an effect replaces; a callable gets the plain value."""
    loop: dict = field(default_factory=dict)
    running: dict | None = None
    """The controller that really runs, when it is not the datasheet's."""
    housing: dict | None = None
    """mass, hz, zeta; each: one housing per bearing; rocks: see ``rocking``."""
    drift: tuple = (0.0, 0.0, 1.0)
    """(k, gap) relative change at the end, and the time constant as a share of the campaign."""
    drifting: np.ndarray = field(default_factory=lambda: np.ones(4))
    """Share of that in each axis."""
    log: dict = field(default_factory=dict)
    polar: float = 1.9
    """kg m^2, as the datasheet has it"""
    gyroscopic: float = 0.0
    """kg m^2 that acts, all of it where the rotor is rigid: the twin of a datasheet does not turn"""
    spin: float = 0.0
    """rad/s"""

    def build(self) -> tuple[np.ndarray, Loop]:
        """Plant and loop for the integrator."""
        values = self._coordinates() | self._magnets() | _absent() | {"spin": self.spin}
        for name, value in self.plant.items():
            values[name] = value(values[name]) if callable(value) else value
        plant = np.zeros(1, dtype=PLANT)
        for name, value in values.items():
            plant[name] = value
        ba = [pid(**(self.running or self.control))] * 4
        filters = {"b": np.array([b for b, _ in ba]), "a": np.array([a for _, a in ba])}
        return plant, Loop(**(filters | _plain_loop() | {"spin": self.spin} | self.loop))

    def _coordinates(self) -> dict:
        """What bearings and sensors see of rigid body, modes and housings, and how these are sprung."""
        tb, ts = np.zeros((2, 2, 7)), np.zeros((2, 2, 7))
        minv, w, zeta = np.zeros((2, 7)), np.zeros((2, 7)), np.zeros((2, 7))
        parts = stators(self.housing, self.d, self.s) if self.housing else []
        for plane in range(2):
            tb[plane, :, 0] = ts[plane, :, 0] = 1.0
            tb[plane, :, 1] = self.d[0], -self.d[1]
            ts[plane, :, 1] = self.s[0], -self.s[1]
            minv[plane, :2] = 1 / self.mass, 1 / self.inertia
            for j, (wj, zj, at_b, at_s) in enumerate(self.modes):
                tb[plane, :, 2 + j], ts[plane, :, 2 + j] = at_b, at_s
                minv[plane, 2 + j], w[plane, 2 + j], zeta[plane, 2 + j] = 1.0, wj, zj
            for k, part in enumerate(parts, 2 + len(self.modes)):
                tb[plane, :, k], ts[plane, :, k] = -part.at_bearings, -part.at_sensors
                minv[plane, k], w[plane, k], zeta[plane, k] = part.inverse_mass, part.w, part.zeta
        nq = 2 + len(self.modes) + len(parts)
        gyro = np.zeros((7, 7))
        gyro[1, 1] = self.gyroscopic
        seal_at = np.stack([tb[0, 0], tb[0, 1], (tb[0, 0] + tb[0, 1]) / 2])
        return {"nq": nq, "tb": tb, "ts": ts, "minv": minv, "w": w, "zeta": zeta, "gyro": gyro, "seal_at": seal_at}

    def _magnets(self) -> dict:
        gap = self.bias * self.ki / self.ks
        return {
            "bias": four(self.bias),
            "gap": gap,
            "k": self.ki * gap**2 / (4 * self.bias),
            "amp_w": np.array(self.amp_w),
            "amp_zeta": np.array(self.amp_zeta),
        }


def _in_use(plant: np.ndarray | np.void) -> np.ndarray:
    """(N_STATES,) states that belong to something: the rest would show as eigenvalues at 1."""
    used = np.zeros(N_STATES, dtype=bool)
    used[:14] = used[14:28] = (plant["minv"] > 0).ravel()
    used[I0:P0] = True
    used[P0:S0], used[S0:Z0] = plant["amp_extra"] > 0, plant["sensor_w"] > 0  # friction keeps a position: eigenvalue 1
    used[C0:F0] = np.tile(plant["cable_share"] > 0, 2)
    used[F0:L0] = plant["coil"] > 0
    half = L0 + 4 * N_LADDER
    used[L0:half], used[half:] = plant["ladder"] > 0, plant["ladder"] == 2
    return used


@njit(cache=True)
def _slope(plants, s, u, plays, dk, dg, ds):
    derivative(plants[0], 0.0, s, u, plays, dk, dg, ds)


class Closed(NamedTuple):
    """Closed loop over one sample: state matrix, input r, and what reads u, i and y from the state (u: plus r)."""

    a: np.ndarray
    b: np.ndarray
    u: np.ndarray
    i: np.ndarray
    y: np.ndarray

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """U, I, Y per R: (F, 12, 4)."""
        w, v = np.linalg.eig(self.a)
        right = np.linalg.solve(v, self.b.astype(complex))
        left = np.concatenate([self.u, self.i, self.y]) @ v
        z = np.exp(2j * np.pi * frequency * TS)
        out = np.einsum("ak,fk,kb->fab", left, 1 / (z[:, None] - w), right, optimize=True)
        out[:, :4] += np.eye(4)
        return np.asarray(out)


def small_signal(plant: np.ndarray, loop: Loop) -> Closed:
    """Closed loop over one sample by finite differences; a sensor's delay is counted with the drive's."""
    plants = plant.copy()
    plants["dead_band"] = 0.0
    plant = plants[0]
    n = N_STATES
    plays, zero, u0 = np.zeros((4, N_PLAYS)), np.zeros(n), np.zeros(4)
    scale = np.full(n, 1e-8)
    scale[I0:S0] = scale[C0:L0] = 1e-5

    def slope(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        ds = np.zeros(n)
        _slope(plants, s, u, plays, np.ones(4), np.ones(4), ds)
        return ds

    a = np.array(
        [(slope(zero + e, u0) - slope(zero - e, u0)) / (2 * h) for e, h in zip(np.diag(scale), scale, strict=True)]
    ).T
    b = np.array([(slope(zero, u0 + e) - slope(zero, u0 - e)) / 2e-3 for e in 1e-3 * np.eye(4)]).T
    used = _in_use(plant)
    a, b = a[np.ix_(used, used)], b[used]
    sensed = np.zeros((4, n))
    for k in range(4):
        if plant["sensor_w"][k] > 0:
            sensed[k, S0 + k] = loop.sensor_gain[k]
        else:
            sensed[k, (k // 2) * 7 : (k // 2) * 7 + 7] = loop.sensor_gain[k] * plant["ts"][k // 2, k % 2]
    c, n = sensed[:, used], int(used.sum())
    tau = float(loop.delay[0]) + loop.sensor_delay
    whole, rest = int(tau / TS), tau % TS

    def held(t: float) -> tuple[np.ndarray, np.ndarray]:
        m = expm(np.block([[a, b], [np.zeros((4, n + 4))]]) * t)
        return m[:n, :n], m[:n, n:]

    ad, _ = held(TS)
    a2, b2 = held(TS - rest)
    b1 = a2 @ held(rest)[1]
    m = loop.b.shape[1] - 1
    nc, nd = 4 * m, 4 * (whole + 1)
    big = np.zeros((n + nc + nd, n + nc + nd))
    ac, bc, cc = np.zeros((nc, nc)), np.zeros((nc, 4)), np.zeros((4, nc))
    for k in range(4):  # transposed direct form
        at = slice(m * k, m * k + m)
        ac[at, at] = np.eye(m, k=1)
        ac[at, m * k] -= loop.a[k, 1:]
        bc[at, k] = loop.b[k, 1:] - loop.a[k, 1:] * loop.b[k, 0]
        cc[k, m * k] = 1.0
    d = np.diag(loop.b[:, 0])
    big[:n, :n] = ad
    big[n : n + nc, :n] = -bc @ c
    big[n : n + nc, n : n + nc] = ac
    u_of = np.zeros((4, n + nc + nd))
    u_of[:, :n], u_of[:, n : n + nc] = -d @ c, cc
    r_to = np.zeros((n + nc + nd, 4))
    now = slice(n + nc, n + nc + 4)  # the queue's newest entry: the u of the sample before
    if whole == 0:
        big[:n, now] += b1
        big[:n] += b2 @ u_of
        r_to[:n] += b2
    else:
        big[:n, n + nc + 4 * whole :] += b1
        big[:n, n + nc + 4 * (whole - 1) : n + nc + 4 * whole] += b2
    big[now] += u_of
    r_to[now] += np.eye(4)
    for q in range(whole):
        big[n + nc + 4 * (q + 1) : n + nc + 4 * (q + 2), n + nc + 4 * q : n + nc + 4 * (q + 1)] = np.eye(4)
    read = np.zeros((4, n + nc + nd))
    read[:, :n] = c
    current = np.zeros((4, n + nc + nd))
    current[:, :n] = np.eye(N_STATES)[I0 : I0 + 4][:, used]
    return Closed(big, r_to, u_of, current, read)


def slowest(big: np.ndarray) -> float:
    """Largest modulus of the closed loop's eigenvalues."""
    return float(np.abs(np.linalg.eigvals(big)).max())
