"""What interference that is heard changes in a verdict: it stands beside what is known, and for nothing far from it."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.compose import Composition
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.interference import Interference, at_speed, hums_hz
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import Verdict
from service.gap.which.explained import Explained
from service.gap.which.rivals import pair_to_separate
from service.gap.with_interference import runout_notes, scatter_shrinkage, with_interference, with_sources
from sim.effects import CATALOGUE
from sim.reference import reference_rig
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane
from tests.unit.service.gap.test_parts import hummed, spoiled
from tests.unit.service.gap.where.test_dependence import plant

HUM_HZ = 50.0
LOUD = Interference("mains_interference", HUM_HZ, {"amplitude_m": 2e-7}, 2e-8, 0.0, 9.0, 20.0, "y")
BY_PHASE = replace(LOUD, heard_hz=(HUM_HZ,))
UNKNOWN = Verdict("none_of_these", (), (), 0.9, ("plant: leaves 80 % of the gap",), unexplained="plant", nonlinear=True)


def left(near: bool) -> Explained:
    """The plant with a residual that nothing explains, near the hum alone or everywhere but there."""
    e, _ = plant("none")
    o = e.ground.observations[0]
    at = (o.points_hz[:, None] * np.array(o.harmonics))[..., None]
    of_hum = np.any(np.abs(at / (HUM_HZ * np.array([1, 2, 3, 5])) - 1) < 0.3, axis=-1).any(axis=-1)
    return replace(e, left=(np.where((of_hum == near)[:, None, None], 30.0, e.left[0]),))


def test_what_nothing_explains_near_a_hum_that_could_not_be_taken_off_is_laid_to_it() -> None:
    told = with_sources(UNKNOWN, [LOUD], [left(near=True)])
    assert (told.kind, told.effects, told.reasons) == ("effect", ("mains_interference",), ())
    assert told.unexplained is None
    assert not told.nonlinear


@pytest.mark.parametrize(
    ("verdict", "source", "near"),
    [
        (UNKNOWN, LOUD, False),
        (UNKNOWN, BY_PHASE, True),
        (replace(UNKNOWN, another_rig=True), LOUD, True),
    ],
    ids=["far from it", "heard by its phase", "of another rig"],
)
def test_what_a_hum_cannot_do_stays_unexplained(verdict: Verdict, source: Interference, near: bool) -> None:
    told = with_sources(verdict, [source], [left(near)])
    assert (told.kind, told.effects, told.unexplained) == ("none_of_these", (), "plant")
    assert told.reasons == (*verdict.reasons, "mains interference at 50 Hz is heard beside it")


def test_a_hum_is_named_beside_an_effect_and_alone_where_there_is_none() -> None:
    aliased = replace(LOUD, aliases=("runout",))
    beside = with_sources(Verdict("effect", ("sensor_lag",), (), 0.8, ()), [aliased])
    assert (beside.kind, beside.effects) == ("effects", ("sensor_lag", "mains_interference"))
    assert beside.indistinguishable == (("mains_interference", "runout"),)
    alone = with_sources(Verdict("no_gap", (), (), 0.8, ()), [LOUD])
    assert (alone.kind, alone.effects, alone.probability) == ("effect", ("mains_interference",), 0.8)


@pytest.mark.slow
def test_the_datasheet_of_another_rig_is_told_as_one_beside_a_hum() -> None:
    datasheet, truth = known_datasheet(seed=9)
    other = replace(
        datasheet,
        mass_kg=0.3 * datasheet.mass_kg,
        modes=tuple(replace(m, frequency_hz=0.7 * m.frequency_hz) for m in datasheet.modes),
    )
    loud = spoiled(experiment(true_rig(truth)), lambda s: hummed(s, HUM_HZ, 60e-9, seed=3))
    measured, sheet = one_plane(replace(loud, sweeps=loud.sweeps[:1]), other)
    verdict = gap_document(diagnose(measured, sheet))["verdict"]
    assert verdict["kind"] == "none_of_these"
    assert "of another rig" in verdict["sentence"]


def ranked(effects: tuple[str, ...], evidence: float, probability: float) -> Ranked:
    values = tuple({p.name: p.typical for p in CATALOGUE[name].parameters} for name in effects)
    fit = Fit(effects, np.zeros(1), values, reference_rig(), (), 0.0, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, values), evidence, probability, 0.0, (0.0, 0.0))


LAG, ROTOR = ranked(("sensor_lag",), -10.0, 0.9), ranked(("rotor_inertia",), -12.0, 0.1)
PLAIN = ranked((), -99.0, 0.0)


def test_an_explanation_beside_a_hum_is_listed_once_and_has_none_without_it_for_a_rival() -> None:
    """The hum was heard: no experiment is needed to tell it from its absence."""
    both = ("sensor_lag", "mains_interference")
    order = with_interference(Composition((LAG, ROTOR, PLAIN)), both, [LOUD]).order
    assert [r.candidate.effects for r in order] == [both, ("rotor_inertia",), ()]
    pair = pair_to_separate(order, Verdict("effects", both, (), 0.9, ()))
    assert pair is not None
    assert pair[1].effects == ("rotor_inertia",)
    assert pair_to_separate((order[0], order[2]), Verdict("effects", both, (), 0.9, ())) is None


def test_the_twin_that_the_verdict_names_is_listed_also_where_another_is_likelier() -> None:
    """The verdict may give up what explains best; `ambit gap apply` needs the parameters of what it names."""
    for order in ((PLAIN, LAG), (LAG, PLAIN)):
        listed = with_interference(Composition(order), ("mains_interference",), [LOUD]).order
        assert listed[0].candidate.effects == ("mains_interference",)
        assert {r.candidate.effects for r in listed[1:]} == {("sensor_lag",), ()}


def test_runout_is_told_with_what_else_goes_once_a_turn_and_a_hum_is_not() -> None:
    turning = replace(BY_PHASE, effect="runout", frequency_hz=60.0, parameters={"amplitude_m": 2e-7})
    assert runout_notes([BY_PHASE]) == []
    (note,) = runout_notes([BY_PHASE, turning])
    assert "60 Hz" in note
    assert "unbalance" in note


@pytest.mark.parametrize(
    ("effect", "loud"),
    [("runout", {"amplitude_m": 3e-5}), ("mains_interference", {"amplitude_m": 0.0, "amplitude_a": 0.5})],
)
def test_interference_louder_than_most_is_named_with_what_was_measured(effect: str, loud: dict[str, float]) -> None:
    at = {"frequency_hz": HUM_HZ} if effect == "mains_interference" else {}
    source = Interference(effect, HUM_HZ, {**loud, **at}, 0.0, 0.0, 3.0, 20.0, "y", heard_hz=(HUM_HZ,))
    rig = reference_rig()
    null = Candidate((), Fit((), np.zeros(1), (), rig, (), 0.0, np.arange(1), np.eye(1), ""), 0.0, ())
    whole = with_interference(Composition((Ranked(null, 0.0, 1.0, 0.0),)), (effect,), [source])
    assert whole.order[0].candidate.fit.values[0] == {**loud, **at}


def test_runout_turns_with_the_rotor_and_the_mains_do_not() -> None:
    """The other sweep may be at another speed, or at standstill, where there is none."""
    runout = Interference("runout", 20.0, {"amplitude_m": 1e-6}, 1e-8, 0.0, 9.0, 20.0, "y", heard_hz=(20.0,))
    there = at_speed([runout, BY_PHASE], -2 * np.pi * 35.0)
    assert [round(s.frequency_hz, 9) for s in there] == [35.0, HUM_HZ]
    assert there[0].heard_hz == pytest.approx((35.0,))
    assert at_speed([runout, BY_PHASE], 0.0) == (BY_PHASE,)
    assert hums_hz([runout], 0.0) == ()


def test_a_sweep_whose_blocks_are_not_known_tells_nothing_of_a_hum_that_was_heard_by_its_phase() -> None:
    _, truth = known_datasheet(seed=9)
    other = experiment(true_rig(truth)).sweeps[1]
    assert other.block_samples is None
    assert scatter_shrinkage(other, true_rig(truth), [BY_PHASE], "sweeps/1") is None
