"""A fit ends in its valley wherever it begins, also where a parameter is best at its bound."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, Inherited, parts
from service.gap.fitting.part_model import PartModel
from service.gap.fitting.stage import COARSE, EXACT, Stage
from service.gap.fitting.unknowns import Unknowns
from service.gap.measured.observation import observe
from sim.effect import Effect, End
from sim.effects import CATALOGUE
from sim.twin import linear_model, with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig


@pytest.fixture(scope="module")
def ground() -> Ground:
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), lines(4), 0.1, 1), nu.rig)
    return Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_no_fit_leaves_a_range_by_rounding(ground: Ground, effect: Effect) -> None:
    """A candidate whose parameter went to its bound was lost: its law refused the last digit beyond."""
    unknowns = Unknowns(ground, [effect])
    for bound in (unknowns.low, unknowns.high, 2 * unknowns.low, 2 * unknowns.high):
        (values,) = unknowns.values(bound)
        assert all(p.low <= values[p.name] <= p.high for p in effect.of(ground.nuisance.rig).parameters)


def test_a_rough_pass_with_a_nonlinear_effect_begins_with_the_datasheets_values(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have farthest to go, and the force, which takes long to compute, stays what it is at the start meanwhile.

    A process that fits gets a copy of the stage.
    """
    problem, forces, whole = Problem(ground, [CATALOGUE["magnetic_saturation"]]), [], PartModel.beyond_linear
    monkeypatch.setattr(PartModel, "beyond_linear", lambda self, rig, o: forces.append(rig) or whole(self, rig, o))
    x = np.concatenate([np.zeros(problem.unknowns.n_nuisance), problem.unknowns.scaled(({"flux_share": 0.3},))])
    stage: Stage = pickle.loads(pickle.dumps(replace(COARSE, iterations=1)))
    approached, at_once = problem.run(x, stage), problem.run(x, replace(stage, approach=0))
    assert approached.cost < at_once.cost
    forces.clear()
    problem.run(x, replace(stage, iterations=0))
    assert len(forces) == 2, "at the start, and where the values have come to"


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("beside", [(), ("magnetic_saturation",)], ids=["alone", "beside saturation"])
def test_a_derivative_is_that_of_the_prediction(ground: Ground, beside: tuple[str, ...], closed: bool) -> None:
    """Of a linear effect in a rough pass, with the magnets' nonlinearity as it is where the derivative is taken."""
    problem = Problem(ground, [CATALOGUE[name] for name in ("support_resonance", *beside)])
    model, unknowns, (o,) = problem.model, problem.unknowns, ground.observations
    inside = ({"pedestals": 0.3}, *({"flux_share": 0.15} for _ in beside))
    x = np.concatenate([np.zeros(unknowns.n_nuisance), unknowns.scaled(inside)])
    (given,), (here,) = model.nonlinearity(unknowns.build(x)), [model.beyond_linear(unknowns.build(x), o)]
    predicted = model.predict(unknowns.build(x), o, closed, given)
    (columns,) = model.effect_columns(x, [predicted], range(len(unknowns.scale)), closed, [given])
    for j, (k, p) in enumerate(unknowns.parameters):
        inner = unknowns.low[j] < x[unknowns.n_nuisance + j] < unknowns.high[j]
        if not inner or p.name.startswith("rocking_"):  # of nothing, as nothing rocks
            continue
        step = np.zeros(len(x))
        step[unknowns.n_nuisance + j] = 1e-4
        fixed = here if closed and k == 0 else given
        ahead, behind = (model.predict(unknowns.build(x + d), o, closed, fixed) for d in (step, -step))
        exact = (ahead - behind) / 2e-4
        assert np.linalg.norm(columns[..., j] - exact) < 2e-3 * np.linalg.norm(exact), p.name


def test_a_rig_is_that_of_its_own_vector_whichever_was_built_before(ground: Ground) -> None:
    """Derivatives move one value after another, the effect's own, another part's, or the datasheet's."""
    gains = np.flatnonzero([name.startswith("amplifier_gain") for name in ground.nuisance.names])
    known = len(gains) + len(CATALOGUE["loop_delay"].parameters)
    other = Inherited((), gains, (("loop_delay", {"delay_s": 2e-5}),), np.zeros(known), np.eye(known))
    both = replace(ground, inherited=other)

    def unknowns() -> Unknowns:
        return Unknowns(both, [CATALOGUE["sensor_lag"]], {("sensor_lag", "moved_share")})  # no pole is stated here

    u, f = unknowns(), np.array([50.0, 900.0])
    x = np.concatenate([np.zeros(u.n_nuisance), u.scaled(({"time_constant_s": 1e-5},))])
    before = linear_model(u.build(x), f).y_per_u
    for k in range(len(x)):
        moved = x.copy()
        moved[k] += 0.01
        answer = linear_model(u.build(moved), f).y_per_u
        np.testing.assert_array_equal(answer, linear_model(unknowns().build(moved), f).y_per_u)
        free = k < u.n_nuisance or u.low[k - u.n_nuisance] < u.high[k - u.n_nuisance]
        assert np.array_equal(answer, before) != free


