"""A parameter says at which end of its range a value is."""

import pytest

from sim.effect import Parameter

RATE = Parameter("slew_inverse_s_per_a", "s/A", 1e-5, 2e-3, 2.5e-4, 0.0, "log")


@pytest.mark.parametrize(
    ("value", "end"),
    [(1e-5, "low"), (1.0000000000000006e-5, "low"), (1.001e-5, None), (2.5e-4, None), (2e-3, "high")],
)
def test_only_what_is_at_an_end_of_its_range_is(value: float, end: str | None) -> None:
    assert RATE.end(value) == end
