"""An effect that the twin names and the rig has no longer is told as that, and no other effect is blamed for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.gap.apply import applied
from service.gap.diagnose import diagnose
from service.gap.diagnosis import Diagnosis
from service.gap.document import gap_document
from service.gap.measured.observation import GapError, Observation, observe
from service.gap.outdated import judged_without, twins_without_effects
from service.gap.weighing.verdict import Verdict
from service.report.gap import gap_page
from sim.datasheet import Datasheet
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane

DELAY = {"loop_delay": {"delay_s": 3.5e-5}}
HOUSING = {"support_resonance": {"inverse_mass_per_kg": 1 / 900, "frequency_hz": 430.0, "damping_ratio": 0.01}}


def twin(sheet: Datasheet, *effects: dict[str, dict[str, float]]) -> Datasheet:
    return replace(sheet, effects=tuple((name, tuple(v.items())) for one in effects for name, v in one.items()))


def test_the_twin_is_tried_without_each_of_its_effects_and_without_all() -> None:
    sheet = known_datasheet()[0]
    tried = dict(twins_without_effects(twin(sheet, DELAY, HOUSING)))
    assert {names: [name for name, _ in one.effects] for names, one in tried.items()} == {
        ("loop_delay",): ["support_resonance"],
        ("support_resonance",): ["loop_delay"],
        ("loop_delay", "support_resonance"): [],
    }
    assert dict(twins_without_effects(twin(sheet, DELAY))) == {("loop_delay",): sheet}


def told(verdict: Verdict, before: Rig, after: Rig, o: Observation) -> SimpleNamespace:
    """What is asked of a diagnosis: its verdict, where, both twins and the sweeps."""
    null, chosen = (SimpleNamespace(fit=SimpleNamespace(rig=rig, groups=())) for rig in (before, after))
    order = [SimpleNamespace(candidate=SimpleNamespace(effects=verdict.effects), log_evidence=0.0)]
    of_plant = SimpleNamespace(path="plant")
    return SimpleNamespace(
        verdict=verdict, where=of_plant, null=null, chosen=chosen, order=order, observation=o, held_out=o
    )


def test_without_currents_what_amplifiers_leave_is_looked_for_in_the_plant() -> None:
    """Amplifiers and plant are one part then, so that an amplifier's effect that the twin names is confirmed there."""
    plain = true_rig(known_datasheet(seed=1)[1])
    late = with_effects(plain, {"loop_delay": {"delay_s": 3e-5}})
    measured = sweep(late, np.geomspace(13.0, 930.0, 16), 0.3, seed=7)
    for currents, confirmed in ((None, True), (measured.I, False)):
        o = observe(replace(measured, I=currents), plain)
        twin = told(Verdict("effect", ("sensor_lag",), (), 0.9, ()), late, late, o)
        without = told(Verdict("effect", ("loop_delay",), (), 0.9, ()), plain, late, o)
        found = judged_without(twin, {("loop_delay",): without})
        assert (found is not None and found[0].kind == "no_gap") is confirmed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("on_the_rig", "named", "gone"),
    [
        pytest.param({}, (DELAY, HOUSING), {"loop_delay", "support_resonance"}, id="both"),
        pytest.param(HOUSING, (HOUSING, DELAY), {"loop_delay"}, id="one of two"),
    ],
)
def test_what_was_mended_on_the_rig_is_taken_out_of_the_twin(
    on_the_rig: dict[str, dict[str, float]], named: tuple[dict[str, dict[str, float]], ...], gone: set[str]
) -> None:
    sheet, truth = known_datasheet(seed=2)
    measured, sheet = one_plane(experiment(with_effects(true_rig(truth), on_the_rig)), sheet)
    old = twin(sheet, *named)
    heard: list[tuple[float, str]] = []
    d = diagnose(measured, old, progress=lambda percent, words: heard.append((percent, words)))
    percents = [percent for percent, _ in heard]
    assert percents == sorted(percents), "progress never falls"
    assert any(words.startswith("the twin without loop delay") for _, words in heard)
    document = gap_document(d)
    assert (document["verdict"]["kind"], document["verdict"]["effects"]) == ("none_of_these", [])
    assert set(document["verdict"]["outdated"]) == gone
    assert "The twin is out of date" in document["verdict"]["sentence"]
    assert document["shrinkage"]["closure"] > 0.95, "of the gap, once it is taken out"
    assert document["next_experiment"] is None
    assert "The twin is out of date" in gap_page(d)
    mended = applied(old, document)
    with pytest.raises(GapError, match="give the twin that was diagnosed"):
        applied(sheet, document)
    assert {name for name, _ in mended.effects} == {name for one in named for name in one} - gone
    assert diagnose(measured, mended).verdict.kind == "no_gap"


