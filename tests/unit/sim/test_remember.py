"""Kept results are those of the same contents, and nobody can spoil them for the next caller."""

from dataclasses import replace

import numpy as np
import pytest

from sim.reference import reference_rig
from sim.remember import remembered
from sim.twin import linear_model


def test_equal_contents_are_computed_once_and_others_anew():
    calls = []

    @remembered(4)
    def doubled(x: np.ndarray, factor: float = 2.0) -> np.ndarray:
        calls.append(factor)
        return factor * x

    a = np.arange(3.0)
    assert doubled(a).tolist() == doubled(a.copy()).tolist() == [0.0, 2.0, 4.0]
    assert len(calls) == 1
    a[0] = 7.0  # the same object with other contents is another question
    assert doubled(a).tolist() == [14.0, 2.0, 4.0]
    assert doubled(a, factor=3.0).tolist() == [21.0, 3.0, 6.0]
    assert len(calls) == 3


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((np.zeros(4),), (np.zeros((2, 2)),)),
        ((np.zeros(2),), (np.zeros(2, dtype=np.int64),)),
        (((1.0, 2.0), 3.0), (1.0, (2.0, 3.0))),
        ((reference_rig().sensors,), (reference_rig().amplifiers,)),
        ((None,), (0.0,)),
    ],
    ids=["shape", "type of the values", "nesting", "class", "none"],
)
def test_arguments_that_differ_are_other_questions(one, other):
    calls = []

    @remembered(8)
    def asked(*what, **named) -> int:
        calls.append(what)
        return len(calls)

    assert [asked(*one), asked(*other), asked(*one), asked(*other)] == [1, 2, 1, 2]
    assert [asked(1.0, "x", 2.0), asked(1.0, x=2.0), asked(1.0, y=2.0)] == [3, 4, 5]


def test_a_kept_response_cannot_be_written_to():
    model = linear_model(reference_rig(), np.array([10.0, 100.0]))
    with pytest.raises(ValueError, match="read-only"):
        model.y_per_u[0] = 0.0


def test_a_rig_that_differs_in_one_value_has_its_own_response():
    rig, f = reference_rig(), np.array([10.0, 100.0])
    before = linear_model(rig, f).y_per_u
    heavier = replace(rig, rotor=replace(rig.rotor, mass_kg=rig.rotor.mass_kg * 1.001))
    assert not np.allclose(linear_model(heavier, f).y_per_u, before, rtol=1e-6)
    assert np.array_equal(linear_model(reference_rig(), f.copy()).y_per_u, before)


def test_a_rig_that_a_response_is_kept_of_cannot_be_written_to():
    """It would have that response from then on, whatever it had become."""
    rig = reference_rig()
    linear_model(rig, np.array([10.0, 100.0]))
    with pytest.raises(ValueError, match="read-only"):
        rig.magnets.ki[0] = 0.0


def test_objects_that_come_and_go_are_not_taken_for_each_other():
    """One that is gone leaves its place in memory to the next one."""
    sensors = reference_rig().sensors

    @remembered(64)
    def gain(of) -> float:
        return float(of.gain[0])

    def asked(value: float) -> float:
        return gain(replace(sensors, gain=np.full(4, value)))

    # the first one is held by its result; the second one, which is equal, by nobody
    told = [(asked(value), asked(value)) for value in range(1, 50)]
    assert told == [(value, value) for value in range(1, 50)]
