"""Peaks that hide between the points of a grid are found from their flanks, and resolved."""

import numpy as np
import pytest

from service.campaign.frequencies import grid
from service.campaign.peaks import Peak, densification, merged, peaks, resolved


def plant(f, modes, rigid=2000.0):
    """Two by two response with a rigid-body line and modes of (frequency, damping ratio)."""
    s = 2j * np.pi * np.asarray(f)[:, None, None]
    shapes = [np.array([[1.0, 0.6], [0.7, 0.4]]), np.array([[0.5, -0.8], [-0.3, 0.6]]), np.eye(2) * 0.3]
    out = np.array([[1.0, 0.2], [0.2, 1.0]]) * 2 / (s**2 - (2 * np.pi * 20) ** 2)
    for (f0, zeta), shape in zip(modes, shapes, strict=False):
        w = 2 * np.pi * f0
        out = out + shape / (s**2 + 2 * zeta * w * s + w**2)
    return (out * np.exp(-s * 1e-4)).reshape(len(f), 4)


def measured(f, modes, accuracy=0.002, seed=0):
    rng = np.random.default_rng(seed)
    G = plant(f, modes)
    std = accuracy * np.linalg.norm(G, axis=1, keepdims=True) * np.ones((1, 4))
    return G + std * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)) / 2, std


@pytest.mark.parametrize(
    "modes",
    [
        [(493.0, 0.0012), (908.5, 0.001)],
        [(137.0, 0.003)],
        [(211.0, 0.0005), (640.0, 0.01), (930.0, 0.002)],
        [(320.0, 0.002), (350.0, 0.002)],
    ],
)
def test_hidden_peaks_are_found_and_resolved(modes):
    f = grid(10.0, 1000.0, 200)
    for _ in range(6):
        G, std = measured(f, modes)
        found = peaks(f, G, std, 0.002)
        new = [densification(p, f, 5) for p in found if not resolved(p, f, 5)]
        if not new:
            break
        f = np.unique(np.concatenate([f, *new]))
    assert len(f) < 200 + 25 * len(modes)
    assert len(found) == len(modes)
    for peak, (f0, zeta) in zip(found, modes, strict=True):
        assert peak.frequency_hz == pytest.approx(f0, abs=0.15 * zeta * f0)
        assert peak.half_width_hz == pytest.approx(zeta * f0, rel=0.1)
        assert np.sum(np.abs(f - f0) <= 1.2 * zeta * f0) >= 5


def test_a_rotor_without_modes_has_no_peaks():
    f = grid(10.0, 1000.0, 200)
    for seed in range(5):
        assert peaks(f, *measured(f, [], seed=seed), 0.002) == []


def test_too_few_points_have_no_peaks():
    f = grid(10.0, 1000.0, 7)
    assert peaks(f, *measured(f, []), 0.002) == []


def test_doubles_are_merged_the_narrower_stays():
    one, same, other = Peak(100.0, 1.0, 5.0), Peak(100.1, 2.0, 5.0), Peak(110.0, 1.0, 5.0)
    assert merged([same, other, one]) == [one, other]


def test_densification_adds_nothing_where_points_are():
    peak = Peak(500.0, 1.0, 10.0)
    f = grid(10.0, 1000.0, 200)
    dense = np.unique(np.concatenate([f, densification(peak, f, 5)]))
    assert resolved(peak, dense, 5)
    assert not resolved(peak, f, 5)
    assert len(densification(peak, dense, 5)) == 0
    assert np.all(np.diff(dense) > 0.05)
