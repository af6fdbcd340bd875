"""What is left together is told apart by the experiment that can, and the proposal is one that the service takes."""

import json
import shlex
from dataclasses import replace

import numpy as np
import pytest

from service.api.resources.options import checked_options
from service.campaign.aims import Profile
from service.cli.client import Kind, _options
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.measured.observation import observe
from service.gap.next_experiment import Proposal, _outlook, only_fainter, submission, turning_damping
from service.gap.proposal.case import Grounds, limits_of
from service.gap.proposal.options import Option, options
from service.gap.proposal.safety import require_levitation
from service.gap.proposal.sensor_noise import SensorNoise
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import Verdict
from service.gap.which.rivals import pair_to_separate, turning_with_the_shaft
from service.jobs.campaigns import profile_of
from sim.errors import LevitationError
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

DATASHEET, TRUTH = known_datasheet(seed=1)
FITTER = Fitter()
NU, TWIN = nuisance(DATASHEET), true_rig(TRUTH)
SWEEP = sweep(TWIN, np.geomspace(10.0, 950.0, 24), 0.1, seed=3)
SEEN = Grounds((observe(SWEEP, TWIN),), SensorNoise.of(SWEEP, TWIN), True, limits_of(DATASHEET))


def explanation(evidence: float, **values: dict[str, float]) -> Ranked:
    rig, effects, k = with_effects(TWIN, values), tuple(values), len(NU)
    fit = Fit(effects, np.zeros(k), tuple(values.values()), rig, (), 0.0, np.arange(k), 1e6 * np.eye(k), "converged")
    return Ranked(Candidate(effects, fit, 0.0, tuple({} for _ in effects)), evidence, 0.9, 0.0)


SEEN_SPEED = next(o for o in options(SEEN.sweeps, TWIN, SEEN.limits) if o.name == "speed")
DAMPED = explanation(0.0, modal_damping={"mode1_log_ratio": 1.5, "mode2_log_ratio": 1.5})
ALIASES = Verdict("effect", ("modal_damping",), (("modal_damping", "internal_damping"),), 0.9, ())


@pytest.mark.slow
def test_an_exact_alias_is_constructed_and_only_speed_tells_it_apart() -> None:
    """At rest nothing but the log could; what adds an amplifier's limit to the chosen effect is no rival of it."""
    damping = dict(zip(DAMPED.candidate.effects, DAMPED.candidate.fit.values, strict=True))
    more = explanation(-1.0, **damping, amplifier_voltage_limit={"slew_inverse_s_per_a": 1e-6, "slope_seen": 0.0})
    pair = pair_to_separate([DAMPED, more], ALIASES)
    assert pair is not None
    assert pair[1].effects == ("internal_damping",)
    proposal = Proposal(NU, pair, SEEN, "rig 1", FITTER).document()
    assert proposal is not None
    assert proposal["separates"] == ["modal_damping", "internal_damping"]
    assert proposal["experiment"] == "speed"
    assert proposal["alternatives"] == [], "nothing at rest separates them"
    assert "50 rev/s" in proposal["by_hand"][0]


def test_what_contains_the_chosen_explanation_is_no_rival_and_what_does_not_is() -> None:
    chosen = explanation(0.0, loop_delay={"delay_s": 2e-5})
    more = explanation(-1.0, loop_delay={"delay_s": 2e-5}, sensor_lag={"time_constant_s": 1e-6})
    rival = explanation(-3.0, sensor_lag={"time_constant_s": 2e-5})
    far = replace(rival, log_evidence=-30.0)
    verdict = Verdict("effect", ("loop_delay",), (), 0.9, ())
    assert pair_to_separate([chosen, more], verdict) is None
    pair = pair_to_separate([chosen, more, rival], verdict)
    assert pair is not None
    assert pair[1].effects == ("sensor_lag",)
    assert pair_to_separate([chosen, more, far], verdict) is None
    assert pair_to_separate([chosen, rival], Verdict("none_of_these", (), (), 0.9, ())) is None


@pytest.mark.slow
def test_what_nothing_affordable_separates_gets_no_proposal() -> None:
    a = explanation(0.0, sensor_lag={"time_constant_s": 2e-5, "delay_s": 0.0})
    b = explanation(-1.0, sensor_lag={"time_constant_s": 2e-5 + 1e-12, "delay_s": 0.0})
    assert Proposal(NU, (a.candidate, b.candidate), SEEN, "rig 1", FITTER).document() is None


