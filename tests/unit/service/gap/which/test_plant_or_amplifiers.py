"""What one part's data leave open is left open for the next: no part is blamed for what was not known of another."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.fitting.amplifiers_uncertainty import inherited_from
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.fit import Problem
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.stage import Stage
from service.gap.measured.observation import observe
from service.gap.weighing.ranking import Ranked
from service.gap.which import plant_or_amplifiers as between_parts
from service.gap.which.explained import Explained
from service.gap.which.one_more_effect import residuals
from service.gap.which.plant_or_amplifiers import Exchange
from service.gap.which.search import explain
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, noisy_currents, true_rig

pytestmark = pytest.mark.slow


def test_a_delay_that_noisy_currents_hardly_show_is_not_laid_to_the_plant() -> None:
    """The displacement is measured far better than the current: alone it says eddy currents and a mode."""
    datasheet, truth = known_datasheet(seed=21)
    rig = with_effects(true_rig(truth), {"loop_delay": {"delay_s": 5e-6}})
    d = diagnose(noisy_currents(experiment(rig), 3e-3), datasheet)
    assert d.verdict.effects == ("loop_delay",)


def ground_of(effects: dict[str, dict[str, float]], path: str) -> Ground:
    datasheet, truth = known_datasheet(seed=22)
    measured, nu = experiment(with_effects(true_rig(truth), effects)), nuisance(datasheet)
    o = observe(measured.sweeps[0], nu.rig)
    part = next(p for p in parts(nu, (o,)) if p.path == path)
    return Ground(nu, part, (o,), np.zeros(len(nu)))


def test_a_plain_twin_whose_fit_stopped_short_is_not_beaten_by_any_effect() -> None:
    """Every effect goes on from where it stopped and leaves less, though it is not there."""
    ground = ground_of({}, "plant")
    start = np.full(len(ground.part.active), 1.5) * np.resize([1, -1], len(ground.part.active))
    fit = Problem(ground).run(start, Stage(closed=False, relative_floor=0.0, iterations=1, tolerance=0.5))
    short = Candidate((), fit, 0.0, ())
    assert fit.chi_square > 10 * fit.n_residuals
    with Fitter() as fitter:
        found = explain(fitter, ground, (short, residuals(ground, short)))
    assert found.order[0].candidate.effects == ()
    assert found.remaining < 4.0
    assert found.significance < 4.0


def test_what_the_amplifiers_leave_open_is_as_wide_as_their_data_and_the_datasheet_say() -> None:
    ground = ground_of({}, "amplifier")
    with Fitter() as fitter:
        found = explain(fitter, ground)
    delayed = next(r.candidate for r in found.order if r.candidate.effects == ("loop_delay",))
    for candidate in (found.null.candidate, delayed):
        theirs = inherited_from(found.ground, candidate)
        spread = np.sqrt(np.diag(np.linalg.inv(theirs.precision)))
        k = len(theirs.active)
        uncertain = [s for s in spread[k:] if s > 1e-9]
        assert len(uncertain) == len(candidate.effects), "a delay's one value is uncertain too; its imbalances sleep"
        assert np.all(spread[:k] < 1.0), "no wider than the tolerances"
        np.testing.assert_allclose(theirs.mean[:k], candidate.fit.theta[theirs.active])
    assert theirs.effects == (("loop_delay", delayed.fit.values[0]),)


def test_inherited_values_move_the_plant_but_at_the_price_of_the_other_parts_data() -> None:
    amplifiers = ground_of({}, "amplifier")
    with Fitter() as fitter:
        found = explain(fitter, amplifiers)
    theirs = inherited_from(amplifiers, found.null.candidate)
    plant = replace(ground_of({}, "plant"), theta=found.null.candidate.fit.theta, inherited=theirs)
    problem = Problem(plant)
    at = np.concatenate([plant.theta[plant.part.active], theirs.mean])
    away = at.copy()
    away[-1] += 1.0
    assert not np.allclose(
        problem.model.predict(problem.unknowns.build(away), plant.observations[0], closed=False),
        problem.model.predict(problem.unknowns.build(at), plant.observations[0], closed=False),
        rtol=1e-9,
    )
    step = away - at
    assert step @ problem.unknowns.prior @ step > 1.0, "their currents know it better than its tolerance"


def ranked(evidence: float, *effects: str, left: float = 0.0) -> Ranked:
    """An explanation that leaves so much of the gap."""
    fit = Fit(effects, np.zeros(1), (), true_rig(known_datasheet()[1]), (), 0.0, np.arange(1), np.eye(1), "")
    return Ranked(Candidate(effects, fit, 0.0, ()), evidence, 0.5, left)


@pytest.mark.parametrize(("left", "moved"), [(0.1, True), (0.9, False)])
def test_a_plant_that_hardly_anything_explains_says_nothing_of_the_amplifiers(
    monkeypatch: pytest.MonkeyPatch, left: float, moved: bool
) -> None:
    ground = ground_of({}, "amplifier")
    plain, delay = ranked(-5.0), ranked(-6.0, "loop_delay")
    amplifiers = Explained(ground, (plain, delay), (), ())
    plant = Explained(ground, (ranked(-20.0, "sensor_lag", left=left), ranked(-300.0, left=1.0)), (), ())
    monkeypatch.setattr(between_parts, "_exchanges", lambda *_: [Exchange(delay, frozenset(), -10.0)])
    monkeypatch.setattr(between_parts, "residuals", lambda *_: ())
    now, _ = between_parts.plant_or_amplifiers(Fitter(), amplifiers, plant, lambda _: ground)
    assert now.chosen is (delay.candidate if moved else plain.candidate)


def test_what_a_mixture_leaves_of_itself_need_not_be_in_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three effects one is given to the amplifiers; the other two alone were no mixture that needs both."""
    ground = ground_of({}, "amplifier")
    plain, delay = ranked(-5.0), ranked(-6.0, "loop_delay")
    others = frozenset(("touchdown_contact", "sensor_gain"))
    amplifiers = Explained(ground, (plain, delay), (), ())
    plant = Explained(ground, (ranked(-20.0, "sensor_lag", *others), ranked(-300.0)), (), ())
    monkeypatch.setattr(between_parts, "_exchanges", lambda *_: [Exchange(delay, others, -10.0)])
    monkeypatch.setattr(between_parts, "residuals", lambda *_: ())
    now, same = between_parts.plant_or_amplifiers(Fitter(), amplifiers, plant, lambda _: ground)
    assert now.chosen is delay.candidate
    assert same.order == plant.order
