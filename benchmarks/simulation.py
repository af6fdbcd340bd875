"""The rig in software: speed on one core, integration error, agreement with linear theory, and the field's own tools.

Run as ``python benchmarks/simulation.py``.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import _one_thread  # noqa: F401  before numpy
import control
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from sim import actuator, control_law
from sim.effects import effect
from sim.measured import measured_responses
from sim.reference import reference_rig
from sim.rig import Array, Noise, Rig
from sim.state_space import state_space
from sim.stepping import Simulation
from sim.twin import linear_model

T = 1e-4
REPEATS = 7


def cpu_seconds(job: Callable[[], object], repeats: int = REPEATS) -> tuple[float, float]:
    """Best and median CPU time of this process for one call."""
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        job()
        taken.append(time.process_time() - start)
    return min(taken), statistics.median(taken)


def shaking(n: int, amplitude_a: float) -> Array:
    """Every axis at its own frequency, (n, 4); 0.3 A makes about 20 um, the usual amplitude."""
    t = np.arange(n)[:, None] * T
    return np.asarray(amplitude_a * np.sin(2 * np.pi * np.array([17.0, 43.0, 170.0, 700.0]) * t))


def speed() -> None:
    print("Speed of the full rig: 4 axes, nonlinear magnets, 2 modes a plane, noise and quantisation, 4 steps a sample")
    every = reference_rig(speed_rad_s=100.0)
    for name in ("eddy_currents", "support_resonance", "magnetic_hysteresis", "magnetic_saturation"):
        every = effect(name).on(every)
    seconds = 20.0
    r = shaking(round(seconds / T), 0.2)
    for name, rig in {
        "reference rig": reference_rig(),
        "turning, 300 rad/s": reference_rig(speed_rad_s=300.0),
        "with saturation": effect("magnetic_saturation").on(reference_rig()),
        "turning, eddy currents, housing, hysteresis, saturation": every,
    }.items():
        simulation = Simulation(rig, seed=1)
        simulation.advance(r[:100])  # compiled before the clock starts
        best, median = cpu_seconds(partial(simulation.advance, r, check_limits=False))
        print(
            f"  {name:54s} {seconds / best:6.0f} times real time (best of {REPEATS}), "
            f"{seconds / median:5.0f} (median), {best / seconds * T * 1e6:5.2f} us of CPU a sample"
        )


def integration_error() -> None:
    print("Integration error at the usual amplitude, 1 s: largest difference in y from 64 steps a sample, relative")
    r = shaking(10_000, 0.3)
    cases = {
        "reference rig": reference_rig(noise=Noise()),
        "saturation": effect("magnetic_saturation").on(reference_rig(noise=Noise())),
        "hysteresis": effect("magnetic_hysteresis").on(reference_rig(noise=Noise())),
        "contact at 12 um": effect("touchdown_contact").on(reference_rig(noise=Noise())),
        "voltage limit": effect("amplifier_voltage_limit").on(reference_rig(noise=Noise()), slew_inverse_s_per_a=1e-3),
    }
    for name, rig in cases.items():
        exact = Simulation(rig, substeps=64).advance(r, check_limits=False).y
        errors = [
            np.abs(Simulation(rig, substeps=k).advance(r, check_limits=False).y - exact).max() / np.abs(exact).max()
            for k in (1, 2, 4, 8, 16)
        ]
        print(f"  {name:18s}" + "".join(f"  {k:2d}: {e:7.1e}" for k, e in zip((1, 2, 4, 8, 16), errors, strict=True)))


def agreement() -> None:
    print("Linear theory and the rig in time, y/u as a matrix, 60 lines over 10 to 1000 Hz all at once, relative")
    frequency_hz = np.unique(np.round(np.geomspace(10, 1000, 60)))
    for name, rig in {
        "standing still": reference_rig(),
        "turning, 400 rad/s": reference_rig(speed_rad_s=400.0),
        "under a load of 4 m/s2": reference_rig(gravity_m_per_s2=4.0),
    }.items():
        theory = linear_model(rig, frequency_hz)
        for label, amplitude_a in (("0.1 mA a line", 1e-4), ("20 mA a line", 0.02)):
            found = measured_responses(rig, frequency_hz, amplitude_a)
            error = np.linalg.norm(found.y_per_u - theory.y_per_u, axis=(1, 2))
            error /= np.linalg.norm(theory.y_per_u, axis=(1, 2))
            print(f"  {name:24s} {label:15s} median {np.median(error):.1e}  largest {error.max():.1e}")


def linear_parts(rig: Rig) -> tuple[Array, Array, Array]:
    """A, B, C of the linear rig from held u to y."""
    ss = state_space(rig, actuator.operating_point(rig))
    return ss.A, ss.drive, ss.sensor


def in_python_control(rig: Rig, r: Array) -> Array:
    """The exact discrete closed loop as python-control has it: forced_response over the samples."""
    a, b, c = linear_parts(rig)
    n_z, n = b.shape
    block = np.zeros((n_z + n, n_z + n))
    block[:n_z, :n_z], block[:n_z, n_z:] = a * T, b * T
    held = expm(block)
    plant = control.ss(held[:n_z, :n_z], held[:n_z, n_z:], c, np.zeros((n, n)), T)
    (numerator,), (denominator,) = control_law.transposed_forms(rig.controller, 1)
    one = control.tf2ss(control.tf(numerator, denominator, T), method="scipy")
    loop = control.feedback(plant, control.append(*[one] * n), sign=-1)
    return np.asarray(control.forced_response(loop, inputs=r.T).outputs).T


def _slope(_t: float, z: Array, a: Array, push: Array) -> Array:
    return np.asarray(a @ z + push)


def in_solve_ivp(rig: Rig, r: Array) -> Array:
    """The same linear rig with scipy's solve_ivp from hold to hold, the controller between."""
    a, b, c = linear_parts(rig)
    (numerator,), (denominator,) = control_law.transposed_forms(rig.controller, 1)
    order, n = len(denominator) - 1, b.shape[1]
    z, state, y = np.zeros(len(a)), np.zeros((order + 1, n)), np.empty((len(r), n))
    for k in range(len(r)):
        y[k] = c @ z
        out = state[0] - numerator[0] * y[k]
        state[:-1] = state[1:] - np.outer(numerator[1:], y[k]) - np.outer(denominator[1:], out)
        push = b @ (out + r[k])
        z = solve_ivp(_slope, (0.0, T), z, method="RK45", rtol=1e-7, atol=1e-13, args=(a, push)).y[:, -1]
    return y