def test_it_is_told_at_which_end_of_its_range_a_parameter_is(ground: Ground) -> None:
    unknowns = Unknowns(ground, [CATALOGUE["extra_flexible_mode"]])
    lowest, within = float(ground.observations[0].frequency_hz.min()), {"damping_ratio": 0.01}

    def ends(**values: float) -> dict[tuple[str, str], End]:
        return unknowns.ends(unknowns.scaled(({**within, "bearing_A_per_sqrt_kg": 0.1, **values},)))

    assert ends() == {}
    assert ends(bearing_B_per_sqrt_kg=0.0) == {}, "where an effect vanishes is no end"
    assert ends(bearing_A_per_sqrt_kg=-0.3) == {("extra_flexible_mode", "bearing_A_per_sqrt_kg"): "low"}
    assert ends(frequency_hz=3000.0) == {("extra_flexible_mode", "frequency_hz"): "high"}
    assert ends(frequency_hz=lowest) == {("extra_flexible_mode", "frequency_hz"): "low"}, "below it is a mass"


def test_what_is_held_where_a_law_is_plainest_is_there_to_the_last_digit(ground: Ground) -> None:
    iron = CATALOGUE["eddy_currents"]
    unknowns = Unknowns(ground, [iron], {("eddy_currents", "corner_rad_s")})
    (values,) = unknowns.values(unknowns.scaled(({"time_constant_s": 1e-6, "corner_rad_s": 5e4},)))
    assert values["corner_rad_s"] == next(p.null for p in iron.parameters if p.name == "corner_rad_s")
    assert values["time_constant_s"] == pytest.approx(1e-6)


def test_a_rotor_is_not_fitted_against_the_pole(ground: Ground) -> None:
    """Of a small gap the catalogue's range is more than there is; a third of a gap off is within anyone's."""
    rig = ground.nuisance.rig
    for gap_m in (1e-4, 3e-4):
        ki = gap_m * rig.magnets.ks / rig.magnets.bias_current_a
        small = replace(ground.nuisance, rig=replace(rig, magnets=replace(rig.magnets, ki=ki)))
        unknowns = Unknowns(replace(ground, nuisance=small), [CATALOGUE["off_centre_rotor"]])
        most = np.array([*unknowns.low, *unknowns.high]) * np.tile(unknowns.scale, 2)
        assert np.all((0.3 * gap_m < np.abs(most)) & (np.abs(most) < 0.5 * gap_m))


@pytest.mark.parametrize("seed", [4, 8])
def test_a_parameter_at_its_bound_does_not_hold_the_others_up(seed: int) -> None:
    """A lag without delay: the step that would make the delay negative must not stop the lag short."""
    lag_s = 2.6e-6
    datasheet, truth = known_datasheet(seed=seed)
    nu = nuisance(datasheet)
    rig = with_effects(true_rig(truth), {"sensor_lag": {"time_constant_s": lag_s, "delay_s": 0.0}})
    o = observe(sweep(rig, lines(20), 0.1, seed), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    begun = [{"time_constant_s": start_s, "delay_s": 0.0} for start_s in (lag_s, 1e-5, 3e-5)]
    with Fitter(1) as fitter:
        tasks = [Task(ground, ("sensor_lag",), ((start,),), np.zeros(len(nu)), (EXACT,)) for start in begun]
        fits = [c.fit for c in fitter.run(tasks)]
    true, *others = (f.chi_square + f.penalty for f in fits)
    assert max(others) < true + 0.01 * o.Y.size
    for fit in fits:
        values = fit.values[0]
        assert values["time_constant_s"] + values["delay_s"] == pytest.approx(lag_s, rel=0.1)


def test_a_mode_is_not_fitted_below_the_lowest_line_where_it_would_be_a_mass() -> None:
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(datasheet)
    rig = with_effects(true_rig(truth), {"rotor_inertia": {"mass_change": -0.09, "inertia_change": 0.0}})
    o = observe(sweep(rig, lines(20), 0.1, 1), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    shape = {f"{at}_{end}_per_sqrt_kg": 0.01 for at in ("bearing", "sensor") for end in "AB"}
    begun = {"frequency_hz": 0.6 * o.frequency_hz.min(), "damping_ratio": 0.01, **shape}
    task = Task(ground, ("extra_flexible_mode",), ((begun,),), np.zeros(len(nu)), (COARSE, EXACT))
    with Fitter(1) as fitter:
        found = fitter.run([task])[0].fit.values[0]
    assert found["frequency_hz"] >= 0.999 * o.frequency_hz.min()
