"""The length of blocks that a file does not tell is read from lines, whichever way a program rounds their periods."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.identification.measured.block_length import block_samples
from tests.support.synthetic import experiment, known_datasheet, true_rig

RATE_HZ, BLOCK_S = 10_000.0, 0.05
SWEEP = experiment(true_rig(known_datasheet()[1])).sweeps[0].select(np.arange(1))


def planned(hz: np.ndarray, rounded: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Lines that are whole samples near ``hz``, and the length of their blocks, samples."""
    periods = np.maximum(1, rounded(hz * BLOCK_S))
    samples = np.round(periods * RATE_HZ / hz)
    return periods * RATE_HZ / samples, samples


def at(hz: np.ndarray) -> Sweep:
    return replace(SWEEP.select(np.zeros(len(hz), dtype=int)), frequency_hz=hz, sample_rate_hz=RATE_HZ)


@pytest.mark.parametrize("rounded", [np.round, np.ceil, np.floor])
def test_whichever_way_a_program_rounds(rounded: Callable[[np.ndarray], np.ndarray]) -> None:
    hz, samples = planned(np.geomspace(12.3, 913.0, 58), rounded)
    told = block_samples(at(hz))
    assert told is not None
    assert np.mean(told == samples) > 0.95


def test_few_lines_are_told_as_those_of_another_sweep_of_the_program() -> None:
    """Round frequencies leave several lengths; lines of a program with longer blocks are not told by it."""
    main, _ = planned(np.geomspace(12.3, 913.0, 58), np.ceil)
    few, samples = planned(np.array([100.0, 200.0, 500.0]), np.ceil)
    assert block_samples(at(few)) is None
    assert block_samples(at(few), at(main)).tolist() == samples.tolist()
    assert block_samples(replace(at(few), sample_rate_hz=RATE_HZ / 2), at(main)) is None
    longer = np.array([65.0, 115.0, 165.0])
    assert block_samples(at(longer), at(main)) is None
