"""The experiment on a foreign rig: which tones, how long, its own lock-in, and what a bad log does to the records."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from foreign.physics import run_tone
from foreign.rig import TS, Truth, small_signal

FS = 1 / TS
BLOCKS = 6
HARMONICS = 4
PROFILE_HZ = [9.0, 38.0, 42.4, 47.3, 59.0, 73.7, 92.0, 103.0, 160.0, 249.0, 347.0, 541.0, 754.0, 1050.0]
PROFILE_A = [0.1222, 0.149, 0.1626, 0.1867, 0.235, 0.2833, 0.3316, 0.3537, 0.4142, 0.4746, 0.512, 0.549, 0.5765, 0.6]


class LeftLimits(Exception):
    """A tone took the rotor or the current past its limit."""


@dataclass
class Tones:
    """One sweep, every line at each of the four inputs."""

    periods: np.ndarray
    samples: np.ndarray
    amplitude: np.ndarray
    spin: float = 0.0
    """rad/s"""

    @property
    def frequency(self) -> np.ndarray:
        """Hz."""
        return self.periods * FS / self.samples


def _grid(wanted_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whole periods in whole samples, blocks of some 50 ms or one period."""
    periods = np.maximum(1, np.round(wanted_hz * 0.05).astype(int))
    return periods, np.round(periods * FS / wanted_hz).astype(int)


def profile(frequency: np.ndarray, modes_hz: list[float]) -> np.ndarray:
    """Amplitudes over frequency: rising with the amplifier's and rotor's roll-off, a quarter beside a mode."""
    a = np.interp(np.log(frequency), np.log(PROFILE_HZ), PROFILE_A)
    for f in modes_hz:
        a = np.where(abs(frequency / f - 1) < 0.025, a / 4, a)
    return a


def plan(
    truth: Truth, rng: np.random.Generator, factor: float, peak_m: float = 15e-6, other_spin: float | None = None
) -> tuple[Tones, Tones]:
    """Main sweep (62 lines, dense beside the modes) and another of 18 lines at ``factor`` times its amplitude.

    Both at the rotor's own speed, but for ``other_spin``, rad/s.
    """
    modes = [m[0] / (2 * np.pi) for m in truth.modes[:2]]
    dense = [f * (1 + x) for f in modes for x in np.linspace(-0.021, 0.021, 10)]
    lines = np.unique(np.concatenate([np.geomspace(9.0, 1050.0, 42), dense]))
    k, n = _grid(lines)
    f = k * FS / n
    k, n = k[np.argsort(f)], n[np.argsort(f)]
    f = np.sort(f)
    closed = small_signal(*truth.build())
    a = profile(f, modes)
    a *= min(1.5, peak_m / (abs(closed.response(f)[:, 8:]).max(axis=(1, 2)) * a).max())
    top = a / profile(f, modes)
    k2, n2 = _grid(np.sort(np.exp(rng.uniform(np.log(10), np.log(1000), 18))))
    f2 = k2 * FS / n2
    there = truth.spin if other_spin is None else other_spin
    return Tones(k, n, a, truth.spin), Tones(k2, n2, profile(f2, modes) * top[0] * factor, there)


def spoil(log: dict, u: np.ndarray, i: np.ndarray, y: np.ndarray, share: float) -> tuple:
    """What the logger, not the loop, does wrong; ``share`` is how far the campaign has come."""
    if "offset" in log:
        u = np.roll(u, -int(log["offset"]), axis=0)
    if "clip" in log:
        y = np.clip(y, -log["clip"], log["clip"])
    if "held" in log:
        y = y.copy()
        y[log["held"] :: log["held"]] = y[log["held"] - 1 : -1 : log["held"]][: len(y[log["held"] :: log["held"]])]
    if "step" in log:
        y = log["step"] * np.round(y / log["step"])
    if "current_filter" in log:
        w = 2 * np.pi * log["current_filter"] * TS
        out = np.empty_like(i)
        state = i[0]
        g = 1 - np.exp(-w)
        for n in range(len(i)):
            state = state + g * (i[n] - state)
            out[n] = state
        i = out
    if "loose" in log and share > log["loose"][1]:
        y = y.copy()
        y[:, log["loose"][0]] *= log["loose"][2]
    return u, i, y


