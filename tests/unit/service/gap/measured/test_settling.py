"""A rig that did not settle is told from one that did, however many of its points drift."""

import re
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.measured.settling import UNSETTLED, drifting, trend
from tests.support.synthetic import BLOCKS, known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane

DATASHEET, TRUTH = known_datasheet(seed=3)


def late(s: Sweep, share: float = 0.1) -> Sweep:
    """The displacement still decays in every point."""
    decay = 1 + share * np.exp(-np.arange(BLOCKS) / 2)
    return replace(s, Y=s.Y * decay[:, None, None])


def test_noise_alone_seldom_looks_like_a_trend_and_a_decay_always_does() -> None:
    settled = sweep(true_rig(TRUTH), np.geomspace(10, 900, 30), 0.15, seed=2)
    assert drifting(settled)[0].mean() < 0.06
    found, change = drifting(late(settled))
    assert found.mean() > UNSETTLED
    assert np.median(change[found]) == pytest.approx(0.1, rel=0.25)


def test_a_false_alarm_is_as_likely_as_it_is_said_to_be() -> None:
    rng = np.random.default_rng(5)
    probability, _ = trend(rng.standard_normal((4000, 6, 1)) + 1j * rng.standard_normal((4000, 6, 1)))
    assert np.mean(probability < 0.01) == pytest.approx(0.01, abs=0.006)


def test_blocks_too_few_for_a_trend_tell_nothing() -> None:
    settled = sweep(true_rig(TRUTH), np.geomspace(10, 900, 8), 0.15, seed=2)
    two = replace(settled, **{k: getattr(settled, k)[:, :2] for k in "RUIY"})
    assert not drifting(two)[0].any()


@pytest.mark.slow
def test_a_rig_that_did_not_settle_is_said_to_be_one_and_nothing_is_named() -> None:
    rig = true_rig(TRUTH)
    sweeps = (sweep(rig, np.geomspace(10, 950, 14), 0.15, 4), sweep(rig, np.geomspace(13, 900, 10), 0.3, 5))
    restless = Experiment(rig.name, rig.axes, tuple(map(late, sweeps)))
    report = gap_document(diagnose(*one_plane(restless, DATASHEET)))
    assert report["verdict"]["kind"] == "none_of_these"
    sentence = report["verdict"]["sentence"]
    assert "did not settle" in sentence
    told = re.search(r"half of them by more than ([\d.]+) %", sentence)
    assert told is not None
    assert float(told[1]) == pytest.approx(10.0, rel=0.25)
    assert any("had not settled" in note for note in report["notes"])


@pytest.mark.slow
def test_no_gap_is_not_said_of_a_rig_that_did_not_settle() -> None:
    """All signals still grow, in proportion, so that the twin fits their mean."""

    def growing(s: Sweep) -> Sweep:
        growth = 1 + 0.3 * np.linspace(-0.5, 0.5, BLOCKS)[:, None, None]
        return replace(s, **{k: getattr(s, k) * growth for k in "RUIY"})

    rig = true_rig(TRUTH)
    sweeps = (sweep(rig, np.geomspace(10, 950, 14), 0.15, 4), sweep(rig, np.geomspace(13, 900, 10), 0.3, 5))
    settled, restless = (
        diagnose(*one_plane(Experiment(rig.name, rig.axes, each), DATASHEET)).verdict
        for each in (sweeps, tuple(map(growing, sweeps)))
    )
    assert settled.kind == "no_gap"
    assert restless.kind == "none_of_these"
    assert "did not settle" in restless.reasons[0]
