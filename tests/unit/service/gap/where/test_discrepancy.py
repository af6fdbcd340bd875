"""What no effect explains still has a shape, and a person can read it: over frequency, amplitude and channel."""

import numpy as np
import pytest

from service.gap.where.discrepancy import discrepancy
from service.report.gap_discrepancy import discrepancy_figure
from tests.unit.service.gap.where.test_dependence import plant


def test_a_lag_is_a_phase_that_grows_with_frequency_at_any_amplitude() -> None:
    e, other = plant("linear")  # a lag of 20 us that the twin lacks
    found = discrepancy([e], "plant", other)
    assert found is not None
    own = [c for c in found["fundamental"] if c["output"] == c["input"] == "xA"]
    assert [c["sweep"] for c in own] == ["fitted", "other"]
    assert np.median(own[1]["amplitude_a"]) == pytest.approx(2 * np.median(own[0]["amplitude_a"]))
    for c in own:
        hz = np.array(c["frequency_hz"])
        far = (hz > 20) & (hz < 170)  # nearer the first mode the refitted values take part of it
        assert np.array(c["im"])[far] == pytest.approx(-2 * np.pi * hz[far] * 2e-5, rel=0.15, abs=1e-3), (
            "but for what the refitted values take"
        )
        assert len(c["re"]) == len(c["std"]) == len(hz)
    across = [c for c in found["fundamental"] if c["output"][0] != c["input"][0]]
    assert max(c["significance"] for c in across) < 5 < own[0]["significance"]
    assert found["harmonics"] == []


def test_harmonics_of_what_is_not_in_proportion_are_there() -> None:
    e, other = plant("bent")
    found = discrepancy([e], "plant", other)
    assert found is not None
    assert {c["harmonic"] for c in found["harmonics"]} == {3}
    drawn = discrepancy_figure(found)
    assert drawn.name == "discrepancy"


def test_a_part_that_was_not_looked_at_has_none() -> None:
    e, other = plant("none")
    assert discrepancy([e], "amplifier", other) is None
