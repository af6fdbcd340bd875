"""An experiment of a multisine is known again in a journal that another machine has begun."""

from dataclasses import replace

import numpy as np
import pytest

from service.campaign.multisine.plan import PeriodicRequest

ASKED = PeriodicRequest("main", 1, 2, np.array([[0.1, -0.2], [0.05, 0.0]]), 6, 12_000)


def test_one_that_another_processor_rounded_otherwise_is_the_same_settled_as_it_was():
    kept = ASKED.description() | {"peak_a": 0.2 * (1 + 1e-5), "settle_samples": 12_001}
    found = ASKED.recalled(kept)
    assert found.settle_samples == 12_001
    np.testing.assert_array_equal(found.waveform_a, ASKED.waveform_a)


@pytest.mark.parametrize(
    "other",
    [
        {"realisation": 0},
        {"experiment": 1},
        {"sweep": "validation"},
        {"samples": 4},
        {"periods": 5},
        {"settle_samples": 12_100},
        {"peak_a": 0.1},
    ],
)
def test_another_one_is_not(other):
    assert ASKED.recalled(ASKED.description() | other) is None
    assert ASKED.recalled(None) is None


def test_an_experiment_at_rest_is_no_excited_one():
    rest = replace(ASKED, waveform_a=np.zeros((2, 2)))
    assert rest.recalled(rest.description()) is not None
    assert rest.recalled(ASKED.description()) is None
