"""An experiment tells two explanations apart as often as predicted, and no more than the rival can follow."""

from dataclasses import replace

import numpy as np
import pytest

from service.distributions import normal_tail
from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.stage import EXACT
from service.gap.measured.observation import observe
from service.gap.next_experiment import SURE, WORTH
from service.gap.proposal.case import Grounds, case, limits_of
from service.gap.proposal.options import options
from service.gap.proposal.sensor_noise import SensorNoise
from service.gap.proposal.separation import Predicted, left_over, separations
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

pytestmark = pytest.mark.slow
SHEET, TRUTH = known_datasheet(seed=1)
NU = nuisance(TRUTH)
LAG = {"sensor_lag": {"time_constant_s": 5e-7, "delay_s": 9.9e-6}}
EDDY = {"eddy_currents": {"time_constant_s": 3.1e-5, "corner_rad_s": 9e4}}
NOISE = 1.0
"""Of the sweeps below against the synthetic ones; it puts the odds half-way from a coin's to certainty."""


def explanation(effects: dict[str, dict[str, float]]) -> Candidate:
    values, k = tuple(effects.values()), len(NU)
    rig = with_effects(true_rig(TRUTH), effects)
    fit = Fit(tuple(effects), np.zeros(k), values, rig, (), 0.0, np.arange(k), np.eye(k), "converged")
    return Candidate(tuple(effects), fit, 0.0, tuple({} for _ in values))


A, B = explanation(LAG), explanation(EDDY)


def grounds(noise: float = NOISE) -> Grounds:
    faint = [sweep(A.fit.rig, np.geomspace(10.0, 950.0, 16), a, 3, noise) for a in (0.02, 0.04)]
    seen = tuple(observe(s, A.fit.rig) for s in faint)
    return Grounds(seen, SensorNoise.of(faint[0], A.fit.rig), True, limits_of(SHEET))


def named(name: str, there: Grounds):
    option = next(o for o in options(there.sweeps, A.fit.rig, there.limits) if o.name == name)
    planned = case(option, A.fit.rig, NU.rig, there)
    assert planned is not None
    return planned


def test_the_true_one_explains_the_outcome_better_as_often_as_predicted() -> None:
    """Twenty noisy outcomes of the proposed experiment, both explanations fitted to each."""
    planned = named("larger_amplitude", grounds())
    d = left_over(*(Predicted(NU, c, planned.main, planned.option) for c in (A, B)))
    points = sorted((p for p in planned.campaign.main if p.excited), key=lambda p: (p.frequency_hz, p.request.axis))
    hz, draws = np.unique([p.frequency_hz for p in points]), 20
    amplitude = np.array([p.request.amplitude_a for p in points])
    block_s = float(np.median([p.request.samples / 1e4 for p in points]))
    better = []
    with Fitter() as fitter:
        for seed in range(draws):
            told = sweep(A.fit.rig, hz, amplitude, 100 + seed, NOISE * np.sqrt(0.1 / block_s))
            o = observe(told, NU.rig)
            part = next(p for p in parts(NU, (o,)) if p.path == "plant")
            ground = Ground(NU, part, (o,), np.zeros(len(NU)))
            fits = fitter.run(Task(ground, c.effects, (c.fit.values,), c.fit.theta, (EXACT,)) for c in (A, B))
            cost = [c.fit.chi_square + c.fit.penalty for c in fits]
            better.append((cost[1] - cost[0]) / 2)
    expected = draws * normal_tail(-d / 2)

    assert 1.5 < d < 3.5, "an experiment that may fail"
    assert np.mean(better) == pytest.approx(d**2 / 2, abs=3 * d / np.sqrt(draws))
    assert abs(np.sum(np.array(better) > 0) - expected) <= 3 * np.sqrt(expected * (1 - expected / draws))


def test_a_rival_follows_with_its_own_parameters() -> None:
    """Half the delay is the same effect, and a half-order law with a corner this high is a first-order lag."""
    planned = named("larger_amplitude", grounds(1.0))
    half = explanation({"sensor_lag": {"time_constant_s": 5e-7, "delay_s": 5e-6}})
    assert max(separations(NU, A, half, planned.main, planned.option)) < 0.5
    lag = explanation({"sensor_lag": {"time_constant_s": 5e-7, "delay_s": 0.0}})
    same = explanation({"eddy_currents": {"time_constant_s": 6.8e-7, "corner_rad_s": 3e5}})
    assert max(separations(NU, lag, same, planned.main, planned.option)) < 1.0


def test_what_another_law_of_the_true_effect_leaves_tells_nothing() -> None:
    """A long delay and a slower amplifier differ by less than two programs' delays do, unless the band is wide."""
    late = explanation({"loop_delay": {"delay_s": 3.5e-5}})
    slow = explanation({"amplifier_bandwidth": {"frequency_change": 0.082, "damping_change": -0.031, "lag_s": 4.86e-5}})
    again, wide = (named(name, grounds()) for name in ("larger_amplitude", "wide_band"))
    seen = left_over(*(Predicted(NU, c, again.main, again.option) for c in (late, slow)))
    assert seen > 10, "noise would not keep them together"
    odds = [1 - normal_tail(min(separations(NU, late, slow, c.main, c.option)) / 2) for c in (again, wide)]
    assert odds[0] < WORTH < SURE < odds[1]


def test_parameters_of_linear_effects_leave_the_magnets_nonlinearity_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """That moves no odds."""
    planned = named("larger_amplitude", grounds())
    quick = separations(NU, A, B, planned.main, planned.option)
    monkeypatch.setattr("service.gap.proposal.separation.slow_to_compute", lambda name: True)
    assert quick == pytest.approx(separations(NU, A, B, planned.main, planned.option), rel=2e-3)


def test_more_noise_separates_less_and_more_amplitude_more() -> None:
    quiet, loud = grounds(), grounds(4 * NOISE)
    distances = [separations(NU, A, B, (c := named("speed", there)).main, c.option)[0] for there in (quiet, loud)]
    assert distances[1] <= 1.05 * distances[0], "the planner makes up for noise by amplitude as far as it may"
    small, large = (named(f"{name}_amplitude", quiet) for name in ("smaller", "larger"))
    assert separations(NU, A, B, small.main, small.option)[0] < separations(NU, A, B, large.main, large.option)[0]


def test_means_do_not_count_where_a_set_point_was_moved_by_hand() -> None:
    planned = named("set_point", grounds())
    sd = planned.main.sd_y.copy()
    sd[:, planned.main.harmonics.index(0)] = np.inf
    blind = replace(planned.main, sd_y=sd)
    known = separations(NU, A, B, planned.main, planned.option)
    assert known == pytest.approx(separations(NU, A, B, blind, planned.option), rel=1e-6)
