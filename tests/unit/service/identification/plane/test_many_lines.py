"""Cubic terms of many lines at once: what the model adds at each line is what the force law does in time."""

import numpy as np

from service.experiment.data import Sweep
from service.experiment.multisine import (
    Multisine,
    choose_lines,
    orthogonal,
    random_phases,
    separated,
    spectra,
    synthesise,
)
from service.identification.plane.force_law import excess_force
from service.identification.plane.many_lines import ManyLines, excess_of_products

KI, KS, I0 = np.array([181.0, 186.0]), np.array([1.68e6, 1.73e6]), np.array([2.75, 2.75])
SAMPLES = 1000


def case(seed=1):
    rng = np.random.default_rng(seed)
    lines = choose_lines(SAMPLES, 1000.0, 4.0, 200.0, 40, rng)
    L = len(lines.excited)
    multisines = [Multisine(lines, random_phases(L, 2, np.random.default_rng(s))) for s in (11, 12)]
    # columns of current and displacement at the bearings per input, from any linear system
    i, x = (
        scale * (rng.standard_normal((L, 2, 2)) + 1j * rng.standard_normal((L, 2, 2))) / np.sqrt(L)
        for scale in (0.2, 8e-6)
    )
    return lines, multisines, i, x


def sweep_of(lines, multisines):
    L = len(lines.excited)
    zero = np.zeros((2 * L, 2, 1, 2), dtype=complex)
    phase = np.array([[np.angle(m.spectrum[k, j]) for m in multisines] for k in range(L) for j in (0, 1)])
    return Sweep(
        kind="multisine",
        frequency_hz=np.repeat(lines.excited, 2).astype(float),
        axis=np.tile([0, 1], L),
        amplitude_a=np.ones(2 * L),
        harmonics=(1,),
        R=zero,
        U=zero,
        I=None,
        Y=zero,
        sample_rate_hz=1000.0,
        block_samples=np.full(2 * L, SAMPLES),
        phase_rad=phase,
    )


def in_time(lines, multisine, columns, e):
    """(SAMPLES, 2) of experiment e."""
    W = orthogonal(2)
    return synthesise(np.einsum("ljb,lj->lb", columns, W[e] * multisine.spectrum), lines.excited, SAMPLES)


def test_the_excess_at_every_line_is_that_of_the_force_law_in_time():
    lines, multisines, i, x = case()
    many = ManyLines.of(sweep_of(lines, multisines), np.arange(2 * len(lines.excited)))
    products = many.products(i.reshape(-1, 2), x.reshape(-1, 2))
    gap = I0 * KI / KS
    for b, m in enumerate(multisines):
        found = excess_of_products(KI, KS, I0, products[b])[0]
        experiments = []
        for e in range(2):
            a, d = in_time(lines, m, i, e) / I0, in_time(lines, m, x, e) / gap
            force = KI * I0 * ((a + d) * (1 + a * d) / (1 - d**2) ** 2 - a - d)
            experiments.append(spectra(force, SAMPLES, lines.excited)[0])
        wanted = separated(np.array(experiments), m).reshape(-1, 2)
        assert np.max(np.abs(found - wanted)) < 0.02 * np.max(np.abs(wanted))  # fifth order is left


def test_a_single_line_gives_what_a_tone_gives():
    phasor, axis, line = np.ones((1, 1), dtype=complex), np.array([0]), np.array([1])
    i, x = np.array([[0.1, 0.05 + 0.02j]]), np.array([[5e-6, 3e-6j]])
    products = ManyLines(phasor, axis, line, 1).products(i, x)[0]
    for a, b in zip(excess_of_products(KI, KS, I0, products), excess_force(KI, KS, I0, i, x), strict=True):
        np.testing.assert_allclose(a, b, rtol=5e-3)


def test_the_derivatives_are_those_of_the_excess():
    lines, multisines, i, x = case()
    many = ManyLines.of(sweep_of(lines, multisines), np.arange(2 * len(lines.excited)))
    products = many.products(i.reshape(-1, 2), x.reshape(-1, 2)).mean(axis=0)
    _, by_ki, by_ks = excess_of_products(KI, KS, I0, products)
    for k, (slope, at) in enumerate(((by_ki, KI), (by_ks, KS))):
        step = 1e-5 * at
        up, down = (
            excess_of_products(*(KI + s * step, KS) if k == 0 else (KI, KS + s * step), I0, products)[0]
            for s in (1, -1)
        )
        np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-6, atol=1e-9 * np.abs(slope).max())


def test_tones_and_files_without_phases_have_no_common_products():
    lines, multisines, _, _ = case()
    sweep = sweep_of(lines, multisines)
    keep = np.arange(4)
    from dataclasses import replace

    assert ManyLines.of(replace(sweep, kind="stepped-sine"), keep) is None
    assert ManyLines.of(replace(sweep, phase_rad=None), keep) is None