def test_a_sure_experiment_is_proposed_with_its_own_tones_and_time() -> None:
    """Nothing by hand where that is not needed, and of such the one that takes the least time."""
    a = explanation(0.0, sensor_lag={"time_constant_s": 2e-5, "delay_s": 0.0})
    b = explanation(-1.0, eddy_currents={"time_constant_s": 3e-6})
    proposal = Proposal(NU, (a.candidate, b.candidate), SEEN, "rig 1", FITTER).document()
    assert proposal is not None
    assert proposal["odds_of_telling_apart"] > 0.95
    assert proposal["by_hand"] == []
    rivals = [o for o in proposal["alternatives"] if o["experiment"] in ("wide_band", "larger_amplitude")]
    assert all(o["rig_seconds"] >= proposal["rig_seconds"] for o in rivals if o["odds_of_telling_apart"] > 0.95)
    plan = profile_of(proposal["job"]["options"])
    assert isinstance(plan, Profile)
    tones = {sweep: [t for t in proposal["tones"] if t["sweep"] == sweep] for sweep in ("main", "validation")}
    assert len(tones["main"]) >= plan.points * 4
    assert len(tones["validation"]) == plan.validation_points * 4
    for hz in ([t["frequency_hz"] for t in of] for of in tones.values()):
        assert hz == sorted(hz)


@pytest.mark.parametrize("option", options(SEEN.sweeps, TWIN, SEEN.limits), ids=lambda o: o.name)
def test_the_service_takes_what_is_proposed(option: Option) -> None:
    asked = submission(option, "rig 1")
    job = asked["job"]
    assert checked_options(job["kind"], job["options"]) == job["options"]
    words = shlex.split(asked["command"])
    assert words[:5] == ["ambit", "submit", "experiment", "--rig", "rig 1"]
    assert _options([words[-3], words[-1]], False, None, Kind.experiment) == job["options"]
    assert json.loads(json.dumps(job)) == job


def test_less_amplitude_is_asked_for_only_where_something_does_not_answer_in_proportion() -> None:
    fainter = next(o for o in options(SEEN.sweeps, NU.rig, SEEN.limits) if o.amplitude is not None and o.amplitude < 1)
    lag = explanation(0.0, sensor_lag={"time_constant_s": 1e-5}).candidate
    delay = explanation(0.0, loop_delay={"delay_s": 1e-5}).candidate
    bent = explanation(0.0, magnetic_saturation={"saturation_inverse_per_a": 0.1}).candidate
    assert only_fainter(fainter, lag, delay)
    assert not only_fainter(fainter, lag, bent)
    assert not only_fainter(replace(fainter, amplitude=2.0), lag, delay)


def slow_mode(hz: float) -> Candidate:
    """Damping of a mode that the rotor would pass on the way to fifty revolutions a second."""
    first, *rest = TWIN.rotor.modes[0]
    shape = (0.02, -0.02)
    slow = replace(first, natural_frequency_rad_s=2 * np.pi * hz, shape_at_bearings=shape, shape_at_sensors=shape)
    rig = replace(TWIN, rotor=replace(TWIN.rotor, modes=((slow, *rest),) * 2))
    values = {"mode1_log_ratio": 3.0, "mode2_log_ratio": 0.0}
    fit = replace(DAMPED.candidate.fit, values=(values,), rig=with_effects(rig, {"modal_damping": values}))
    return replace(DAMPED.candidate, fit=fit)


def test_no_rotor_is_brought_to_a_speed_at_which_an_explanation_in_question_is_unstable() -> None:
    """Nor where one beside the pair is: what damps it may as well turn with the shaft, whatever the rival is."""
    still = slow_mode(35.0)
    turning = turning_with_the_shaft(still)
    assert turning is not None
    fast = replace(SEEN_SPEED, speed_rad_s=2 * np.pi * 50)
    slow = replace(SEEN_SPEED, speed_rad_s=2 * np.pi * 20)
    require_levitation([fast.rig(still.fit.rig), slow.rig(still.fit.rig), slow.rig(turning.fit.rig)])
    with pytest.raises(LevitationError):
        require_levitation([fast.rig(turning.fit.rig)])
    assert _outlook(NU, still, turning, SEEN, fast) is None
    assert _outlook(NU, still, turning, SEEN, slow) is not None
    magnets = replace(TWIN.magnets, ks=10 * TWIN.magnets.ks)
    unheld = replace(still, fit=replace(still.fit, rig=replace(TWIN, magnets=magnets)))
    assert _outlook(NU, still, turning, SEEN, slow, [unheld]) is None
    assert [c.effects for c in turning_damping([still])] == [("internal_damping",)]
    assert turning_damping([explanation(0.0, loop_delay={"delay_s": 2e-5}).candidate]) == []


def test_the_proposed_speed_is_one_that_the_rival_holds_too() -> None:
    pair = (still := slow_mode(35.0)), turning_with_the_shaft(still)
    assert pair[1] is not None
    proposal = Proposal(NU, pair, SEEN, "rig 1", FITTER).document()
    assert proposal is not None
    assert proposal["experiment"] == "speed"
    assert 0 < 1.2 * proposal["speed_rad_s"] < 2 * np.pi * 35