@pytest.mark.slow
def test_an_effect_beside_those_that_the_twin_names_rightly_is_named() -> None:
    sheet, truth = known_datasheet(seed=2)
    rig = with_effects(true_rig(truth), DELAY | {"magnetic_saturation": {"saturation_inverse_per_a": 0.6}})
    measured, sheet = one_plane(experiment(rig), sheet)
    verdict = diagnose(measured, twin(sheet, DELAY)).verdict
    assert verdict.effects == ("magnetic_saturation",)
    assert verdict.outdated == ()


@pytest.mark.slow
def test_what_the_law_of_a_named_effect_leaves_is_no_gap_of_the_twin_that_names_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Faint plays stand for the error of a law of eddy currents: a twin is not blamed for what it was added with."""
    sheet, truth = known_datasheet(seed=2)
    eddy = {"eddy_currents": {"time_constant_s": 1e-5}}
    rig = with_effects(true_rig(truth), eddy | {"magnetic_hysteresis": {"loss_angle_rad": 1e-3}})
    measured, sheet = one_plane(experiment(rig), sheet)
    first = gap_document(diagnose(measured, sheet))
    assert first["verdict"]["effects"] == ["eddy_currents"]
    given: list[tuple[Diagnosis, dict[tuple[str, ...], Diagnosis]]] = []

    def judged(d: Diagnosis, without: dict[tuple[str, ...], Diagnosis]) -> tuple[Verdict, Diagnosis] | None:
        given.append((d, without))
        return judged_without(d, without)

    monkeypatch.setattr("service.gap.diagnose.judged_without", judged)
    again = gap_document(diagnose(measured, applied(sheet, first)))
    assert again["verdict"]["kind"] == "no_gap"
    assert "the law of eddy currents, which it names, comes no nearer" in again["verdict"]["sentence"]
    assert any(note.startswith("what little is left") for note in again["notes"])
    assert again["loop"]["nu_gap"]["before"] == again["loop"]["nu_gap"]["after"]
    # the same remainder in a part that eddy currents do not act in is none of their law's
    ((d, without),) = given
    elsewhere = judged_without(replace(d, where=replace(d.where, path="amplifier")), without)
    assert elsewhere is None or elsewhere[0].kind != "no_gap"


@pytest.mark.slow
def test_more_of_an_effect_than_the_twin_names_is_that_effect_and_less_is_another_twin() -> None:
    """What is missing can be added to the twin; what is too much cannot."""
    sheet, truth = known_datasheet(seed=2)
    measured, sheet = one_plane(experiment(with_effects(true_rig(truth), DELAY)), sheet)
    more = diagnose(measured, twin(sheet, {"loop_delay": {"delay_s": 1e-5}})).verdict
    assert (more.effects, more.outdated) == (("loop_delay",), ())
    less = diagnose(measured, twin(sheet, {"loop_delay": {"delay_s": 6e-5}})).verdict
    assert less.outdated == ("loop_delay",)
    assert "without it what differs is loop delay" in less.reasons[0]
