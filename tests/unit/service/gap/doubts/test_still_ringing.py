"""A line at which the rig still rang does not hide the resonance that rang, and nothing is named for its sake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.gap.explain_parts import explain_parts
from service.gap.fitting.candidates import Fitter
from service.gap.observed import Observed, observed
from service.gap.parts_in_turn import PartsInTurn
from service.gap.progress import Progress
from service.gap.weighing.verdict import rejected
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

MODE = {
    "frequency_hz": 143.0,
    "damping_ratio": 0.0015,
    "bearing_A_per_sqrt_kg": 0.009,
    "bearing_B_per_sqrt_kg": -0.0075,
    "sensor_A_per_sqrt_kg": 0.009,
    "sensor_B_per_sqrt_kg": -0.0075,
}


def measured(effects: dict[str, dict[str, float]], lines: int) -> tuple[Observed, list[float]]:
    """A rig with a mode that its plan did not know of, its response off by a third at the lines nearest to it."""
    sheet, truth = known_datasheet(seed=61)
    data = observed(*one_plane(experiment(with_effects(true_rig(truth), effects)), sheet))
    o = data.o
    rang_hz = sorted(o.frequency_hz, key=lambda hz: abs(hz - MODE["frequency_hz"]))[:lines]
    rang = np.isin(o.points_hz, rang_hz)
    Y = o.Y.copy()
    still = np.where(np.arange(o.Y.shape[2]) == o.axis[:, None], 0.3j, -0.4)  # of no single mode
    Y[rang] *= 1.0 + still[rang, None]
    ringing = replace(o, Y=Y, drifting=rang, drift=np.where(rang, 0.05, 0.0))
    return replace(data, o=ringing), sorted(map(float, rang_hz))


def plant(data: Observed) -> PartsInTurn:
    with Fitter(1) as fitter:
        parts = PartsInTurn(fitter, data, (data.o,))
        parts.explain_all(Progress(None), (0.0, 100.0))
    return parts


def test_the_resonance_that_rang_at_a_line_is_found_by_the_others() -> None:
    data, rang_hz = measured({"extra_flexible_mode": MODE}, 1)
    with Fitter(1) as fitter:
        found = explain_parts(data, fitter, Progress(None))
    best = found.parts[-1].chosen
    assert best.effects == ("extra_flexible_mode",)
    assert best.fit.values[0]["frequency_hz"] == pytest.approx(MODE["frequency_hz"], rel=0.02)
    assert any(f"explained without {rang_hz[0]:.4g} Hz, where the rig still rang" in note for note in found.notes)


@pytest.mark.parametrize(
    ("effects", "lines"), [({}, 1), ({"extra_flexible_mode": MODE}, 5)], ids=["nothing else", "too many lines"]
)
def test_lines_are_left_out_only_where_few_hide_an_effect(effects: dict[str, dict[str, float]], lines: int) -> None:
    data, _ = measured(effects, lines)
    parts = plant(data)
    assert parts.left_out_hz == []
    assert rejected(parts.explained[-1].order[0], parts.explained[-1].remaining)
