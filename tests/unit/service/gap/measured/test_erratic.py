"""Points at which an amplifier does not repeat itself are told and left out, and nothing else that changes is."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.diagnose import diagnose
from service.gap.measured.erratic import erratic, erratic_in_words, ringing_in_words
from service.gap.measured.observation import GapError
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane

RIG = true_rig(known_datasheet(seed=2)[1])
HZ = np.geomspace(12.0, 800.0, 12)


def oscillating(s: Sweep, line: int, axes: set[int], share: float = 0.5) -> Sweep:
    """The sweep with currents that turn against their tone from block to block, as of a limit cycle beside it."""
    I, at = np.array(s.I), np.flatnonzero(s.frequency_hz == np.unique(s.frequency_hz)[line])
    phase = np.exp(2.4j * np.arange(I.shape[1]))
    for k in at:
        if int(s.axis[k]) in axes:
            I[k] *= 1 + share * phase[:, None, None]
    return replace(s, I=I)


def test_a_line_whose_currents_do_not_repeat_is_told_with_its_axes() -> None:
    s = oscillating(sweep(RIG, HZ, 0.1, 1), 7, {0, 2})
    out = erratic(s)
    assert set(zip(s.frequency_hz[out], s.axis[out].tolist(), strict=True)) == {(HZ[7], 0), (HZ[7], 2)}
    ((words, several),) = erratic_in_words(s, out, RIG.axes, "sweeps/0")
    assert f"at {HZ[7]:.4g} Hz in sweeps/0 the currents of xA, yA do not repeat" in words
    assert several
    ((_, several),) = erratic_in_words(s, out & (s.axis == 0), RIG.axes, "sweeps/0")
    assert not several, "one axis alone may be one disturbed record"


def test_a_probe_that_is_loud_at_every_line_is_weighed_and_not_left_out() -> None:
    s = sweep(RIG, HZ, 0.1, 1)
    for line in range(len(HZ)):
        s = oscillating(s, line, {0})
    assert not erratic(s).any()


def ringing(s: Sweep, rig: Rig) -> Sweep:
    """The sweep with control signals that decay by half of themselves over the blocks, and currents that follow."""
    decay = 0.5 * np.exp(-np.arange(s.U.shape[1]))[:, None]
    f, U, I = s.harmonics.index(1), np.array(s.U), np.array(s.I)
    A = linear_model(rig, s.frequency_hz).i_per_u
    more = U[:, :, f] * decay
    U[:, :, f] += more
    I[:, :, f] += np.einsum("pij,pbj->pbi", A, more)
    return replace(s, U=U, I=I)


@pytest.mark.parametrize("noise", [1.0, 300.0])
def test_what_rings_and_what_is_loud_is_not_erratic(noise: float) -> None:
    assert not erratic(ringing(sweep(RIG, HZ, 0.1, 1, noise), RIG)).any()


def at_line(s: Sweep, line: int) -> np.ndarray:
    """Points of a line, (P,)."""
    return s.frequency_hz == np.unique(s.frequency_hz)[line]


def test_a_loop_that_rings_is_told_and_no_amplifier_is_blamed_for_what_follows_its_control_signal() -> None:
    """Currents of several times their mean that do not repeat, and follow u but for what changes within a block."""
    s = sweep(RIG, HZ, 0.1, 1)
    rng, U, I = np.random.default_rng(3), np.array(s.U), np.array(s.I)
    there = at_line(s, 8)
    more = (
        8.0
        * np.abs(I[there, :, 1:2]).max()
        * (rng.standard_normal((4, 6, 1, 4)) + 1j * rng.standard_normal((4, 6, 1, 4)))
    )
    more -= more.mean(axis=1, keepdims=True)
    U[there, :, 1:2] += more
    I[there, :, 1:2] += 0.95 * more * (1 + 0.02 * rng.standard_normal(more.shape))
    rings = replace(s, U=U, I=I)
    assert not erratic(rings).any()
    (told,) = ringing_in_words(rings, RIG.axes, "sweeps/0")
    assert told.startswith(f"at {HZ[8]:.4g} Hz in sweeps/0 the currents of xA, xB, yA, yB change from block to block")
    assert "hardly stable or not settled" in told
    for other in (s, sweep(RIG, HZ, 0.1, 1, 300.0), replace(rings, I=None), oscillating(s, 7, {0, 2}, 3.0)):
        assert ringing_in_words(other, RIG.axes, "sweeps/0") == []


def test_a_small_current_beside_the_noise_of_all_lines_is_not_erratic() -> None:
    """At an antiresonance the noise of a probe is a large share of the current, and no more than elsewhere."""
    s = sweep(RIG, HZ, 0.1, 1)
    I, small = np.array(s.I), at_line(s, 7)
    I[small] *= 2e-3
    I[small] += s.I[small] - s.I[small].mean(axis=1, keepdims=True)
    assert not erratic(replace(s, I=I)).any()


def test_without_currents_or_blocks_nothing_is_told() -> None:
    s = oscillating(sweep(RIG, HZ, 0.1, 1), 7, {0, 2})
    assert not erratic(replace(s, I=None)).any()
    two = {name: getattr(s, name)[:, :2] for name in ("R", "U", "I", "Y")}
    assert not erratic(replace(s, **two)).any()


STEEPEST, OTHER = 15, 11
"""Lines of the other sweep: that in which currents are steepest, and one in which they are not."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "line", "axes", "kind", "named"),
    [
        (None, OTHER, {0, 1}, "none_of_these", ()),
        (None, OTHER, {1}, "no_gap", ()),
        (None, STEEPEST, {1}, "no_gap", ()),
        (None, STEEPEST, {0, 1}, "effect", ("amplifier_voltage_limit",)),
        ("sensor_lag", STEEPEST, {0, 1}, "effects", ("sensor_lag", "amplifier_voltage_limit")),
        ("magnetic_saturation", OTHER, {0, 1}, "effect", ("magnetic_saturation",)),
        ("loop_delay", STEEPEST, {0, 1}, "none_of_these", ()),
    ],
)
def test_several_axes_that_are_erratic_are_no_clean_rig_and_one_is_left_out(
    effect: str | None, line: int, axes: set[int], kind: str, named: tuple[str, ...]
) -> None:
    """Nor is what answers in proportion to the tone the cause; a force or a limit that grows with it may be.

    Where no current was as steep it is the voltage that ends; amplifiers with another effect may do so by that.
    """
    datasheet, _ = known_datasheet(seed=2)
    rig = (
        RIG
        if effect is None
        else with_effects(RIG, {effect: {p.name: p.typical for p in CATALOGUE[effect].parameters}})
    )
    measured, datasheet = one_plane(experiment(rig), datasheet)
    main, other = measured.sweeps
    d = diagnose(replace(measured, sweeps=(main, oscillating(other, line, axes))), datasheet)
    assert (d.verdict.kind, d.verdict.effects) == (kind, named)
    assert any("do not repeat from block to block" in note and "left out" in note for note in d.notes)
    if kind == "none_of_these":
        assert "do not repeat" in d.verdict.reasons[0]
    if "amplifier_voltage_limit" in named:
        values = d.chosen.fit.values[named.index("amplifier_voltage_limit")]
        rates = 2 * np.pi * other.frequency_hz * np.abs(other.I[np.arange(other.n_points), :, 1, other.axis].mean(1))
        rates = rates[other.axis < 2]
        followed = rates[other.frequency_hz[other.axis < 2] < np.unique(other.frequency_hz)[line]].max()
        assert followed < 1 / values["slew_inverse_s_per_a"] < rates.max()
        limits = d.chosen.fit.rig.amplifiers.slew_limit_a_per_s
        assert limits == pytest.approx(1 / values["slew_inverse_s_per_a"])


def test_too_few_lines_that_repeat_are_no_diagnosis() -> None:
    datasheet, _ = known_datasheet(seed=2)
    measured, datasheet = one_plane(experiment(RIG), datasheet)
    main, other = measured.sweeps
    five = main.select(np.isin(main.frequency_hz, np.unique(main.frequency_hz)[-5:]))
    with pytest.raises(GapError, match=r"sweeps/0 has 4 repeating lines; a diagnosis needs at least 5"):
        diagnose(replace(measured, sweeps=(oscillating(five, 3, {0, 1}), other)), datasheet)
