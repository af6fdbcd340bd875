"""A loop in which something rings while its points are recorded, simulated step by step."""

import numpy as np

from service.experiment.data import Sweep
from service.identification.loop.closed_loop import companion, sampled
from service.identification.plane.model import PlaneModel
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of
from tests.support.two_axes import sheet_of_one_plane

SHEET = reference_datasheet()
TRUTH = plane_model_of(reference_rig(), "x")
CONTROLLER = (np.array(SHEET.numerator), np.array(SHEET.denominator))
BLOCKS, RATE = 6, 10_000.0
AT_ONCE = 1000
"""Steps whose excitation and noise are made together."""
AXES = ("xA", "xB")
HZ = np.unique(np.concatenate([np.geomspace(12, 980, 26), 495 + np.linspace(-12, 12, 9), 907 + np.linspace(-9, 9, 7)]))


def run(settle_s: float, told: bool = True, seed: int = 0, truth: PlaneModel = TRUTH, noisy: bool = True) -> Sweep:
    """The sampled linear loop from rest, tone by tone, step by step in time; y is 20 nm noisy, i 2 mA, or neither."""
    noise = noisy * np.array([20e-9, 2e-3])
    plant = sampled(truth)
    see_i = np.zeros((2, len(plant.A)))
    at = 0
    for k, a in enumerate(truth.amplifiers):
        c = companion(a.poles, a.dc_gain)[2]
        see_i[k, at : at + c.shape[1]] = c[0]
        at += c.shape[1]
    b, a = (np.asarray(x) / CONTROLLER[1][0] for x in CONTROLLER)
    periods = np.maximum(1, np.round(HZ * 0.05)).astype(int)
    samples = np.round(periods * RATE / HZ).astype(int)
    hz, n = np.tile(periods * RATE / samples, 2), np.tile(samples, 2)
    axis = np.repeat([0, 1], len(HZ))
    size = np.where(abs(hz / 497 - 1) < 0.03, 0.03, 0.12)
    start = round(settle_s * RATE)
    rng = np.random.default_rng(seed)
    x = np.zeros((len(plant.A), len(hz), 1))[:, :, 0]
    memory = np.zeros((len(a) - 1, 2, len(hz)))  # of the controller, transposed direct form
    everyone, none = np.arange(len(hz)), np.zeros((1, 2, len(hz)))
    steps = start + BLOCKS * int(n.max())
    kept = np.empty((4, steps - start, 2, len(hz)))  # r, u, i, y
    for first in range(0, steps, AT_ONCE):
        now = np.arange(first, min(first + AT_ONCE, steps))
        pushes = size * np.cos(2 * np.pi * hz * now[:, None] / RATE)
        for k, push, heard in zip(now.tolist(), pushes, rng.standard_normal((len(now), 2, 2, len(hz))), strict=True):
            y = plant.C @ x + noise[0] * heard[0]
            out = b[0] * -y + memory[0]
            memory = np.concatenate([memory[1:], none]) + b[1:, None, None] * -y
            memory -= a[1:, None, None] * out
            r = np.zeros((2, len(hz)))
            r[axis, everyone] = push
            u = out + r
            if k >= start:
                kept[:, k - start] = r, u, see_i @ x + noise[1] * heard[1], y
            x = plant.A @ x + plant.B @ u
    sums = np.empty((4, len(hz), BLOCKS, 2), dtype=complex)
    for j, (f, count) in enumerate(zip(hz, n, strict=True)):
        k = start + np.arange(BLOCKS * count)
        turned = kept[:, : len(k), :, j] * (2 / count * np.exp(-2j * np.pi * f * k / RATE))[:, None]
        sums[:, j] = turned.reshape(4, BLOCKS, count, 2).sum(axis=2)
    return Sweep(
        kind="stepped-sine",
        frequency_hz=hz,
        axis=axis,
        amplitude_a=size,
        harmonics=(1,),
        **dict(zip("RUIY", sums[:, :, :, None], strict=True)),
        sample_rate_hz=RATE,
        block_samples=n if told else None,
    )


def sheet() -> Datasheet:
    """The reference rig's, of the x plane alone."""
    return sheet_of_one_plane(SHEET)


def late(delay_s: float) -> PlaneModel:
    """The rig with a delay that its controller was not made for."""
    theta = TRUTH.theta.copy()
    theta[TRUTH.layout.delay] = delay_s
    return TRUTH.at(theta)
