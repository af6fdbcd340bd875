"""A value that the datasheet states wrongly, and that no tolerance covers, is told as that and not as an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.gap.document import sentence
from sim.datasheet import Datasheet, Mode
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

SHEET, TRUTH = known_datasheet(seed=3)
ABSENT = Mode(300.0, 0.002, (0.05, -0.04), (0.05, -0.045))
EXTRA = {
    "frequency_hz": 300.0,
    "damping_ratio": 0.002,
    "bearing_A_per_sqrt_kg": 0.05,
    "bearing_B_per_sqrt_kg": -0.04,
    "sensor_A_per_sqrt_kg": 0.05,
    "sensor_B_per_sqrt_kg": -0.045,
}


def measured(rig: Rig) -> Experiment:
    """Two sweeps, the second one twice as loud."""
    hz = np.geomspace(12.0, 800.0, 24), np.geomspace(15.0, 700.0, 16)
    return Experiment(rig.name, rig.axes, tuple(sweep(rig, f, 0.4 * k, k) for k, f in enumerate(hz, start=1)))


def told(rig: Rig, sheet: Datasheet) -> tuple[str, tuple[str, ...], bool]:
    """The report's sentence, the effects named, and whether the datasheet is told to be wrong."""
    d = diagnose(*one_plane(measured(rig), sheet))
    return sentence(d), d.verdict.effects, d.verdict.misstated


def test_a_wrong_bias_current_is_found_and_named_with_its_value() -> None:
    factor = 1.4
    stated = tuple(factor * a for a in SHEET.bias_current_a)
    words, effects, wrong = told(true_rig(TRUTH), replace(SHEET, bias_current_a=stated))
    assert wrong
    assert not effects
    found = float(words.partition("with ")[2].split()[0])
    assert found == pytest.approx(1 / factor, rel=0.1)
    assert "check bias_current_a" in words


def test_a_bias_current_that_is_a_few_per_cent_off_is_no_stop() -> None:
    """Where the rotor swings far: the force law beyond its linear part is another one in a smaller air gap."""
    datasheet, truth = known_datasheet(seed=95)
    rig = true_rig(truth)
    smaller = replace(rig, magnets=replace(rig.magnets, bias_current_a=0.95 * rig.magnets.bias_current_a))
    d = diagnose(experiment(smaller, amplitude_a=0.45), datasheet)
    assert d.verdict.misstated
    assert "with 0.95" in d.verdict.reasons[0]


def test_a_mode_that_the_rotor_does_not_have_is_no_extra_mode_of_the_rig() -> None:
    words, effects, wrong = told(true_rig(TRUTH), replace(SHEET, modes=(*SHEET.modes, ABSENT)))
    assert wrong
    assert not effects
    assert "without the datasheet's mode at 300 Hz" in words


@pytest.mark.parametrize("factors", [(0.93, 1.0), (1.0, 1.25), (1.04, 1.05)], ids=["first", "second", "both"])
def test_modes_at_other_frequencies_than_stated_are_found_and_named(factors: tuple[float, ...]) -> None:
    """As where frequencies were computed, with the tolerance of measured ones: no effect moves a mode."""
    modes = [replace(m, frequency_hz=f * m.frequency_hz) for m, f in zip(SHEET.modes, factors, strict=True)]
    rig = true_rig(TRUTH)
    words, effects, wrong = told(rig, replace(SHEET, modes=tuple(modes)))
    assert wrong
    assert not effects
    for stated, factor, true in zip(modes, factors, rig.rotor.modes[0], strict=True):
        if factor != 1.0:
            told_hz = float(words.partition(f"{stated.frequency_hz:.4g} Hz at ")[2].split()[0])
            assert told_hz == pytest.approx(true.natural_frequency_rad_s / (2 * np.pi), rel=2e-3)
        else:
            assert f"{stated.frequency_hz:.4g} Hz" not in words


def test_a_mode_that_changes_with_its_swing_is_not_told_as_one_that_is_elsewhere() -> None:
    """At the louder sweep its frequency would be another again."""
    rig = true_rig(TRUTH)
    hz = np.geomspace(12.0, 800.0, 24), np.geomspace(15.0, 700.0, 16)

    def softened(by: float) -> Rig:
        planes = tuple(
            tuple(replace(m, natural_frequency_rad_s=by * m.natural_frequency_rad_s) for m in plane)
            for plane in rig.rotor.modes
        )
        return replace(rig, rotor=replace(rig.rotor, modes=planes))

    sweeps = [sweep(softened(by), f, 0.4 * k, k) for by, k, f in zip((0.95, 0.9), (1, 2), hz, strict=True)]
    d = diagnose(*one_plane(Experiment(rig.name, rig.axes, tuple(sweeps)), SHEET))
    assert not d.verdict.misstated
    assert d.verdict.kind == "none_of_these"
    assert any("the main sweep shows the datasheet's mode" in note for note in d.notes)


@pytest.mark.parametrize("currents", [True, False])
def test_a_loop_that_is_faster_than_stated_is_told_with_its_delay(currents: bool) -> None:
    """Where delays were stated for the worst case: no effect takes a delay off.

    Without currents, 1 % of the amplifiers' frequency is 2 us of their lag.
    """
    rig = true_rig(TRUTH)
    data = measured(replace(rig, controller=replace(rig.controller, computing_delay_s=2e-5)))
    if not currents:
        data = replace(data, sweeps=tuple(replace(s, I=None) for s in data.sweeps))
    d = diagnose(*one_plane(data, replace(SHEET, computing_delay_s=6e-5)))
    assert d.verdict.misstated
    told_us = float(sentence(d).partition("a computing delay of ")[2].split()[0])
    assert told_us == pytest.approx(20.0, abs=0.5 if currents else 3.0)


@pytest.mark.parametrize(
    "there",
    [
        {"extra_flexible_mode": EXTRA},
        {"magnetic_saturation": {"saturation_inverse_per_a": 0.25}},
    ],
    ids=lambda there: next(iter(there)),
)
def test_an_effect_that_the_rig_has_is_still_named(there: dict[str, dict[str, float]]) -> None:
    _, effects, wrong = told(with_effects(true_rig(TRUTH), there), SHEET)
    assert not wrong
    assert effects == tuple(there)
