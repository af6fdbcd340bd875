"""What the main sweep hardly shows, or not at all, but explains the other one: half of its lines are fitted too."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.explain_parts import is_of_other_sweep, shown_by_other_sweep
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


def by_the_plain_twin(
    effects: dict[str, Values], path: str, logged: Callable[[Sweep], Sweep] = lambda sweep: sweep
) -> tuple[Explained, Observation]:
    """A part by the plain twin of a quiet sweep of a rig with ``effects``, and a loud sweep."""
    datasheet, truth = known_datasheet(seed=16)
    rig = with_effects(true_rig(truth), effects)
    quiet, loud = (experiment(rig, amplitude_a=a) for a in (QUIET_A, LOUD_A))
    sweeps = (logged(quiet.sweeps[0]), logged(loud.sweeps[1]))
    measured, datasheet = one_plane(replace(quiet, sweeps=sweeps), datasheet)
    nu = nuisance(datasheet)
    main, other = (observe(s, nu.rig) for s in measured.sweeps)
    part = next(p for p in parts(nu, (main,)) if p.path == path)
    ground = Ground(nu, part, (main,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        null, left = plain_twin(fitter, ground)
    return Explained(ground, tuple(ranked(null, [])), left, left), other


def seen_with(effects: dict[str, Values], alternative: tuple[str, Values]) -> tuple[Explained, Observation]:
    """The plant by the plain twin of a quiet sweep, an alternative to it, and a loud sweep."""
    plain, other = by_the_plain_twin(effects, "plant")
    null, (name, values) = plain.null.candidate, alternative
    other_one = Candidate((name,), replace(null.fit, effects=(name,), values=(values,)), null.occam, ({},))
    return replace(plain, order=tuple(ranked(null, [other_one]))), other


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


@pytest.mark.parametrize(("limit_a_per_s", "is_there"), [(400.0, True), (1e6, False)])
def test_a_limit_of_the_louder_sweep_is_looked_for_though_nothing_explains_the_main_one(
    limit_a_per_s: float, is_there: bool
) -> None:
    limit = {"amplifier_voltage_limit": {"slew_inverse_s_per_a": 1 / limit_a_per_s}}
    e, other = by_the_plain_twin(limit, "amplifier", with_mutual_inductance)
    assert e.significance > SIGNIFICANT
    assert is_of_other_sweep(e, other) == is_there


def with_mutual_inductance(s: Sweep) -> Sweep:
    """Currents in which each bearing of a plane hears how fast the other's changes: no effect of the catalogue."""
    assert s.I is not None
    omega = 2 * np.pi * s.frequency_hz[:, None, None, None] * np.array(s.harmonics)[:, None]
    return replace(s, I=s.I + 3e-6j * omega * s.I[..., [1, 0, 3, 2]])
