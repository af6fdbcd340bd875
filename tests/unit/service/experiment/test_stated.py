"""An amplitude that a file states and that is not the recorded one is told, with its points; rounding is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.experiment import file
from service.experiment.stated import stated_amplitudes
from service.gap.observed import observed
from service.identification.fit import identify
from tests.support.synthetic import experiment as measured
from tests.support.synthetic import known_datasheet, true_rig

PRACTICE = Path(__file__).parents[5] / "shared" / "practice"


def stating(experiment, factor, points=slice(None)):
    """The experiment with amplitudes of its first sweep stated so many times too large."""
    first, *others = experiment.sweeps
    amplitude = first.amplitude_a.copy()
    amplitude[points] *= factor
    return replace(experiment, sweeps=(replace(first, amplitude_a=amplitude), *others))


@pytest.mark.parametrize("factor", [1.0, 1.3, 0.75])
def test_what_is_about_right_is_not_worth_a_word(experiment, factor):
    assert stated_amplitudes(stating(experiment, factor)) == []


@pytest.mark.parametrize(("factor", "stated"), [(2.0, "0.2 A"), (1e-3, "0.0001 A")])
def test_another_amplitude_is_told_with_its_points_and_what_to_do(experiment, factor, stated):
    (sentence,) = stated_amplitudes(stating(experiment, factor))
    assert sentence.startswith(
        "sweeps/0: amplitude_a is not the amplitude of the recorded r at 3 of 3 points (0, 1, 2;"
    )
    assert f"at 0 {stated} is stated and 0.1 A recorded" in sentence
    assert "state the peak of r in A" in sentence
    (sentence,) = stated_amplitudes(stating(experiment, factor, slice(1, 2)))
    assert "at 1 of 3 points (1; at 1" in sentence


def test_points_that_were_not_excited_are_none_of_its_business(experiment):
    first, noise = experiment.sweeps
    silent = replace(first, amplitude_a=np.zeros_like(first.amplitude_a), R=0 * first.R)
    assert stated_amplitudes(replace(experiment, sweeps=(silent, noise))) == []


def test_identification_and_diagnosis_tell_it():
    datasheet, truth = known_datasheet(seed=1)
    spoilt = stating(measured(true_rig(truth)), 2.0)
    told = stated_amplitudes(spoilt)
    assert len(told) == 1
    assert told[0] in observed(spoilt, datasheet).notes
    assert told[0] in identify(spoilt, datasheet).warnings


@pytest.mark.skipif(not PRACTICE.is_dir(), reason="practice cases are not beside the repository")
def test_files_of_another_program_state_what_they_recorded():
    for path in sorted(PRACTICE.glob("*/experiment.h5")):
        assert stated_amplitudes(file.read(path)) == []
