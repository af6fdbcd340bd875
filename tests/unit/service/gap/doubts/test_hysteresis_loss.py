"""Hysteresis is named for its lag, not for a stiffness that changes with amplitude."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.doubts.hysteresis_loss import lag_missing, lag_share
from service.gap.measured.observation import observe
from service.gap.overall_verdict import verdict_of
from service.gap.which.held_out import held_out
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.plant import plant_of
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig

pytestmark = pytest.mark.slow


def stronger_beyond(rig: Rig, s: Sweep, current_a: float, most: float) -> Sweep:
    """The sweep of a rig whose force grows by up to ``most`` beyond some current, in phase with it."""
    frequency, line = np.unique(s.frequency_hz, return_inverse=True)
    m, f = linear_model(rig, frequency), HARMONICS.index(1)
    own = s.I.mean(axis=1)[:, f]
    added = most * np.maximum(1 - current_a / np.maximum(np.abs(own), current_a), 0.0) * own
    more = (m.y_per_i[line] @ added[..., None])[..., 0]
    C = m.controller[line, None]
    back = -C * np.linalg.solve(np.eye(rig.n_axes) + m.y_per_u[line] * C[..., None], more[..., None])[..., 0]
    U, I, Y = s.U.copy(), s.I.copy(), s.Y.copy()
    U[:, :, f] += back[:, None]
    I[:, :, f] += (m.i_per_u[line] @ back[..., None])[:, None, :, 0]
    Y[:, :, f] += ((m.y_per_u[line] @ back[..., None])[..., 0] + more)[:, None]
    return replace(s, U=U, I=I, Y=Y)


@pytest.mark.parametrize("shape", [{}, {"narrowest_a": 0.1, "widest_inverse_per_a": 10.0}])
def test_hysteresis_shows_its_lag_in_full(shape: dict[str, float]) -> None:
    datasheet, truth = known_datasheet(seed=32)
    effect = {"loss_angle_rad": 6e-3 if shape else 2e-3, **shape}
    rig = with_effects(true_rig(truth), {"magnetic_hysteresis": effect})
    e = plant_of(experiment(rig), datasheet)
    assert e.order[0].candidate.effects == ("magnetic_hysteresis",)
    share, std = lag_share(e)
    assert abs(share - 1) < 3 * std
    assert std < 0.2
    assert lag_missing(e) is None


def test_a_force_that_grows_with_amplitude_without_a_lag_is_not_hysteresis() -> None:
    """The law of hysteresis explains all that noise lets one see of it, but not its phase."""
    datasheet, truth = known_datasheet(seed=31)
    rig = true_rig(truth)
    measured, again = (experiment(rig, seed=seed, noise=3.0) for seed in (1, 7))
    measured = replace(measured, sweeps=tuple(stronger_beyond(rig, s, 0.05, 0.01) for s in measured.sweeps))
    e = plant_of(measured, datasheet, most=1)
    assert e.order[0].candidate.effects == ("magnetic_hysteresis",)
    unseen = observe(stronger_beyond(rig, again.sweeps[0], 0.05, 0.01), e.ground.nuisance.rig)
    verdict = verdict_of([e], {"plant": held_out(e, unseen)}, unseen)
    assert verdict.kind == "none_of_these"
    assert any("not as with hysteresis: of the lag that goes with it" in reason for reason in verdict.reasons)


def test_a_law_whose_width_no_current_reaches_is_not_judged_by_its_lag() -> None:
    datasheet, truth = known_datasheet(seed=33)
    e = plant_of(experiment(true_rig(truth)), datasheet)
    wide = next(r for r in e.order if r.candidate.effects == ("magnetic_hysteresis",))
    values = ({"loss_angle_rad": 2e-3, "narrowest_a": 1.5, "widest_inverse_per_a": 1 / 1.5},)
    rig = with_effects(e.ground.rig(wide.candidate.fit.theta), {"magnetic_hysteresis": values[0]})
    fit = replace(wide.candidate.fit, values=values, rig=rig)
    e = replace(e, order=(replace(wide, candidate=replace(wide.candidate, fit=fit)), e.null))
    assert lag_share(e)[1] > 1.0
    assert lag_missing(e) is None


def test_hysteresis_far_below_a_degree_is_named_with_its_strength() -> None:
    datasheet, truth = known_datasheet(seed=34)
    rig = with_effects(true_rig(truth), {"magnetic_hysteresis": {"loss_angle_rad": 4e-4}})
    e = plant_of(experiment(rig, noise=0.3), datasheet)
    best = e.order[0].candidate
    assert best.effects == ("magnetic_hysteresis",)
    assert abs(best.fit.values[0]["loss_angle_rad"] / 4e-4 - 1) < 0.15


def test_the_widths_of_its_plays_are_found_and_nothing_is_named_beside_it() -> None:
    datasheet, truth = known_datasheet(seed=35)
    values = {"loss_angle_rad": 8e-3, "widest_inverse_per_a": 8.0}
    e = plant_of(experiment(with_effects(true_rig(truth), {"magnetic_hysteresis": values}), noise=0.3), datasheet)
    best = e.order[0].candidate
    assert best.effects == ("magnetic_hysteresis",)
    assert best.fit.values[0]["widest_inverse_per_a"] == pytest.approx(8.0, rel=0.05)
    assert best.fit.values[0]["loss_angle_rad"] == pytest.approx(8e-3, rel=0.05)
    assert best.fit.values[0]["narrowest_a"] == pytest.approx(0.0, abs=0.01)


def test_plays_that_are_narrow_and_dense_strain_no_datasheet_and_nothing_is_named_beside_them() -> None:
    """A fifth of the current goes through plays up to 60 mA wide: a Rayleigh loop as dense would lag by 0.2 rad."""
    datasheet, truth = known_datasheet(seed=36)
    values = {"loss_angle_rad": 0.2, "widest_inverse_per_a": 17.0}
    e = plant_of(experiment(with_effects(true_rig(truth), {"magnetic_hysteresis": values})), datasheet)
    best = e.order[0].candidate
    assert best.effects == ("magnetic_hysteresis",)
    assert best.fit.values[0]["loss_angle_rad"] == pytest.approx(0.2, rel=0.1)
    assert best.fit.values[0]["widest_inverse_per_a"] == pytest.approx(17.0, rel=0.1)
