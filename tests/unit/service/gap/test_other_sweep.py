"""What the main sweep hardly shows, but explains the other one: half of that one's lines are fitted too."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.explain_parts import shown_by_other_sweep
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, Values, parts
from service.gap.measured.observation import Observation, observe
from service.gap.weighing.ranking import ranked
from service.gap.weighing.significance import SIGNIFICANT, significance
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from service.gap.which.search import plain_twin
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

IRON = {"saturation_inverse_per_a": 0.1, "flux_share": 0.0, "flux_power": 4.0}
LAG = {"time_constant_s": 2e-5, "delay_s": 0.0}
QUIET_A, LOUD_A = 0.05, 0.15


def seen_with(effects: dict[str, Values], alternative: tuple[str, Values]) -> tuple[Explained, Observation]:
    """The plant by the plain twin of a quiet sweep, an alternative to it, and a loud sweep."""
    datasheet, truth = known_datasheet(seed=16)
    rig = with_effects(true_rig(truth), effects)
    quiet, loud = (experiment(rig, amplitude_a=a) for a in (QUIET_A, LOUD_A))
    measured, datasheet = one_plane(replace(quiet, sweeps=(quiet.sweeps[0], loud.sweeps[1])), datasheet)
    nu = nuisance(datasheet)
    main, other = (observe(s, nu.rig) for s in measured.sweeps)
    part = next(p for p in parts(nu, (main,)) if p.path == "plant")
    ground = Ground(nu, part, (main,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        null, left = plain_twin(fitter, ground)
    name, values = alternative
    other_one = Candidate((name,), replace(null.fit, effects=(name,), values=(values,)), null.occam, ({},))
    return Explained(ground, tuple(ranked(null, [other_one])), left, left), other


def test_a_saturation_that_no_band_of_either_sweep_shows_is_told_by_the_louder_one() -> None:
    e, other = seen_with({"magnetic_saturation": IRON}, ("magnetic_saturation", IRON))
    assert not e.order[0].candidate.effects, "on the quiet sweep it is not worth its price"
    o, z = on_sweep(e, e.null.candidate, other)
    assert significance(z, o) < SIGNIFICANT, "nor does any band of the loud one show it"
    assert shown_by_other_sweep(e, other)


@pytest.mark.parametrize(
    ("effects", "alternative"),
    [
        pytest.param({}, ("magnetic_saturation", IRON), id="of a rig without it"),
        pytest.param({"sensor_lag": LAG}, ("sensor_lag", LAG), id="of what the main sweep shows as well"),
    ],
)
def test_nothing_is_told(effects: dict[str, Values], alternative: tuple[str, Values]) -> None:
    assert not shown_by_other_sweep(*seen_with(effects, alternative))
