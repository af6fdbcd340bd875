"""What a campaign tells of itself while it measures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.controller import Capabilities
from drivers.simulated.driver import SimulatedController
from service.campaign.progress import Meter, Progress
from service.campaign.run import run_campaign
from sim.reference import reference_datasheet, reference_rig


def test_a_record_for_which_one_waits_is_told_before_it_comes_and_counts_as_no_point() -> None:
    told: list[Progress] = []
    meter = Meter(told.append, record_wait_s=lambda samples: samples / 100)
    meter.awaits_record("noise", 1000)
    assert told == [], "ten seconds are not worth telling"
    meter.awaits_record("noise", 30_000)
    assert [(p.phase, p.done, p.wait_s) for p in told] == [("noise", 0, 300.0)]
    meter.finished("noise", "zero-excitation record", replayed=False, rig_seconds=3.0)
    assert (told[-1].done, told[-1].wait_s) == (1, 0.0)


class _SlowLine(SimulatedController):
    """As if its records came over a serial line."""

    def capabilities(self) -> Capabilities:
        return replace(super().capabilities(), raw_bytes_per_s=8640.0)


class _EnoughError(Exception):
    """The way out of a campaign."""


def test_a_campaign_on_a_slow_line_tells_how_long_its_records_of_noise_take(tmp_path: Path) -> None:
    told: list[Progress] = []

    def progress(p: Progress) -> None:
        told.append(p)
        if p.done == 2:
            raise _EnoughError

    controller = _SlowLine(reference_rig(), 1)
    try:
        with pytest.raises(_EnoughError):
            run_campaign(controller, reference_datasheet(), tmp_path, progress)
        first = [(p.phase, p.done, round(p.wait_s)) for p in told]
        assert first == [("noise", 0, 167), ("noise", 1, 0), ("noise", 1, 30), ("noise", 2, 0)]
        told.clear()
        with pytest.raises(_EnoughError):  # from the journal nothing has to come
            run_campaign(controller, reference_datasheet(), tmp_path, progress)
        assert [p.wait_s for p in told] == [0.0, 0.0]
    finally:
        controller.close()
