"""A sweep prepared: how far each of its points is to be believed."""

from dataclasses import replace

import numpy as np

from service.experiment.data import Sweep
from service.gap.fitting.nuisance import nuisance
from service.gap.measured.observation import CONTROLLER_FLOOR, SMALLEST_SHARE, Observation, observe
from sim.twin import current_per_control, rig_from_datasheet
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig


def _rings_up(settled: Sweep, point: int, times: float) -> Sweep:
    """The sweep with one point whose u, and i with it, rises by ``times`` its size from first block to last.

    A tone that rises by d over K periods leaves d / (2 pi K (h - 1)) and, of its mirror image, d / (2 pi K (h + 1)) at
    the harmonic h; the current that follows it has the same of its own, whatever the amplifier does at that harmonic.
    """
    blocks, f = settled.Y.shape[1], settled.harmonics.index(1)
    rise = np.linspace(-0.5, 0.5, blocks)
    U, current = settled.U.copy(), settled.I.copy()
    for X in (U, current):
        d = times * X[point, :, f].mean(axis=0)
        X[point, :, f] += rise[:, None] * d
        for k, h in enumerate(settled.harmonics):
            if h != 1:
                X[point, :, k] += (d / (1j * (h - 1)) + np.conj(d) / (1j * (h + 1))) / (2 * np.pi * blocks)
    return replace(settled, U=U, I=current)


def _missed(o: Observation, point: int) -> np.ndarray:
    """What the true amplifiers leave of the point's current, in standard deviations, (H, n)."""
    of_u = [current_per_control(RIG, np.maximum(h * o.points_hz[[point]], 1e-2))[0] for h in o.harmonics]
    told = np.stack([A @ o.U[point, k] for k, A in enumerate(of_u)])
    return np.abs(o.I[point] - told) / o.sd_i[point]


DATASHEET, TRUTH = known_datasheet()
RIG = true_rig(TRUTH)


def test_what_a_resonance_that_rings_up_leaves_in_harmonics_is_no_error_of_the_amplifiers() -> None:
    rig, settled = nuisance(DATASHEET).rig, sweep(RIG, lines(), 0.15, seed=1)
    point = int(np.argmin(np.abs(settled.frequency_hz - 908.5) + 1e6 * (settled.axis != 0)))
    before, after = observe(settled, rig), observe(_rings_up(settled, point, 8.0), rig)
    elsewhere = np.arange(len(before.harmonics)) != before.fundamental
    blind = after.I[point] - before.I[point]  # what the tone's rise has left, which is far beyond the noise
    assert np.all(np.abs(blind[elsewhere, 0]) > 10 * before.sd_i[point, elsewhere, 0])
    assert np.all(_missed(after, point)[elsewhere, 0] < 3)
    # the point itself, at the excited frequency, and every other are believed as before
    others = np.arange(len(before.line)) != point
    np.testing.assert_allclose(after.sd_i[others], before.sd_i[others], rtol=0.05)
    np.testing.assert_allclose(after.sd_i[point, before.fundamental], before.sd_i[point, before.fundamental], rtol=0.5)


def test_the_controller_is_held_as_closely_as_its_arithmetic_however_sensors_scatter() -> None:
    """The loop brings their noise into u; from block to block that is no drift of a rig that has settled."""
    sheet, truth = known_datasheet(seed=3)
    rig = rig_from_datasheet(sheet)
    noisy = sweep(true_rig(truth), lines(), 0.15, seed=1, noise=5.0)
    found = observe(noisy, rig)
    f = found.fundamental
    floor = np.maximum(CONTROLLER_FLOOR * np.abs(found.U[:, f]), SMALLEST_SHARE * np.abs(found.U).max())
    assert np.median(found.sd_u[:, f] / floor) < 1.5
