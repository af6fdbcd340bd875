"""The gap of a rig that was measured by multisines on all axes at once, from campaigns on the rig in time."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.simulated.driver import SimulatedController
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from service.experiment.file import read
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.predict import displacement, measured_signal, weight, whole_displacement
from service.gap.measured.excited_together import PhasesError, Together
from service.gap.measured.observation import observe
from service.gap.measured.sweeps import sweeps_for
from service.report.gap import gap_page
from sim.reference import reference_rig
from sim.twin import with_effects
from tests.support.synthetic import experiment as tone_by_tone
from tests.support.synthetic import known_datasheet, true_rig
from tests.support.two_axes import sheet_of_one_plane

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ALL_AXES = known_datasheet(seed=71)
ONE_PLANE = tuple(map(sheet_of_one_plane, ALL_AXES))
"""Datasheet and truth: two axes take a quarter of the time, where the effect does not need four."""


def rig_of(truth):
    return replace(true_rig(truth), noise=reference_rig().noise)


DATASHEET, RIG = ONE_PLANE[0], rig_of(ONE_PLANE[1])
PROFILE = MultisineProfile(lines=100, periods=4, validation_realisations=1, amplifier_realisations=1)


def measured(effects: dict[str, dict[str, float]], folder, sheets=ONE_PLANE) -> Experiment:
    controller = SimulatedController(with_effects(rig_of(sheets[1]), effects), seed=3)
    run_campaign(controller, sheets[0], folder, profile=PROFILE)
    return read(folder / "experiment.h5")


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Experiment:
    return measured({}, tmp_path_factory.mktemp("plain"))


def test_what_the_magnets_bend_is_predicted_line_by_line(plain):
    """Without it the right twin leaves a clear gap where the rotor swings most; with it, noise."""
    main = plain.main
    o = observe(main, RIG, together=Together.of(main))
    low, w = o.points_hz < 30, weight(o, "y")[:, 0]
    left, bent = (
        np.mean(np.abs((measured_signal(o, "y")[:, 0] - y) * w)[low] ** 2) / 2
        for y in (whole_displacement(RIG, o)[:, 0], displacement(RIG, o))
    )
    assert bent > 10
    assert left < 1.5


def test_a_rig_that_is_its_twin_has_no_gap_and_the_notes_tell_what_a_multisine_hides(plain):
    d = diagnose(plain, DATASHEET)
    assert d.verdict.kind == "no_gap"
    assert any("a stepped sine shows them" in note for note in d.notes)


@pytest.mark.parametrize(
    ("effects", "sheets"),
    [
        ({"loop_delay": {"delay_s": 6e-6}, "magnetic_cross_coupling": {"rotation_rad": 0.02}}, ALL_AXES),
        ({"magnetic_saturation": {"saturation_inverse_per_a": 1.2}}, ONE_PLANE),
    ],
    ids=["loop_delay+magnetic_cross_coupling", "magnetic_saturation"],
)
def test_effects_are_named_with_their_strength(effects, sheets, tmp_path):
    experiment = measured(effects, tmp_path, sheets)
    d = diagnose(experiment, sheets[0])
    assert set(d.verdict.effects) == set(effects)
    assert d.shrinkage.closure is not None
    assert d.shrinkage.closure > 0.9
    found = dict(zip(d.verdict.effects, d.chosen.fit.values, strict=True))
    for name, values in effects.items():
        for parameter, true in values.items():
            assert found[name][parameter] == pytest.approx(true, rel=0.15), (name, parameter)
    assert " ".join(gap_document(d)["verdict"]["effects"][0].split("_")) in gap_page(d)


def test_tones_are_preferred_where_both_were_measured(plain):
    tones = tone_by_tone(RIG)
    both = replace(tones, sweeps=(*plain.sweeps, *tones.sweeps))
    assert {s.kind for _, s in sweeps_for(both)} == {"stepped-sine"}


def test_a_multisine_whose_phases_nobody_wrote_down_is_refused(plain):
    nameless = replace(plain, sweeps=tuple(replace(s, phase_rad=None) for s in plain.sweeps))
    with pytest.raises(PhasesError, match=r"phase_rad.*or run a stepped sine"):
        diagnose(nameless, DATASHEET)


def test_an_observation_of_some_lines_still_sees_what_the_others_do(plain):
    main = plain.main
    line = np.unique(main.frequency_hz, return_inverse=True)[1]
    some = line % 3 == 0
    whole = observe(main, RIG, together=Together.of(main))
    part = observe(main.select(some), RIG, together=Together.of(main))
    np.testing.assert_allclose(whole_displacement(RIG, part), whole_displacement(RIG, whole)[some], rtol=1e-9)
