"""What takes long to fit is given up where another effect explains the gap, and only there."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task, fit_task
from service.gap.fitting.fit import Problem
from service.gap.fitting.fitted import Fit
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE, PROBE, WHOLE_PROBE, Stage
from service.gap.which import first_fits as module
from service.gap.which.first_fits import (
    HIDDEN,
    OUT_OF_REACH,
    USELESS,
    Limits,
    ends_of_plain_twin,
    first_fits,
    limits_of,
)
from service.gap.which.one_more_effect import rough_beside
from sim.effects import CATALOGUE
from tests.unit.service.gap.where.test_dependence import plant

Real = NDArray[np.float64]
pytestmark = pytest.mark.slow
LONG = ("extra_flexible_mode", "magnetic_hysteresis", "magnetic_saturation", "off_centre_rotor", "support_resonance")


Passes = dict[str, Counter[Stage]]
PASSES: Passes = defaultdict(Counter)
"""How often fits of each effect have gone through each stage, since a test cleared them."""


@pytest.fixture(scope="module", autouse=True)
def recorded() -> Iterator[None]:
    run = Problem.run

    def recording(self: Problem, x: Real, stage: Stage) -> Fit:
        for effect in self.unknowns.effects:
            PASSES[effect.id][stage] += 1
        return run(self, x, stage)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Problem, "run", recording)
        yield


def found_in(kind: str, *names: str) -> dict[str, Candidate]:
    PASSES.clear()
    e, _ = plant(kind)
    with Fitter(1) as fitter:
        found = first_fits(fitter, e.ground, (e.null.candidate, e.plain), names)
    return {c.effects[0]: c for c in found}


@pytest.fixture(scope="module")
def fits_of_a_lag() -> tuple[dict[str, Candidate], Passes]:
    return found_in("gross", *LONG, "sensor_gain", "sensor_lag"), dict(PASSES)


@pytest.fixture(scope="module")
def of_a_lag(fits_of_a_lag: tuple[dict[str, Candidate], Passes]) -> dict[str, Candidate]:
    return fits_of_a_lag[0]


def test_what_takes_long_ends_after_the_coarse_stage_and_one_probe(
    fits_of_a_lag: tuple[dict[str, Candidate], Passes],
) -> None:
    _, passes = fits_of_a_lag
    assert all(set(passes[name]) == {COARSE, PROBE} and passes[name][PROBE] == 1 for name in LONG)
    assert all(set(passes[name]) == {COARSE, MIDDLE, PROBE} for name in ("sensor_gain", "sensor_lag"))


def test_starts_that_lead_to_one_minimum_are_followed_once() -> None:
    e, _ = plant("linear")
    start = ({"time_constant_s": 1e-5},)
    PASSES.clear()
    fit_task(Task(e.ground, ("sensor_lag",), (start, start), e.ground.theta, (COARSE, MIDDLE, EXACT)))
    assert PASSES["sensor_lag"] == {COARSE: 2, MIDDLE: 1, EXACT: 1}


def test_no_effect_is_left_out_and_the_true_one_is_fitted_to_its_end(of_a_lag: dict[str, Candidate]) -> None:
    assert set(of_a_lag) == {*LONG, "sensor_gain", "sensor_lag"}
    best = min(of_a_lag.values(), key=lambda c: c.fit.cost)
    assert best.effects == ("sensor_lag",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals, "to noise"
    null = plant("gross")[0].null.candidate
    assert all(of_a_lag[name].fit.cost > 10 * best.fit.cost for name in LONG)
    assert all(of_a_lag[name].fit.cost < 2 * null.fit.cost for name in LONG), "given up, but not thrown away"


def test_what_was_given_up_is_no_better_when_it_is_not(
    of_a_lag: dict[str, Candidate], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "OUT_OF_REACH", math.inf)
    to_the_end = found_in("gross", *LONG, "sensor_lag")
    assert all(set(PASSES[name]) == {COARSE, MIDDLE, PROBE} for name in LONG)
    assert all(to_the_end[name].fit.cost > 10 * of_a_lag["sensor_lag"].fit.cost for name in LONG)


def test_a_limit_is_set_by_the_gap_and_only_where_an_effect_explains_it(of_a_lag: dict[str, Candidate]) -> None:
    e, null = plant("gross")[0], plant("gross")[0].null.candidate
    assert rough_beside(null, e.ground) == (COARSE, MIDDLE)
    lag, gain = of_a_lag["sensor_lag"], of_a_lag["sensor_gain"]
    ends = ends_of_plain_twin(e.ground, null, (COARSE, MIDDLE))
    for found in ([], [gain]):
        none = limits_of(e.ground, null, found, ends)
        assert none.most_left == none.by_first == {}
        assert none.by_first_of_slow == {COARSE: pytest.approx(USELESS * ends[COARSE].left)}, "which is plain to see"
    limits = limits_of(e.ground, null, [gain, lag], ends)
    most, plain_left = limits.most_left, (null.fit.cost - null.fit.n_residuals) / null.fit.n_residuals
    assert 0 < most[COARSE] < most[MIDDLE] < OUT_OF_REACH * plain_left, "of the gap beyond the floor of the stage"
    assert all(most[stage] < limits.by_first[stage] < ends[stage].left for stage in (COARSE, MIDDLE))


def test_other_starts_are_not_tried_where_the_best_one_leaves_most_of_a_gap_that_another_effect_explains(
    fits_of_a_lag: tuple[dict[str, Candidate], Passes],
) -> None:
    _, passes = fits_of_a_lag
    assert all(passes[name][COARSE] == 1 for name in LONG)


def test_where_nothing_explains_a_plain_gap_a_nonlinear_effect_that_takes_nothing_off_it_is_tried_once() -> None:
    found_in("gross", "magnetic_hysteresis", "sensor_gain", "support_resonance")
    assert PASSES["magnetic_hysteresis"] == {COARSE: 1, MIDDLE: 1, PROBE: 1}
    assert PASSES["support_resonance"][COARSE] > 1, "a resonance has many valleys"


@pytest.mark.parametrize(("most", "tried"), [(0.5, 1), (2.0, 2)])
def test_the_first_start_alone_is_tried_where_it_leaves_more_than_it_may(most: float, tried: int) -> None:
    """``most`` is in units of what it leaves."""
    e, _ = plant("linear")
    starts = (({"gain_change_xA": 0.02},), ({"gain_change_xA": -0.02},))
    task = Task(e.ground, ("sensor_gain",), starts, e.ground.theta, (COARSE, MIDDLE, EXACT))
    problem = Problem(e.ground, [CATALOGUE["sensor_gain"]])
    x = np.concatenate([task.theta[problem.unknowns.active], problem.unknowns.scaled(starts[0])])
    left = problem.left_by(problem.run(x, COARSE), COARSE)
    PASSES.clear()
    fit_task(replace(task, most_left_by_first={COARSE: most * left}))
    assert PASSES["sensor_gain"][COARSE] == tried
    assert PASSES["sensor_gain"][EXACT] >= 1, "and followed to its end"


def test_a_stage_that_cannot_see_the_gap_sorts_no_starts() -> None:
    e, _ = plant("linear")
    null = e.null.candidate
    ends = ends_of_plain_twin(e.ground, null, rough_beside(null, e.ground))
    assert ends[COARSE].left < HIDDEN < ends[MIDDLE].left
    found_in("linear", "magnetic_saturation", "off_centre_rotor", "sensor_gain", "support_resonance")
    assert all(COARSE not in PASSES[name] and PASSES[name][MIDDLE] > 1 for name in LONG if name in PASSES)
    assert COARSE in PASSES["sensor_gain"], "what is quick goes the whole way"
    assert limits_of(e.ground, null, [], ends) == Limits(), "and a first start proves nothing there"


def test_without_a_gap_a_nonlinear_effect_is_fitted_to_its_end_at_once() -> None:
    """A few steps from its starts would leave it some nats away, and rough stages see nothing that could guide it."""
    names = ("magnetic_hysteresis", "magnetic_saturation", "off_centre_rotor", "support_resonance", "touchdown_contact")
    e, null = plant("none")[0], plant("none")[0].null.candidate
    assert rough_beside(null, e.ground) == ()
    found = found_in("none", *names)
    assert all(set(PASSES[name]) == {WHOLE_PROBE} for name in names[:3])
    assert all(set(PASSES[name]) == {PROBE} for name in names[3:])
    for name in names[:3]:
        first = found[name].fit
        on = fit_task(Task(e.ground, (name,), (first.values,), first.theta, (EXACT,)))
        assert first.cost < on.fit.cost + 1.0, "nothing is left to gain"


def test_what_is_slow_to_compute_is_given_up_where_a_resonance_explains_the_gap() -> None:
    found, passes = found_in("resonant", *LONG, "sensor_gain"), dict(PASSES)
    true = found["support_resonance"].fit
    assert true.cost < 1.2 * true.n_residuals, "to noise"
    assert all(MIDDLE in passes[name] for name in ("extra_flexible_mode", "support_resonance")), (
        "nothing explained it yet"
    )
    assert all(MIDDLE not in passes[name] for name in ("magnetic_hysteresis", "magnetic_saturation"))


def test_starts_are_those_that_are_given_or_that_are_found_where_they_are_fitted() -> None:
    e, _ = plant("linear")
    starts = (({"time_constant_s": 1e-5},), ({"time_constant_s": 1e-6},))
    given, sought = (
        fit_task(Task(e.ground, ("sensor_lag",), of, e.ground.theta, (EXACT,))) for of in (starts, lambda: starts)
    )
    assert given.fit.cost == sought.fit.cost
    assert given.fit.values == sought.fit.values


def test_the_true_effect_is_found_though_it_takes_long() -> None:
    found = found_in("bent", *LONG, "sensor_gain", "sensor_lag")
    best = min(found.values(), key=lambda c: c.fit.cost)
    assert best.effects == ("magnetic_saturation",)
    assert best.fit.values[0]["saturation_inverse_per_a"] == pytest.approx(0.6, rel=0.1)
