"""Channels that are not those of their axes are told by the laws of controller and amplifiers, before any fit."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Complex, Sweep
from service.gap.measured.cabling import odd_scales, other_law, wrong_channels
from service.gap.observed import observed
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig

DATASHEET, TRUTH = known_datasheet(seed=3)
RIG = true_rig(DATASHEET)
MEASURED = experiment(true_rig(TRUTH))
MAIN = MEASURED.main
SWAPPED = [1, 0, 2, 3]


def told_of(sweep: Sweep) -> str:
    message = wrong_channels(sweep, RIG, MEASURED.axes, "sweeps/0")
    assert message is not None
    assert message.startswith("sweeps/0: ")
    assert "\n" not in message
    return message


def times(x: Complex | None, factor: float, axis: int | slice = slice(None)) -> Complex:
    assert x is not None
    out = x.copy()
    out[..., axis] *= factor
    return out


def current() -> Complex:
    assert MAIN.I is not None
    return MAIN.I


def driven_hard(sweep: Sweep) -> Sweep:
    """The points at which the controller adds least to the excitation."""
    f = sweep.harmonic(1)
    added, r = (np.linalg.norm(x[:, :, f], axis=(1, 2)) for x in (sweep.U - sweep.R, sweep.R))
    return sweep.select(added / r < np.quantile(added / r, 0.4))


WRONG: dict[str, tuple[Callable[[], Sweep], tuple[str, ...]]] = {
    "two sensors": (lambda: replace(MAIN, Y=MAIN.Y[..., SWAPPED]), ("u of xA follows y of xB", "y or of u")),
    "two controls": (lambda: replace(MAIN, U=MAIN.U[..., SWAPPED]), ("u of xA follows y of xB and r of xB",)),
    "two currents": (lambda: replace(MAIN, I=current()[..., SWAPPED]), ("i of xA follows u of xB",)),
    "a sensor's sign": (lambda: replace(MAIN, Y=times(MAIN.Y, -1, 1)), ("u of xB is C(z) (+y) + r", "numerator")),
    "a control's sign": (lambda: replace(MAIN, U=times(MAIN.U, -1, 2)), ("u of yA is the negative", "sign")),
    "a current's sign": (lambda: replace(MAIN, I=times(MAIN.I, -1, 3)), ("i of yB is the negative", "sign")),
    "the excitation's sign": (
        lambda: replace(MAIN, U=times(MAIN.U, -1), Y=times(MAIN.Y, -1)),
        ("C(z) (-y) - r", "sign of r"),
    ),
    "one sensor in mm": (lambda: replace(MAIN, Y=times(MAIN.Y, 1e3, 0)), ("u of xA has 0.001 times", "units of y")),
    "u in mA": (lambda: replace(MAIN, U=times(MAIN.U, 1e3)), ("u of xA is 1e+03 times", "mA")),
    "r in mA": (lambda: replace(MAIN, R=times(MAIN.R, 1e3)), ("u of xA has 0.001 times the excitation", "unit of r")),
    "one current in mA": (lambda: replace(MAIN, I=times(MAIN.I, 1e3, 1)), ("i of xB is 1e+03 times", "mA")),
    "u ahead of r": (lambda: replace(MAIN, U=MAIN.U - MAIN.R), ("times the excitation r in it", "where r is added")),
    "conjugates": (
        lambda: replace(MAIN, U=MAIN.U.conj(), I=current().conj(), Y=MAIN.Y.conj()),
        ("U and Y are the conjugate", "exp(-j h w t)", "lowest power"),
    ),
    "conjugates where r is most of u": (
        lambda: driven_hard(replace(MAIN, U=MAIN.U.conj(), I=current().conj(), Y=MAIN.Y.conj())),
        ("U and Y are the conjugate", "exp(-j h w t)"),
    ),
    "conjugate displacements": (lambda: replace(MAIN, Y=MAIN.Y.conj()), ("Y is the conjugate",)),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_a_log_has_swapped_or_turned_is_named(what: str) -> None:
    sweep, said = WRONG[what]
    told = told_of(sweep())
    assert all(words in told for words in said), told


def test_a_diagnosis_looks_at_the_cabling_of_every_sweep() -> None:
    main, other = MEASURED.sweeps
    turned = replace(other, Y=-other.Y)
    told = observed(replace(MEASURED, sweeps=(main, turned)), DATASHEET).wrong_channels
    assert told is not None
    assert told.startswith("sweeps/1: u of xA is C(z) (+y)")


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_datasheet_with_the_controllers_sign_or_order_the_other_way_is_named(sign: float) -> None:
    law = RIG.controller
    other = replace(law, numerator=-law.numerator)
    if sign > 0:
        other = replace(law, numerator=law.numerator[::-1], denominator=law.denominator[::-1])
    told = wrong_channels(MAIN, replace(RIG, controller=other), MEASURED.axes, "sweeps/0")
    assert told is not None
    assert "numerator" in told


@pytest.mark.parametrize(
    "effects",
    [
        {"logging_offset": {"samples": 2}},
        {"controller_mismatch": {"gain_change": 0.2}},
        {"loop_delay": {"delay_s": 1e-4}},
        {"amplifier_bandwidth": {"frequency_change": -0.4}},
        {"channel_crosstalk": {"share_ab": 0.05, "share_ba": -0.05}},
    ],
)
def test_what_a_rig_may_have_is_no_fault_of_the_cabling(effects: dict[str, dict[str, float]]) -> None:
    measured = experiment(with_effects(true_rig(TRUTH), effects))
    for sweep in measured.sweeps:
        assert wrong_channels(sweep, RIG, measured.axes, "sweeps/0") is None
        assert other_law(sweep, RIG, measured.axes, "sweeps/0") == []


def test_a_gain_that_is_a_few_times_another_and_a_channel_of_noise_are_left_to_the_diagnosis() -> None:
    noise = np.random.default_rng(0).normal(size=(*MAIN.Y.shape, 2)) @ [1e-6, 1e-6j]
    for sweep in (replace(MAIN, Y=3 * MAIN.Y), replace(MAIN, Y=noise), replace(MAIN, I=2 * current())):
        assert wrong_channels(sweep, RIG, MEASURED.axes, "sweeps/0") is None


def test_a_law_that_no_axis_shows_is_asked_about_with_the_lines_that_may_be_wrong_instead() -> None:
    assert other_law(MAIN, RIG, MEASURED.axes, "sweeps/0") == []
    in_khz = replace(MAIN, frequency_hz=1e-3 * MAIN.frequency_hz)
    assert wrong_channels(in_khz, RIG, MEASURED.axes, "sweeps/0") is None
    (told,) = other_law(in_khz, RIG, MEASURED.axes, "sweeps/0")
    assert told.startswith("sweeps/0: u of no axis is near")
    assert "check frequency_hz" in told
    one_wrong = replace(MAIN, Y=np.where(np.arange(4) == 0, MAIN.Y[..., ::-1], MAIN.Y))
    assert other_law(one_wrong, RIG, MEASURED.axes, "sweeps/0") == []


SCALED: dict[str, tuple[Callable[[], Sweep], tuple[str, ...]]] = {
    "a sensor": (
        lambda: replace(MAIN, Y=times(MAIN.Y, 1.07, 1)),
        ("xB has 0.935 times what", "scale of y"),
    ),
    "a control": (
        lambda: replace(MAIN, U=times(MAIN.U, 1.06, 2), I=times(current(), 1.06, 2)),
        ("u of yA is 1.06 times", "scale of u"),
    ),
    "a current": (lambda: replace(MAIN, I=times(current(), 0.94, 3)), ("i of yB is 0.94 times", "scale of i")),
}


@pytest.mark.parametrize("what", SCALED)
def test_one_channel_of_another_scale_is_named_with_its_factor(what: str) -> None:
    sweep, said = SCALED[what]
    (told,) = odd_scales(sweep(), RIG, MEASURED.axes, "sweeps/0")
    for words in said:
        assert words in told


def test_what_only_a_unit_or_a_sign_makes_is_no_scale() -> None:
    for what in ("one sensor in mm", "u in mA", "r in mA", "a sensor's sign", "u ahead of r", "one current in mA"):
        assert odd_scales(WRONG[what][0](), RIG, MEASURED.axes, "sweeps/0") == []


def test_the_scale_of_all_excitation_is_told_once() -> None:
    (told,) = odd_scales(replace(MAIN, R=times(MAIN.R, 1.2)), RIG, MEASURED.axes, "sweeps/0")
    assert "u of xA, xB, yA, yB has 0.833 times the excitation r in it" in told
    assert "scale of r" in told


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"loop_delay": {"delay_s": 3e-5}},
        {"amplifier_bandwidth": {"frequency_change": -0.2}},
        {"controller_mismatch": {"lag_samples": 0.3}},
        {"sensor_gain": {"gain_change_xA": 0.1}},
        {"magnetic_saturation": {"saturation_inverse_per_a": 0.6}},
    ],
    ids=str,
)
def test_what_differs_otherwise_at_each_frequency_is_no_scale(effects: dict[str, dict[str, float]]) -> None:
    for sweep in experiment(with_effects(true_rig(TRUTH), effects)).sweeps:
        assert odd_scales(sweep, RIG, MEASURED.axes, "sweeps/0") == []
