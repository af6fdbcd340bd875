"""Lines and amplitudes of a main multisine by what a pilot tells of the rig: more where it tells, limits kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.campaign.aims import Limits
from service.campaign.multisine.design import FLOOR, Design, PlaneDesign, design_of
from service.campaign.multisine.phases import LONGEST_S, MultisinePhases
from service.campaign.multisine.plan import MultisineProfile
from service.experiment.data import Sweep
from service.identification.input_design import line_information
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, relative_std, synthetic_experiment, synthetic_sweep

SHEET = reference_datasheet()
CONTROLLER = (np.array(SHEET.numerator), np.array(SHEET.denominator))
TRUTH = {p: plane_model_of(reference_rig(), p) for p in "xy"}
PILOT = np.unique(np.round(np.geomspace(11, 2500, 220)) // 2 * 2 + 1)
MAIN = np.unique(
    np.concatenate([np.round(np.geomspace(11, 999, 120)) // 2 * 2 + 1, np.arange(487.0, 500, 2), PILOT[:9]])
)
MAIN = np.unique(np.concatenate([MAIN, np.arange(901.0, 914, 2)]))
LIMITS = (20e-6, 0.7, 0.7)


@pytest.fixture(scope="module")
def pilot() -> Sweep:
    sweep = synthetic_sweep(
        TRUTH, SHEET.axes, CONTROLLER, PILOT, 1e-3, current_noise_a=3e-5, displacement_noise_m=2e-10, seed=3
    )
    return synthetic_experiment(sweep, axes=SHEET.axes).main


@pytest.fixture(scope="module")
def design(pilot: Sweep) -> Design:
    found = design_of(pilot, SHEET, 1000.0)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def amplitudes(design: Design) -> np.ndarray:
    return design.amplitudes(MAIN, np.ones((len(MAIN), 4)), *LIMITS)


def mean_squares(design: Design, amplitudes: np.ndarray) -> np.ndarray:
    """(3, 4) of y, i and r over the limits' squares."""
    zero = np.zeros((len(MAIN), 4, 4), dtype=complex)
    found = design.responses(MAIN, dict.fromkeys("uiy", zero))
    own = np.broadcast_to(np.eye(4), zero.shape)
    return np.array(
        [
            np.einsum("lsj,lj->s", np.abs(x) ** 2, amplitudes**2) / limit**2
            for x, limit in zip((found["y"], found["i"], own), LIMITS, strict=True)
        ]
    )


def with_delay(seconds: float) -> Design:
    """Planes whose loop damps the first mode the less the later the current comes."""
    planes = []
    for k, model in enumerate(TRUTH.values()):
        theta = model.theta.copy()
        theta[model.layout.delay] = seconds
        planes.append(PlaneDesign((2 * k, 2 * k + 1), (model.at(theta),), np.empty(0), np.empty((0, 4))))
    return Design(tuple(planes), CONTROLLER)


def first_settling(design: Design | None, max_samples: int) -> float:
    limits = Limits(4, 10e3, 3000.0, max_samples, 1.0, 1e-4, 10.0, 8e-5, 2.75, 4e-4)
    phases = MultisinePhases(None, limits, MultisineProfile(settle_s=1.2), None, {}, {})  # type: ignore[arg-type]
    phases.design = design
    return phases._first_settling()


def test_a_sweep_settles_for_as_long_as_the_slowest_mode_rings() -> None:
    """The reference loop damps mode 1 of plane y with 5.5 1/s, 30 us later with 0.8 1/s, and 40 us later not at all."""
    assert with_delay(0.0).settle_s() == pytest.approx(np.log(100) / 5.5, rel=0.02)
    assert with_delay(30e-6).settle_s() == pytest.approx(np.log(100) / 0.82, rel=0.02)
    assert with_delay(40e-6).settle_s() == np.inf
    plenty = 10**6
    assert first_settling(None, plenty) == 1.2
    assert first_settling(with_delay(0.0), plenty) == 1.2
    assert 5.0 < first_settling(with_delay(30e-6), plenty) < 6.0
    assert first_settling(with_delay(40e-6), plenty) == LONGEST_S
    # a record's length is the controller's
    assert 1.9 < first_settling(with_delay(40e-6), 80_000) < 2.0


def test_every_peak_of_the_rotor_is_in_a_band_of_its_width(design: Design) -> None:
    bands = design.peaks_hz()
    assert len(bands) == 4
    for (low, high), nu in zip(bands, np.concatenate([m.modes[:, 0] for m in TRUTH.values()]), strict=True):
        assert low < nu / (2 * np.pi) < high
        assert high - low < 0.01 * high


def test_damping_is_told_far_better_and_stiffness_no_worse_at_the_same_limits(
    design: Design, amplitudes: np.ndarray
) -> None:
    flat = np.ones_like(amplitudes)
    noise = np.tile(np.array([4e-5, 4e-5, 4e-10, 4e-10]) ** 2, (len(MAIN), 1))
    for p, model in enumerate(TRUTH.values()):
        told = line_information(model, CONTROLLER, 2 * np.pi * MAIN, noise, 2 * np.pi * 1000)
        pair = slice(2 * p, 2 * p + 2)
        designed, usual = (
            relative_std(told, a[:, pair] ** 2 / mean_squares(design, a)[:, pair].max()) for a in (amplitudes, flat)
        )
        assert np.all(designed[4:] < 0.3 * usual[4:])
        assert np.all(designed[:4] < usual[:4])


def test_no_line_falls_below_the_floor_and_no_axis_is_beyond_another_limit(
    design: Design, amplitudes: np.ndarray
) -> None:
    flat = np.ones_like(amplitudes)
    squares = mean_squares(design, flat)
    for p in range(2):
        pair = slice(2 * p, 2 * p + 2)
        floor = FLOOR * flat[:, pair] ** 2 / squares[:, pair].max()
        assert np.all(amplitudes[:, pair] ** 2 > 0.98 * floor)
        assert mean_squares(design, amplitudes)[:, pair].max() == pytest.approx(1.0, abs=0.05)


def test_noise_is_nothing_that_a_model_should_explain(pilot: Sweep) -> None:
    """Ten times the pilot's: peaks are placed less well, and their bands are wider."""
    loud = synthetic_sweep(
        TRUTH, SHEET.axes, CONTROLLER, PILOT, 1e-3, current_noise_a=3e-4, displacement_noise_m=2e-9, seed=4
    )
    said: list[str] = []
    found = design_of(synthetic_experiment(loud, axes=SHEET.axes).main, SHEET, 1000.0, said.append)
    assert said == []
    assert found is not None
    for (low, high), nu in zip(found.peaks_hz(), np.concatenate([m.modes[:, 0] for m in TRUTH.values()]), strict=True):
        assert low < nu / (2 * np.pi) < high


def test_a_pilot_that_no_model_explains_designs_nothing_and_says_why(pilot: Sweep) -> None:
    said: list[str] = []
    other = replace(SHEET, numerator=tuple(1.4 * c for c in SHEET.numerator))
    assert design_of(pilot, other, 1000.0, said.append) is None
    assert "% of the pilot" in said[0]
    assert design_of(pilot.select(pilot.axis == 0), SHEET, 1000.0, said.append) is None
    assert "xB" in said[1]
    assert design_of(replace(pilot, speed_rad_s=100.0), SHEET, 1000.0, said.append) is None
    assert "speed" in said[2]
