"""A diagnosis tells how far it is: never backwards, part by part, to the end."""

import numpy as np
import pytest

from service.gap.fitting.part import Part
from service.gap.progress import Progress

NONE = np.zeros(0, dtype=np.int64)
CONTROLLER = Part("controller", NONE, ("a", "b"))
PLANT = Part("plant", NONE, tuple("abcdefghijklmno"))


@pytest.mark.parametrize("mixtures", [0, 40])
def test_percent_never_fall_and_stay_within_the_part(mixtures: int) -> None:
    heard: list[tuple[float, str]] = []
    progress = Progress(lambda percent, words: heard.append((percent, words)))
    ends = []
    for part in (CONTROLLER, PLANT):
        progress.part(part, [CONTROLLER, PLANT], 20.0, 80.0)
        for _ in range(1 + len(part.effects) + mixtures):
            progress.fitted()
        ends.append(heard[-1][0])
    progress.judging(97.0)
    percents = [percent for percent, _ in heard]
    assert percents == sorted(percents)
    assert percents[0] == 20.0
    assert ends[0] < 30 < 70 < ends[1] < 80  # the plant's many and longer fits take nearly all of the time
    assert heard[-1] == (97.0, "judging on unseen data")
