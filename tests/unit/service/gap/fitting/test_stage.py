"""When a pass of a fit has converged."""

import numpy as np
import pytest

from service.gap.fitting.fit import Problem
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.objective import Objective
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE, Stage
from service.gap.measured.observation import observe
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

NOISE = 4400.0


def test_an_exact_fit_goes_on_while_a_chi_square_falls_that_evidence_would_see() -> None:
    """Most of this cost is noise: by a share of it, two units, fits ended along flat directions above the optimum."""
    assert EXACT.negligible(NOISE, NOISE) < 1.0
    assert EXACT.negligible(0.9 * NOISE, NOISE) == EXACT.negligible(NOISE, NOISE) > 0.0


def test_what_an_explanation_leaves_far_above_noise_need_not_be_fitted_so_finely() -> None:
    assert EXACT.negligible(1e6, NOISE) > 100.0


def test_a_rough_pass_ends_by_a_share_of_its_cost() -> None:
    assert COARSE.negligible(1000.0, NOISE) == 1000.0 * COARSE.tolerance
    assert COARSE.negligible(0.0, NOISE) == COARSE.tolerance


def objective_of(stage: Stage, effects: dict[str, dict[str, float]]) -> tuple[Problem, Objective]:
    """Of the plain twin, for a rig that may have effects."""
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(datasheet)
    o = observe(sweep(with_effects(true_rig(truth), effects), lines(14), 0.1, seed=1), nu.rig)
    problem = Problem(Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu))))
    return problem, Objective(problem.model, stage)


@pytest.mark.parametrize("stage", [MIDDLE, EXACT], ids=["middle", "exact"])
def test_noise_costs_what_a_stage_expects_of_it(stage: Stage) -> None:
    """A stage that allows an error beside the noise was taken to have ten times the noise that it has."""
    problem, objective = objective_of(stage, {})
    fit = problem.run(np.zeros(problem.unknowns.n_nuisance), EXACT)
    state = objective.fresh_state(problem.unknowns.vector(fit))
    assert state.cost == pytest.approx(objective.noise, rel=0.35)


def test_a_rough_stage_ends_once_only_noise_is_left_and_steps_change_nothing_that_counts() -> None:
    problem, objective = objective_of(MIDDLE, {})
    fit = problem.run(np.zeros(problem.unknowns.n_nuisance), EXACT)
    state = objective.fresh_state(problem.unknowns.vector(fit))
    assert objective.done(state, drop=5e-4 * state.size)
    assert not objective.done(state, drop=5e-3 * state.size), "it walks along a valley"


def test_a_rough_stage_goes_on_where_an_effect_leaves_more_than_noise() -> None:
    problem, objective = objective_of(MIDDLE, {"sensor_lag": {}})
    fit = problem.run(np.zeros(problem.unknowns.n_nuisance), EXACT)
    state = objective.fresh_state(problem.unknowns.vector(fit))
    limit = objective.stage.negligible(state.cost, objective.noise)
    assert not objective.done(state, drop=1.01 * limit)
