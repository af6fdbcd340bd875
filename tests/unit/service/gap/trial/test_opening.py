"""A seal is opened against the commitment, and the verdict is scored as the blind trial scores it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.gap.origin import origin
from service.gap.trial import opening
from service.gap.trial.opening import opened_document
from sim.errors import AmbError
from sim.reference import reference_datasheet
from sim.withheld.case import draw
from sim.withheld.given import Given
from sim.withheld.seal import Seal, SealError, named_after, seal

SINGLE, CLEAN, LAW = 0, 2, 4
"""Seeds of cases that withhold an effect, nothing, and a law of no catalogue."""


def sealed(seed: int, given: Given | None = None) -> Seal:
    return seal(draw(seed, seed, given).truth())


def report(kind: str, *effects: str, rig: str = "withheld", **more: Any) -> dict[str, Any]:
    return {
        "format": "amb-gap-report",
        "rig": rig,
        "where": {"path": "plant"},
        "verdict": {"kind": kind, "effects": list(effects), "indistinguishable": [], "probability": 0.9},
        "candidates": [],
        "shrinkage": {"closure": 0.9},
        **more,
    }


def sine(kind: str = "stepped-sine", axes: int = 4) -> Experiment:
    z = np.ones((1, 2, 2, axes), dtype=complex)
    main = Sweep(kind, np.array([50.0]), np.array([0]), np.array([0.1]), (0, 1), z, z, z, z, comment="main")
    return Experiment("withheld", ("xA", "xB", "yA", "yB")[:axes], (main,))


@pytest.mark.parametrize(
    ("seed", "said", "right"),
    [
        (SINGLE, report("effect", *draw(SINGLE, SINGLE).truth()["effects"]), True),
        (SINGLE, report("effect", "gyroscopic_coupling"), False),
        (CLEAN, report("no_gap"), True),
        (CLEAN, report("none_of_these"), False),
        (LAW, report("none_of_these"), True),
        (LAW, report("no_gap"), False),
    ],
)
def test_a_verdict_is_scored(seed: int, said: dict[str, Any], right: bool) -> None:
    kept = sealed(seed)
    document = opened_document(kept.document(), kept.commitment, said)
    assert document["right"] is right
    assert document["truth"] == draw(seed, seed).truth()
    assert document["sentence"].endswith("right" if right else "wrong")
    assert document["detectability"] is None


def test_a_truth_that_was_changed_is_not_scored() -> None:
    kept = sealed(SINGLE)
    forged = kept.document() | {"truth": kept.truth.replace('"single"', '"clean"')}
    with pytest.raises(SealError, match="was changed"):
        opened_document(forged, kept.commitment, report("no_gap"))
    with pytest.raises(SealError, match="was changed"):
        opened_document(sealed(CLEAN).document(), kept.commitment, report("no_gap"))


def test_not_to_find_what_hardly_shows_in_the_experiment_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = sealed(SINGLE)
    monkeypatch.setattr(opening, "detectability_of", lambda case, experiment: {"detectability": 2.5, "each": {}})
    document = opened_document(kept.document(), kept.commitment, report("no_gap"), sine())
    assert (document["right"], document["detectability"]) == (True, 2.5)
    assert ", detectability 2 ->" in document["sentence"]


def test_a_sealed_case_of_a_blind_trial_tells_itself_how_plainly_it_shows() -> None:
    kept = seal(draw(SINGLE, SINGLE).truth() | {"detectability": 2.5, "each": {}})
    assert opened_document(kept.document(), kept.commitment, report("no_gap"))["right"]


def test_an_experiment_that_cannot_tell_is_refused() -> None:
    kept = sealed(SINGLE)
    for experiment in (sine("multisine"), sine(axes=2), replace(sine(), sweeps=())):
        with pytest.raises(AmbError, match="only a stepped sine"):
            opened_document(kept.document(), kept.commitment, report("no_gap"), experiment)


def test_a_report_of_another_rig_is_not_scored() -> None:
    kept = sealed(CLEAN, Given(replace(reference_datasheet(), name="mill")))
    assert opened_document(kept.document(), kept.commitment, report("no_gap", rig="mill"))["right"]
    with pytest.raises(AmbError, match="'withheld', and something was withheld in 'mill'"):
        opened_document(kept.document(), kept.commitment, report("no_gap"))


def made_of(seed: int, controller: str = "", given: Given | None = None) -> dict[str, str]:
    """What a diagnosis of a case says of its origin."""
    measured = replace(sine(), attributes={"controller": controller})
    return origin(measured, draw(seed, seed, given).datasheet)


def test_a_report_of_the_case_is_scored_without_a_note() -> None:
    kept = sealed(CLEAN)
    said = report("no_gap", of=made_of(CLEAN, f"{named_after(kept.commitment)}, simulated rig withheld"))
    document = opened_document(kept.document(), kept.commitment, said)
    assert (document["right"], document["notes"]) == (True, [])


def test_a_report_of_another_drawn_rig_is_not_scored() -> None:
    """All of them have one name."""
    kept = sealed(CLEAN)
    with pytest.raises(AmbError, match="another datasheet than the one that was served"):
        opened_document(kept.document(), kept.commitment, report("no_gap", of=made_of(LAW)))


def test_a_report_of_another_case_in_the_same_given_rig_is_not_scored() -> None:
    mill = Given(replace(reference_datasheet(), name="mill"))
    kept, other = sealed(CLEAN, mill), sealed(LAW, mill)

    def said(device: str) -> dict[str, Any]:
        return report("no_gap", rig="mill", of=made_of(CLEAN, device, mill))

    own = f"{named_after(kept.commitment)}, simulated rig mill"
    assert opened_document(kept.document(), kept.commitment, said(own))["notes"] == []
    with pytest.raises(AmbError, match=f"another case, {named_after(other.commitment)}, and the sealed file"):
        opened_document(kept.document(), kept.commitment, said(f"{named_after(other.commitment)}, simulated rig mill"))
    (note,) = opened_document(kept.document(), kept.commitment, said("modbus://vendor"))["notes"]
    assert "did not say which case" in note


def test_an_experiment_that_was_not_the_one_diagnosed_is_refused() -> None:
    kept = sealed(CLEAN)
    said = report("no_gap", of=made_of(CLEAN))
    other = replace(sine(), sweeps=(replace(sine().main, amplitude_a=np.array([0.2])),))
    with pytest.raises(AmbError, match="of another experiment than the one given"):
        opened_document(kept.document(), kept.commitment, said, other)
    foreign = replace(sine(), attributes={"controller": f"{named_after('0' * 64)}, simulated rig withheld"})
    with pytest.raises(AmbError, match="measured on another case, withheld 000000000000, and"):
        opened_document(kept.document(), kept.commitment, report("no_gap"), foreign)


@pytest.mark.parametrize("of", [None, {}, "mine", {"controller": None}])
def test_a_report_that_does_not_say_what_it_is_of_is_scored_with_a_note(of: object) -> None:
    kept = sealed(CLEAN)
    document = opened_document(kept.document(), kept.commitment, report("no_gap", of=of))
    assert document["right"]
    assert "taken on trust" in document["notes"][0]


def test_files_that_lack_something_are_told() -> None:
    kept = sealed(CLEAN)
    with pytest.raises(AmbError, match="lacks 'verdict'"):
        opened_document(kept.document(), kept.commitment, {"rig": "withheld"})
    old = seal({"effect": "loop_delay", "values": {"delay_s": 2e-5}})
    with pytest.raises(AmbError, match="lacks"):
        opened_document(old.document(), old.commitment, report("no_gap"))
