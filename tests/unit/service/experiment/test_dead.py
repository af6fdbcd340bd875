"""A dead sensor, or channel of the log, is told by its name before anything is fitted."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.experiment.dead import require_live_channels
from service.gap.observed import observed
from service.identification.fit import identify
from sim.errors import AmbError
from tests.support.measured import small_experiment

EXPERIMENT, SHEET = small_experiment()


def with_channel(signal: str, axis: int, reads: complex | np.ndarray) -> Experiment:
    values = getattr(EXPERIMENT.main, signal).copy()
    values[..., axis] = reads
    return replace(EXPERIMENT, sweeps=(replace(EXPERIMENT.main, **{signal: values}), *EXPERIMENT.sweeps[1:]))


@pytest.mark.parametrize(
    ("signal", "axis", "reads", "told"),
    [
        ("Y", 1, 0.0, "y of xB reads 0 m"),
        ("Y", 2, 3e-6 - 4e-6j, "y of yA reads 5e-06 m"),
        ("I", 0, 0.0, "i of xA reads 0 A .* or leave i out"),
        ("U", 3, 0.0, "u of yB reads 0 A"),
    ],
)
def test_a_dead_channel_is_named(signal, axis, reads, told) -> None:
    dead = with_channel(signal, axis, reads)
    with pytest.raises(AmbError, match=rf"sweeps/0 \(main\): {told}"):
        identify(dead, SHEET)
    with pytest.raises(AmbError, match=rf"sweeps/0: {told}"):
        observed(dead, SHEET)


@pytest.mark.parametrize(
    ("size_m", "told"), [(1e-19, "reads .* m in every block"), (2e-9, r"is no more than noise \(2.*e-09 m\)")]
)
def test_rounding_and_noise_are_no_answer(size_m: float, told: str) -> None:
    shape = EXPERIMENT.main.Y.shape[:-1]
    noise = size_m * np.random.default_rng(0).normal(size=(*shape, 2)).view(complex)[..., 0]
    with pytest.raises(AmbError, match=f"y of xB {told}"):
        identify(with_channel("Y", 1, noise), SHEET)


def test_a_channel_that_is_heard_at_most_points_is_live() -> None:
    y = EXPERIMENT.main.Y[..., 1].copy()
    y[::3] = 0
    require_live_channels(with_channel("Y", 1, y).main, SHEET.axes, "sweeps/0")


@pytest.mark.parametrize(("signal", "pair"), [("Y", (1, 2)), ("U", (0, 3))])
def test_channels_that_were_swapped_between_planes_are_not_called_dead(signal: str, pair: tuple[int, int]) -> None:
    values = getattr(EXPERIMENT.main, signal).copy()
    for plane in ((0, 1), (2, 3)):  # planes that are not coupled, without noise
        excited = np.isin(EXPERIMENT.main.axis, plane)
        values[np.ix_(~excited, range(values.shape[1]), range(values.shape[2]), plane)] = 0
    values[..., list(pair)] = values[..., list(reversed(pair))]
    swapped = replace(EXPERIMENT, sweeps=(replace(EXPERIMENT.main, **{signal: values}), *EXPERIMENT.sweeps[1:]))
    one, other = (SHEET.axes[k] for k in pair)
    with pytest.raises(AmbError, match=f"{signal.lower()} of {one} answers to what excites {other}.*are swapped"):
        observed(swapped, SHEET)


def test_a_channel_that_is_dead_in_the_other_sweep_is_named_with_that_sweep() -> None:
    main, other, *rest = EXPERIMENT.sweeps
    y = other.Y.copy()
    y[..., 1] = 0
    with pytest.raises(AmbError, match=r"sweeps/1: y of xB reads 0 m"):
        observed(replace(EXPERIMENT, sweeps=(main, replace(other, Y=y), *rest)), SHEET)


@pytest.mark.slow
def test_points_at_which_the_log_was_interrupted_are_left_out_and_told() -> None:
    main = EXPERIMENT.main
    lost = np.isin(np.arange(main.n_points), [4, 5, 9])
    silent = {name: np.where(lost[:, None, None, None], 0, getattr(main, name)) for name in ("U", "I", "Y")}
    data = observed(replace(EXPERIMENT, sweeps=(replace(main, **silent), *EXPERIMENT.sweeps[1:])), SHEET)
    whole = observed(EXPERIMENT, SHEET)
    assert len(data.o.line) == len(whole.o.line) - 3
    assert any("exactly zero at 3 points" in note for note in data.notes)
    assert not any("exactly zero" in note for note in whole.notes)
    y_alone = replace(EXPERIMENT, sweeps=(replace(main, Y=silent["Y"]), *EXPERIMENT.sweeps[1:]))
    assert len(observed(y_alone, SHEET).o.line) == len(whole.o.line), "one channel may read zero, as a coarse one does"


@pytest.mark.slow
def test_the_datasheet_of_another_rig_is_told_by_its_name() -> None:
    notes = observed(EXPERIMENT, replace(SHEET, name="compressor 2")).notes
    assert any("datasheet of rig compressor 2" in note for note in notes)
    assert not any("datasheet of rig" in note for note in observed(replace(EXPERIMENT, rig=SHEET.name), SHEET).notes)
