"""Whether the planes are coupled: said where they are, and not where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as fisher

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.measured.coupling import RARE, cross_planes, usual_ratio
from sim.datasheet import Datasheet


def _leaking(experiment: Experiment, share: float) -> Experiment:
    """The same with sensors of plane y that see a share of x."""
    main = experiment.main
    y = main.Y.copy()
    y[..., 2:] += share * y[..., :2]
    sweeps = tuple(replace(s, Y=y) if s is main else s for s in experiment.sweeps)
    return replace(experiment, sweeps=sweeps)


def test_decoupled_planes_are_not_called_coupled(experiment: Experiment) -> None:
    found = cross_planes(experiment.main, experiment.axes)
    assert [(c.excited, c.seen) for c in found] == [("x", "y"), ("y", "x")]
    assert not any(c.coupled for c in found)
    assert all(c.over_noise == pytest.approx(1.25, abs=0.35) for c in found)  # the mean of F(2, 10)


def test_a_coupling_is_told_with_its_size(experiment: Experiment, datasheet: Datasheet) -> None:
    result = identify(_leaking(experiment, 0.03), datasheet)
    there, back = result.cross_planes
    assert there.coupled
    assert there.relative == pytest.approx(0.03, rel=0.02)
    assert not back.coupled
    assert [w for w in result.warnings if "plane y moves by 3 % of plane x" in w]
    assert result.document()["cross_planes"][0]["coupled"] is True


def test_a_transient_in_a_few_points_is_no_coupling(experiment: Experiment) -> None:
    main = experiment.main
    y = main.Y.copy()
    y[np.flatnonzero(main.axis < 2)[:3], :, :, 2:] += 1e-6
    assert not any(c.coupled for c in cross_planes(replace(main, Y=y), experiment.axes))


@pytest.mark.parametrize("blocks", [4, 6, 30])
def test_the_ratio_of_decoupled_planes_is_f_distributed(blocks: int) -> None:
    of_f = fisher(2, 2 * (blocks - 1))
    most, mean, std = usual_ratio(blocks)
    assert of_f.sf(most) == pytest.approx(RARE)
    assert mean == pytest.approx(of_f.expect(lambda x: min(x, most)), rel=1e-6)
    assert std == pytest.approx(of_f.std())
