"""What blocks' ends leave cancels from block to block, and how far it does is read from the blocks."""

import numpy as np
import pytest

from service.gap.ends import share

SIZE = np.exp(np.random.default_rng(2).standard_normal((300, 1, 2)))
"""Of each channel's scatter."""


def seen(blocks: np.ndarray) -> float:
    """The share, of blocks whose scatter is known."""
    return share(blocks - blocks.mean(axis=1, keepdims=True), SIZE[:, 0] ** 2)


def white(blocks: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    return SIZE * (rng.standard_normal((300, blocks, 2)) + 1j * rng.standard_normal((300, blocks, 2)))


@pytest.mark.parametrize("blocks", [5, 6, 12])
@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 0.15), (0.5, 0.15), (1.0, 0.1)])
def test_the_share_is_the_variance_of_means_over_that_of_independent_blocks(
    blocks: int, noise: float, tolerance: float
) -> None:
    ends, own = white(blocks + 1), white(2 * blocks)[:, blocks:]
    e = (1 - noise) * np.diff(ends, axis=1) + noise * own
    of_ends, of_noise = 4 * (1 - noise) ** 2, 2 * noise**2  # variance of a block
    of_a_mean = of_ends / blocks**2 + of_noise / blocks
    assert seen(e) == pytest.approx(of_a_mean / ((of_ends + of_noise) / blocks), rel=tolerance)


def test_blocks_too_few_are_taken_for_independent() -> None:
    assert seen(np.diff(white(4), axis=1)) == 1.0
