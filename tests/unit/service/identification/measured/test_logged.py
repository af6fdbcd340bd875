"""A log that is out of step, or has a spoilt block, is mended before the fit; a controller that is not u's is told."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.measured.logged import Checked, _Difference, _spoilt, checked
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from sim.datasheet import Datasheet
from sim.folded import folded


def check(experiment: Experiment, datasheet: Datasheet) -> Checked:
    twin = folded(datasheet)
    return checked(experiment, twin.datasheet, twin.chain)


def early(experiment: Experiment, samples: float) -> Experiment:
    """Its u logged so many samples early."""
    sweeps = []
    for s in experiment.sweeps:
        omega = 2 * np.pi * s.frequency_hz
        sweeps.append(replace(s, U=s.U * np.exp(1j * samples * omega / s.sample_rate_hz)[:, None, None, None]))
    return replace(experiment, sweeps=tuple(sweeps))


def with_lost_samples(experiment: Experiment, block: int) -> Experiment:
    """Of the main sweep u is nought for a hundredth of ``block``."""
    main = experiment.main
    U = main.U.copy()
    U[:, block] *= 0.99
    return replace(experiment, sweeps=(replace(main, U=U), *experiment.sweeps[1:]))


def test_a_sound_log_is_left_alone(experiment: Experiment, datasheet: Datasheet) -> None:
    found = check(experiment, datasheet)
    assert found.warnings == ()
    assert not found.controller_differs
    assert found.chain.logging_offset_samples == 0
    for s, t in zip(found.experiment.sweeps, experiment.sweeps, strict=True):
        assert s is t


@pytest.mark.parametrize("samples", [-3, -1, 1, 2])
def test_u_that_is_out_of_step_is_told_by_whole_samples(
    experiment: Experiment, datasheet: Datasheet, samples: int
) -> None:
    found = check(early(experiment, samples), datasheet)
    assert found.chain.logging_offset_samples == samples
    (said,) = found.warnings
    assert f"{abs(samples)} sample" in said
    assert ("early" if samples > 0 else "late") in said
    assert f"samples = {samples} in the twin" in said


def test_an_offset_that_the_twin_names_is_not_told_again(experiment: Experiment, datasheet: Datasheet) -> None:
    named = replace(datasheet, effects=(("logging_offset", (("samples", 1.0),)),))
    found = check(early(experiment, 1), named)
    assert found.warnings == ()
    assert found.chain.logging_offset_samples == 1


@pytest.mark.slow
def test_the_plant_is_the_same_from_a_log_out_of_step(
    experiment: Experiment, datasheet: Datasheet, result: CommissioningResult, truth: dict[str, PlaneModel]
) -> None:
    found = identify(early(experiment, -2), datasheet)
    assert any("2 samples late" in w for w in found.warnings)
    for name, plane in found.planes.items():
        as_it_was = result.planes[name]
        assert plane.delay_s.value == pytest.approx(truth[name].delay_s, abs=4 * plane.delay_s.std)
        for key, s in plane.stiffness.items():
            assert s.value == pytest.approx(as_it_was.stiffness[key].value, abs=0.1 * s.std)


@pytest.mark.parametrize("block", [1, 5])
def test_a_block_with_lost_sampless_is_left_out(experiment: Experiment, datasheet: Datasheet, block: int) -> None:
    found = check(with_lost_samples(experiment, block), datasheet)
    (said,) = found.warnings
    assert said.startswith(f"sweeps/0: u of block {block + 1} of 6 ")
    assert said.endswith("left out")
    main = experiment.main
    rest = np.delete(np.arange(6), block)
    for name in ("R", "U", "I", "Y"):
        assert np.array_equal(getattr(found.experiment.main, name), getattr(main, name)[:, rest])
    assert found.experiment.sweeps[1] is experiment.sweeps[1]


def test_what_still_rings_in_the_first_blocks_is_no_lost_sample(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    decay = np.exp(-1.5 * np.arange(6))[None, :, None, None]
    ringing = replace(main, U=main.U * (1 + 0.01 * decay))
    found = check(replace(experiment, sweeps=(ringing,)), datasheet)
    assert found.experiment.main is ringing
    assert found.warnings == ()


def test_noise_in_a_few_points_that_differ_is_no_lost_sample() -> None:
    """As in the coarse sweep of a health check: a median over all of them is that of one or two."""
    rng = np.random.default_rng(0)
    n, blocks = 16, 6
    u = np.ones((n, blocks), dtype=complex)
    for _ in range(1000):
        noise = rng.standard_normal((n, blocks)) + 1j * rng.standard_normal((n, blocks))
        noise *= 2e-3 * np.exp(1.5 * rng.standard_normal(n))[:, None]
        found = _Difference(np.zeros(n, dtype=int), np.ones(n, dtype=complex), u, u - noise, 0 * u)
        assert not len(_spoilt(found, 0.0))
        found.u[:, 4] += 0.05  # what lost samples do is larger by far
        assert _spoilt(found, 0.0).tolist() == [4]
        found.u[:, 4] -= 0.05


def test_too_few_blocks_are_kept_and_the_remedy_told(experiment: Experiment, datasheet: Datasheet) -> None:
    spoilt = with_lost_samples(experiment, 2)
    main = spoilt.main
    few = replace(main, R=main.R[:, :3], U=main.U[:, :3], I=main.I[:, :3], Y=main.Y[:, :3])
    found = check(replace(spoilt, sweeps=(few,)), datasheet)
    assert found.experiment.main is few
    (said,) = found.warnings
    assert said.endswith("measure again")


def test_another_controller_is_told_and_the_log_left_as_it_is(experiment: Experiment, datasheet: Datasheet) -> None:
    stiffer = replace(datasheet, numerator=tuple(1.05 * x for x in datasheet.numerator))
    found = check(experiment, stiffer)
    assert found.controller_differs
    assert found.chain.logging_offset_samples == 0
    (said,) = found.warnings
    assert all(axis in said for axis in datasheet.axes)
    assert "controller" in said
    for s, t in zip(found.experiment.sweeps, experiment.sweeps, strict=True):
        assert s is t


@pytest.mark.parametrize("signal", ["U", "R", "Y"])
def test_a_signal_of_the_wrong_sign_is_told_with_its_axes(
    experiment: Experiment, datasheet: Datasheet, signal: str
) -> None:
    """A displacement is logged as its sensor has it, a controller may have turned it; a plane is fitted to it all the
    same, and ends anywhere."""
    main = experiment.main
    X = getattr(main, signal).copy()
    X[..., 1] *= -1
    turned = replace(experiment, sweeps=(replace(main, **{signal: X}),))
    (said,) = check(turned, datasheet).warnings
    assert f"{signal.lower()} of {experiment.axes[1]} is logged with the opposite sign" in said
