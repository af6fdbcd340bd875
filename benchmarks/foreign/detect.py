"""How plainly an effect shows: the whitened norm of what it changes in the data, beyond what wrong values could."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from foreign.rig import TS, Truth, pid, small_signal

Setter = Callable[[Truth, float], None]


def _moved(name: str, axis: int) -> Setter:
    def apply(t: Truth, x: float) -> None:
        setattr(t, name, getattr(t, name) * (1 + x * (np.arange(4) == axis)))

    return apply


def _scaled(table: str, name: str, axis: int) -> Setter:
    def apply(t: Truth, x: float) -> None:
        getattr(t, table)[name] = getattr(t, table).get(name, np.ones(4)) * (1 + x * (np.arange(4) == axis))

    return apply


def _mode(k: int, entry: int, end: int) -> Setter:
    def apply(t: Truth, x: float) -> None:
        mode = list(t.modes[k])
        value = np.array(mode[entry], dtype=float)
        mode[entry] = value * (1 + x) if entry < 2 else tuple(value * (1 + x * (np.arange(2) == end)))
        t.modes = [tuple(mode) if n == k else m for n, m in enumerate(t.modes)]

    return apply


def _whole(name: str) -> Setter:
    return lambda t, x: setattr(t, name, getattr(t, name) * (1 + x))


def _sensor(end: int) -> Setter:
    return lambda t, x: setattr(t, "s", tuple(s + x * (k == end) for k, s in enumerate(t.s)))


def nuisances(t: Truth, tolerance: dict) -> list[tuple[Setter, float]]:
    """What a datasheet may be wrong in, and by how much (one sigma)."""
    out: list[tuple[Setter, float]] = []
    for axis in range(4):
        out += [
            (_moved("ki", axis), tolerance["current_stiffness"]),
            (_moved("ks", axis), tolerance["position_stiffness"]),
            (_moved("amp_w", axis), tolerance["amplifier_frequency"]),
            (_moved("amp_zeta", axis), tolerance["amplifier_damping"]),
            (_scaled("plant", "amp_gain", axis), tolerance["amplifier_gain"]),
            (_scaled("loop", "sensor_gain", axis), tolerance["sensor_gain"]),
        ]
    out += [(_whole("mass"), tolerance["mass"]), (_whole("inertia"), tolerance["transverse_inertia"])]
    out += [(_sensor(end), tolerance["sensor_position_m"]) for end in (0, 1)]
    for k in range(len(t.modes)):
        out += [(_mode(k, 0, 0), tolerance["mode_frequency"]), (_mode(k, 1, 0), tolerance["mode_damping"])]
        out += [(_mode(k, entry, end), tolerance["mode_shape"]) for entry in (2, 3) for end in (0, 1)]
    return out


def _linear(t: Truth, parts: list[tuple[Setter, float]], theta: np.ndarray, data: list[dict], c: list) -> list:
    """Controller residual, I, Y at harmonic 1 of the small-signal rig with its values moved: [(P, 12)]."""
    t = copy.deepcopy(t)
    for (apply, sigma), x in zip(parts, theta, strict=True):
        apply(t, sigma * x)
    loops = {spin: small_signal(*replace(t, spin=spin).build()) for spin in {d["speed_rad_s"] for d in data}}
    out = []
    for d, ck in zip(data, c, strict=True):
        closed = loops[d["speed_rad_s"]]
        lines = len(d["axis"]) // 4
        g = closed.response(d["frequency_hz"][:lines])
        g[:, :4] += ck[:lines, None, None] * g[:, 8:] - np.eye(4)
        out.append(np.concatenate([g[:, :, k] for k in range(4)]) * d["amplitude_a"][:, None])
    return out


def _stack(d: dict, h: int, c: np.ndarray) -> np.ndarray:
    """(P, B, 12): controller residual, I, Y at harmonic h."""
    u = d["U"][:, :, h] - d["R"][:, :, h] + c[:, None, None] * d["Y"][:, :, h]
    return np.concatenate([u, d["I"][:, :, h], d["Y"][:, :, h]], axis=2).astype(complex)


def detectability(plain: Truth, data: list[dict], without: list[dict], tolerance: dict) -> float:
    """Norm of the effect's change over the noise's standard deviation, datasheet values refitted within tolerance.

    ``data`` and ``without`` are the experiment with and without the effect under the same noise. An upper bound: what
    magnets driven hard make of the change is not refitted, some 30 for a sensor gain 4 % off.
    """
    b, a = pid(**(plain.running or plain.control))  # else what moves y would seem to move the controller, too
    c = []
    for d in data:
        z = np.exp(2j * np.pi * d["frequency_hz"] * TS)
        c.append(np.polyval(b, z) / np.polyval(a, z))
    parts = nuisances(plain, tolerance)
    n, step = len(parts), 1e-3
    nominal = _linear(plain, parts, np.zeros(n), data, c)
    changes, roots, rest = [], [], 0.0
    for d, d0, ck in zip(data, without, c, strict=True):
        lines = len(d["axis"]) // 4
        here = _stack(d, 1, ck)
        blocks = here.shape[1]
        changes.append(here.mean(axis=1) - _stack(d0, 1, ck).mean(axis=1))
        roots.append(_whiteners(here, lines))
        for h in (0, 2, 3):
            other, base = _stack(d, h, ck), _stack(d0, h, ck)
            var = np.median((other.var(axis=1, ddof=1) / blocks).reshape(4, lines, 12), axis=0) / 0.87
            rest += float((abs(other.mean(axis=1) - base.mean(axis=1)) ** 2 / np.tile(var + 1e-30, (4, 1))).sum())

    def whitened(x: list) -> np.ndarray:
        # proper complex noise of total variance 1: each real part has variance 1/2
        y = np.concatenate([np.einsum("pab,pb->pa", r, e).ravel() for r, e in zip(roots, x, strict=True)])
        return np.sqrt(2) * np.concatenate([y.real, y.imag])

    columns = []
    for k in range(n):
        moved = _linear(plain, parts, step * np.eye(n)[k], data, c)
        columns.append(whitened([(m - m0) / step for m, m0 in zip(moved, nominal, strict=True)]))
    j = np.array(columns).T
    theta, damping = np.zeros(n), 1.0
    y = whitened(changes)
    best = float(y @ y)
    normal, own = j.T @ j, np.diag(j.T @ j)
    for _ in range(20):  # Levenberg and Marquardt with the Jacobian of the start: an upper bound is enough
        trial = theta + np.linalg.solve(normal + np.eye(n) + damping * np.diag(own), j.T @ y - theta)
        model = _linear(plain, parts, trial, data, c)
        left = whitened([e - (m - m0) for e, m, m0 in zip(changes, model, nominal, strict=True)])
        cost = float(left @ left + trial @ trial)
        if cost < best:
            small = best - cost < 1e-3 * best + 0.1
            best, theta, y, damping = cost, trial, left, damping / 5
            if small and damping < 1e-4:
                break
        else:
            damping *= 4
    return float(np.sqrt(best + 2 * rest))


def _whiteners(blocks: np.ndarray, lines: int) -> np.ndarray:
    """(P, 12, 12) whitening of the mean over blocks, the covariance pooled over inputs and neighbouring lines."""
    noise = blocks - blocks.mean(axis=1, keepdims=True)
    n = blocks.shape[1]
    # a signal that one coarse step of a converter swallows does not scatter at all
    least = 1e-3 * np.sqrt((abs(noise) ** 2).mean(axis=(0, 1))) + 1e-30
    out = np.empty((lines, 12, 12), dtype=complex)
    for line in range(lines):
        near = [m + lines * k for k in range(4) for m in range(max(0, line - 1), min(lines, line + 2))]
        e = noise[near].reshape(-1, 12)
        scale = np.maximum(np.sqrt((abs(e) ** 2).mean(axis=0)), least)
        cov = (e / scale).T @ (e / scale).conj() / (len(near) * (n - 1)) / n
        out[line] = np.linalg.inv(np.linalg.cholesky(cov + 1e-4 * np.eye(12) / n)) / scale
    return np.tile(out, (4, 1, 1))
