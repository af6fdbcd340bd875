"""What a controller keeps of a record is limited, whatever else it would play."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.controller import Capabilities, Tone, Waveform
from drivers.device.limits import MAX_RAW_SAMPLES, check_tone, check_waveform
from drivers.device.machine import RigDevice
from drivers.errors import LimitError
from drivers.objects import MAX_BLOCKS
from sim.reference import reference_rig

LONGEST = Tone(axis=0, amplitude_a=0.1, periods=100, samples=MAX_RAW_SAMPLES // 2, blocks=2, raw=True)


@pytest.fixture(scope="module")
def capabilities() -> Capabilities:
    device = RigDevice(reference_rig())
    device.close()
    return device.capabilities()


def test_a_raw_record_has_a_longest_length_and_a_tone_without_one_may_be_longer(capabilities: Capabilities) -> None:
    check_tone(LONGEST, capabilities)
    longer = replace(LONGEST, samples=LONGEST.samples + 1)
    with pytest.raises(LimitError, match="500002 samples of raw record are more than 500000"):
        check_tone(longer, capabilities)
    check_tone(replace(longer, raw=False), capabilities)


def test_settling_is_no_part_of_a_raw_record(capabilities: Capabilities) -> None:
    check_tone(replace(LONGEST, settle_samples=capabilities.max_samples - MAX_RAW_SAMPLES), capabilities)


def test_the_record_of_a_waveform_has_the_same_longest_length(capabilities: Capabilities) -> None:
    period = np.zeros((MAX_RAW_SAMPLES // MAX_BLOCKS, len(capabilities.axes)))
    check_waveform(Waveform(period, periods=MAX_BLOCKS), capabilities)
    longer = np.zeros((MAX_RAW_SAMPLES // MAX_BLOCKS + 1, len(capabilities.axes)))
    with pytest.raises(LimitError, match="samples of record are more than 500000"):
        check_waveform(Waveform(longer, periods=MAX_BLOCKS), capabilities)
