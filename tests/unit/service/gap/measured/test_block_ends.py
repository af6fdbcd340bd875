"""What blocks' ends leave cancels from block to block, and how far it does is read from the blocks."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.measured.block_ends import mean_variance_ratio
from service.gap.measured.estimate import plain_mean

SIZE = np.exp(np.random.default_rng(2).standard_normal((300, 1, 2)))
"""Of each channel's scatter."""


def seen(blocks: np.ndarray) -> np.ndarray:
    """The share of each point, of blocks whose scatter is known."""
    return mean_variance_ratio(blocks - blocks.mean(axis=1, keepdims=True), SIZE[:, 0] ** 2, np.arange(len(blocks)))


def white(blocks: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    return SIZE * (rng.standard_normal((300, blocks, 2)) + 1j * rng.standard_normal((300, blocks, 2)))


@pytest.mark.parametrize("blocks", [5, 6, 12])
@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0])
def test_the_share_is_the_variance_of_means_over_that_of_independent_blocks(blocks: int, noise: float) -> None:
    ends, own = white(blocks + 1), white(2 * blocks)[:, blocks:]
    e = (1 - noise) * np.diff(ends, axis=1) + noise * own
    of_ends, of_noise = 4 * (1 - noise) ** 2, 2 * noise**2  # variance of a block
    of_a_mean = of_ends / blocks**2 + of_noise / blocks
    # near its bounds chance has one side alone
    assert seen(e).mean() == pytest.approx(of_a_mean / ((of_ends + of_noise) / blocks), abs=0.07)


def test_blocks_too_few_are_taken_for_independent() -> None:
    assert (seen(np.diff(white(4), axis=1)) == 1.0).all()


def test_beside_a_hum_that_is_taken_off_four_or_five_blocks_are_too_few() -> None:
    """Three patterns leave one deviation of four blocks free: end effects and noise could not be told from it."""
    for blocks in (4, 5):
        ends = np.diff(white(blocks + 1), axis=1)
        beside = replace(plain_mean(300, blocks), dof=np.full(300, blocks - 3.0))
        assert (mean_variance_ratio(ends, SIZE[:, 0] ** 2, np.arange(300), beside) == 1.0).all()


def test_ends_that_leave_much_at_low_frequencies_alone_cancel_there_alone() -> None:
    low = np.arange(300) < 150
    found = seen(np.where(low[:, None, None], np.diff(white(7), axis=1), white(6)))
    assert found[low][:-12].max() < 0.35
    assert found[~low][12:].min() > 0.65


@pytest.mark.parametrize(("blocks", "least"), [(4, 0.98), (6, 0.99), (10, 0.99)])
def test_independent_blocks_are_taken_for_nothing_else_in_the_mean(blocks: int, least: float) -> None:
    """Cut off at one, an estimate that scatters would claim less noise than there is."""
    assert seen(white(blocks)).mean() > least
