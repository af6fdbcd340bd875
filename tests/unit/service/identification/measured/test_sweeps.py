"""Sweeps that were measured plane by plane, or bearing by bearing, are one; which others are is told."""

from dataclasses import fields, replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.exports.responses import of_experiment
from service.identification.measured.sweeps import chosen_sweeps
from sim.reference import reference_rig
from tests.support.commissioned import AXES, LAW
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

HZ = np.geomspace(10, 1000, 9)
WHOLE = synthetic_sweep({p: plane_model_of(reference_rig(), p) for p in "xy"}, AXES, LAW, HZ, 0.05, seed=1)
WHOLE = replace(WHOLE, block_samples=np.full(WHOLE.n_points, 4000), flags=("",) * 3 + ("repeated",) + ("",) * 32)


def experiment_of(*sweeps: Sweep) -> Experiment:
    return synthetic_experiment(*sweeps, axes=AXES, rig="reference")


def of_axes(*axes: int) -> Sweep:
    return WHOLE.select(np.isin(WHOLE.axis, axes))


@pytest.mark.parametrize(
    "parts",
    [((0, 1), (2, 3)), ((2, 3), (0, 1)), ((0,), (1,), (2, 3)), ((0, 2), (1, 3)), ((0, 1), (0, 1, 2, 3))],
    ids=str,
)
def test_parts_that_excite_other_axes_are_one_sweep(parts) -> None:
    chosen = chosen_sweeps(experiment_of(*(of_axes(*p) for p in parts)))
    found = chosen.main.sweep
    order = np.argsort(found.axis, kind="stable")
    for field in fields(Sweep):
        a, b = getattr(found.select(order), field.name), getattr(WHOLE, field.name)
        np.testing.assert_array_equal(a, b, err_msg=field.name)
    assert chosen.main.name == ", ".join(f"sweeps/{k} (main)" for k in range(len(parts)))
    assert chosen.validation is None
    assert chosen.notes == ()


def test_both_planes_of_such_a_file_are_exported() -> None:
    parts, whole = experiment_of(of_axes(2, 3), of_axes(0, 1)), experiment_of(WHOLE)
    for plane, found in of_experiment(whole).items():
        np.testing.assert_array_equal(of_experiment(parts)[plane].value, found.value)


def test_a_repeated_sweep_and_one_at_speed_are_no_part_of_the_main_one() -> None:
    again = replace(of_axes(0, 1), comment="again")
    fast = replace(of_axes(2, 3), speed_rad_s=100.0)
    chosen = chosen_sweeps(experiment_of(of_axes(0, 1), again, fast))
    assert chosen.main.places == (0,)
    assert chosen.validation is not None
    assert chosen.validation.places == (1,)
    assert chosen.speeds_rad_s == (0.0, 100.0)


def test_sweeps_of_a_rotor_that_rests_are_of_one_speed_whatever_little_the_controller_tells() -> None:
    parts = [replace(of_axes(*p), speed_rad_s=w) for p, w in (((0, 1), 0.02), ((2, 3), -0.01))]
    chosen = chosen_sweeps(experiment_of(*parts, replace(WHOLE, speed_rad_s=100.0)))
    assert chosen.main.places == (0, 1)
    assert chosen.notes == ()
    assert chosen.speeds_rad_s == (0.0, 100.0)


def test_of_parts_with_other_blocks_and_harmonics_what_both_have_is_used_and_told() -> None:
    y = of_axes(2, 3)
    more = {k: np.repeat(getattr(y, k), 2, axis=2)[:, :4] for k in "RUIY"}
    chosen = chosen_sweeps(experiment_of(of_axes(0, 1), replace(y, harmonics=(1, 2), **more)))
    assert chosen.main.sweep.harmonics == (1,)
    assert chosen.main.sweep.Y.shape == (36, 4, 1, 4)
    assert chosen.notes == (
        "sweeps/1 excites yA, yB and has another number of blocks than sweeps/0: the first 4 of each are used",
    )


@pytest.mark.parametrize(
    ("other", "what"),
    [
        ({"sample_rate_hz": 5e3}, "sample rate"),
        ({"I": None}, "set of signals (i)"),
        ({"kind": "multisine"}, "kind of excitation"),
    ],
    ids=["rate", "currents", "kind"],
)
def test_a_part_that_was_recorded_otherwise_is_left_out_and_told(other, what: str) -> None:
    chosen = chosen_sweeps(experiment_of(of_axes(0, 1), replace(of_axes(2, 3), **other)))
    assert chosen.main.places == (0,)
    assert chosen.notes == (
        f"sweeps/1 excites yA, yB, which sweeps/0 does not, but has another {what} and is left out; "
        "measure both alike, or identify each from a file of its own",
    )
