"""A loop in which something rings while its points are recorded, simulated step by step."""

import numpy as np

from service.experiment.data import Sweep
from service.identification.closed_loop import companion, sampled
from service.identification.plane_model import PlaneModel
from service.identification.synthetic import plane_model_of
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet, reference_rig
from tests.support.two_axes import sheet_of_one_plane

SHEET = reference_datasheet()
TRUTH = plane_model_of(reference_rig(), "x")
CONTROLLER = (np.array(SHEET.numerator), np.array(SHEET.denominator))
BLOCKS, RATE = 6, 10_000.0
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
    sums = {name: np.zeros((len(hz), BLOCKS, 2), dtype=complex) for name in "ruiy"}
    for k in range(start + BLOCKS * int(n.max())):
        y = plant.C @ x + noise[0] * rng.standard_normal((2, len(hz)))
        i = see_i @ x + noise[1] * rng.standard_normal((2, len(hz)))
        out = b[0] * -y + memory[0]
        memory = np.concatenate([memory[1:], np.zeros((1, 2, len(hz)))]) + b[1:, None, None] * -y
        memory -= a[1:, None, None] * out
        r = np.zeros((2, len(hz)))
        r[axis, np.arange(len(hz))] = size * np.cos(2 * np.pi * hz * k / RATE)
        u = out + r
        block = (k - start) // n
        on = (k >= start) & (block < BLOCKS)
        turn = 2 / n * np.exp(-2j * np.pi * hz * k / RATE)
        for name, signal in (("r", r), ("u", u), ("i", i), ("y", y)):
            sums[name][on, block[on]] += (turn * signal).T[on]
        x = plant.A @ x + plant.B @ u
    return Sweep(
        kind="stepped-sine",
        frequency_hz=hz,
        axis=axis,
        amplitude_a=size,
        harmonics=(1,),
        **{name.upper(): value[:, :, None, :] for name, value in sums.items()},
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