def others() -> None:
    print("The same rig, linear, in the field's tools; 4 axes at 10 kHz. Ours carries the nonlinear magnets and takes")
    print("4 steps a sample; python-control steps the exact discrete closed loop, sample by sample, without anything")
    print("nonlinear; solve_ivp integrates the continuous linear part from hold to hold (RK45, rtol 1e-7).")
    rig = replace(reference_rig(), noise=Noise())
    r = shaking(20_000, 1e-4)
    simulation = Simulation(rig)
    simulation.advance(r[:10])

    def ours() -> Array:
        simulation.levitate()
        return simulation.advance(r, check_limits=False).y

    reference = in_python_control(rig, r)
    print("  tool                          samples   CPU s (best)  times real time  largest difference in y, relative")
    for name, job, n, repeats in (
        ("this rig, nonlinear", ours, 20_000, REPEATS),
        ("control.forced_response", lambda: in_python_control(rig, r), 20_000, 3),
        ("scipy solve_ivp", lambda: in_solve_ivp(rig, r[:300]), 300, 3),
    ):
        y = job()
        best, _ = cpu_seconds(job, repeats)
        error = np.abs(y - reference[:n]).max() / np.abs(reference[:n]).max()
        print(f"  {name:28s} {n:8d} {best:14.4f} {n * T / best:17.2f} {error:20.1e}")


if __name__ == "__main__":
    speed()
    integration_error()
    agreement()
    others()