def lock_in(x: np.ndarray, periods: int, samples: int, start: int) -> np.ndarray:
    """(B, H, 4) complex amplitudes of consecutive blocks; time runs on from the tone's beginning."""
    out = np.empty((BLOCKS, HARMONICS, x.shape[1]), dtype=complex)
    for b in range(BLOCKS):
        n = start + b * samples + np.arange(samples)
        for h in range(HARMONICS):
            out[b, h] = (1 if h == 0 else 2) / samples * np.exp(-2j * np.pi * h * periods / samples * n) @ x[n]
    return out


def measure(
    truth: Truth,
    sweeps: tuple,
    rng: np.random.Generator,
    settle_s: float = 0.3,
    substeps: int = 3,
    records: bool = False,
) -> list:
    """Run the sweeps, input after input; a list of dicts in the layout of the experiment file.

    With ``records`` the settled signals themselves instead of their complex amplitudes.

    Raises
    ------
    LeftLimits
        A tone went past a limit.
    """
    plant, _ = truth.build()
    fastest = max(plant["amp_extra"].max(), plant["sensor_w"].max())
    substeps = max(substeps, int(np.ceil(fastest * TS / 2.2)))  # RK4 is stable up to 2.78
    limits = np.array([truth.limit_y, truth.limit_i])
    total = sum(4 * len(t.samples) for t in sweeps)
    done, clock, out = 0, 0.0, []
    for tones in sweeps:
        plant, loop = replace(truth, spin=tones.spin).build()
        p = 4 * len(tones.samples)
        data: dict = {name: np.empty((p, BLOCKS, HARMONICS, 4), dtype=np.complex64) for name in "RUIY"}
        logged: dict[str, list[np.ndarray]] = {name: [] for name in "ruiy"}
        data["speed_rad_s"] = tones.spin
        data["axis"] = np.repeat(np.arange(4), len(tones.samples)).astype(np.int8)
        data["frequency_hz"], data["amplitude_a"] = np.tile(tones.frequency, 4), np.tile(tones.amplitude, 4)
        for row in range(p):
            k = row % len(tones.samples)
            n = int(tones.samples[k])
            start = int(settle_s * FS)
            length = start + BLOCKS * n + 2
            share = done / total
            warm = (1 - np.exp(-share / truth.drift[2])) / (1 - np.exp(-1 / truth.drift[2]))
            r, u, i, y, lasted = run_tone(
                plant,
                loop,
                int(data["axis"][row]),
                float(tones.amplitude[k]),
                float(tones.frequency[k]),
                length,
                400,
                clock,
                1 + truth.drift[0] * warm * truth.drifting,
                1 + truth.drift[1] * warm * truth.drifting,
                truth.noise_y * rng.standard_normal((length, 4)),
                truth.noise_i * rng.standard_normal((length, 4)),
                substeps,
                limits,
            )
            if lasted < length:
                raise LeftLimits(f"tone {row} at {tones.frequency[k]:.1f} Hz, {1e6 * abs(y[lasted]).max():.0f} um")
            u, i, y = spoil(truth.log, u, i, y, share)
            for name, x in zip("RUIY", (r, u, i, y), strict=True):
                logged[name.lower()].append(x[start : start + BLOCKS * n])
                data[name][row] = lock_in(x, int(tones.periods[k]), n, start)
            if "phase" in truth.log:
                data["Y"][row, :, 1:, truth.log["phase"][0]] *= np.exp(1j * truth.log["phase"][1])
            done, clock = done + 1, clock + length * TS
        if records:
            data = {name: x for name, x in data.items() if name not in "RUIY"}
            data |= {name: np.concatenate(parts) for name, parts in logged.items()}
            data["sample_start"] = np.cumsum([0] + [len(x) for x in logged["r"]])
        out.append(data)
    return out
