"""A parameter says at which end of its range a value is, and its name without the unit."""

import pytest

from sim.effect import SUFFIXES, Parameter
from sim.effects import CATALOGUE

RATE = Parameter("slew_inverse_s_per_a", "s/A", 1e-5, 2e-3, 2.5e-4, 0.0, "log")


@pytest.mark.parametrize(
    ("value", "end"),
    [(1e-5, "low"), (1.0000000000000006e-5, "low"), (1.001e-5, None), (2.5e-4, None), (2e-3, "high")],
)
def test_only_what_is_at_an_end_of_its_range_is(value: float, end: str | None) -> None:
    assert RATE.end(value) == end


@pytest.mark.parametrize("p", [p for e in CATALOGUE.values() for p in e.parameters if p.unit not in ("1", "samples")])
def test_a_name_ends_with_its_unit_and_the_words_do_not(p: Parameter) -> None:
    assert p.name == p.words.replace(" ", "_") + SUFFIXES[p.unit]
