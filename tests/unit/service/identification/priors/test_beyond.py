"""What is known of modes beyond the band: no rotor is damped, or bends, as they would to fit the last lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.fit import identify
from service.identification.plane.model import PlaneModel
from service.identification.priors.beyond import BEYOND_ROWS, beyond_rows
from service.identification.priors.split import Knowledge, Split, held_rows
from service.identification.steps.start import with_modes
from tests.support.rotors import drawn_rig

SECOND = np.array([False, True])
NONE = np.empty(0)
CLOSE_BEYOND = (
    *(0.5, 1.4, 0.8997601669135499, 0.1529883140445408, 0.004408446785278275, 1.008445643507704),
    *(0.6359886387360215, 0.008, 7.460977062975013, 840.0611821356121, 3047.560554544375, 189.54119890432122),
    *(360.0, 864.4931804575214, 359.68705106027755, 430.0, 88.0, 430.0, 0.7, 0.7982802023330586),
    *(0.06895744838023748, 0.0806, 1.0667869667674383, 0.8101705855566063, 1.0060935307780394, 1.1260373521313978),
    *(-2.6383015926753326, -2.390250231804409, -2.5042321493560196, -3.0, -2.7651468028943853),
    *(9646.147874668462, 0.9, 11569.084921511425, 0.9, 1.7273062918953273e-05),
)
"""A rotor with three modes in the band and, at 1614 and 2606 Hz, two beyond it."""


def second_changed(model: PlaneModel, zeta: float | None = None, larger: float = 1.0) -> PlaneModel:
    """The model with another damping and size of its second mode."""
    modes = model.modes.copy()
    if zeta is not None:
        modes[1, 1] = zeta * modes[1, 0]
    modes[1, 2:6] *= larger
    return replace(model, theta=with_modes(model, modes).theta)


@pytest.mark.parametrize("zeta", [-0.2, 0.0002, 0.004, 0.05])
def test_damping_is_known(truth: dict[str, PlaneModel], zeta: float) -> None:
    damping = beyond_rows(second_changed(truth["x"], zeta), SECOND)[0][0]
    assert damping > 2.0 if zeta > 0.04 else damping < -2.5 if zeta < 0.001 else abs(damping) < 0.5
    if zeta < 0:
        assert damping < -100.0  # whatever the highest lines say


def test_shapes_are_of_the_order_of_the_rigid_one(truth: dict[str, PlaneModel]) -> None:
    """The reference rotor's (Appendix A of the thesis) are as likely as any; ten times as large ones are none."""
    usual = beyond_rows(truth["x"], SECOND)[0][1:]
    assert usual @ usual < 4.0  # as many as there are
    absurd = beyond_rows(second_changed(truth["x"], larger=10.0), SECOND)[0][1:]
    assert absurd == pytest.approx(10 * usual)
    assert absurd @ absurd > 100.0


@pytest.mark.parametrize("counting", [True, False])
@pytest.mark.parametrize("zeta", [-0.2, 0.0002, 0.004])
def test_slopes_are_exact(truth: dict[str, PlaneModel], zeta: float, counting: bool) -> None:
    model = second_changed(truth["x"], zeta)
    rows, jacobian = beyond_rows(model, SECOND, counting)
    assert jacobian.shape == (len(rows), model.layout.size) == (BEYOND_ROWS, model.layout.size)
    for k in range(model.layout.size):
        step = np.zeros_like(model.theta)
        step[k] = 1e-6 * max(abs(model.theta[k]), 1e-9)
        up, down = (beyond_rows(model.at(model.theta + d), SECOND, counting)[0] for d in (step, -step))
        slope = (up - down) / (2 * step[k])
        assert np.allclose(jacobian[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(jacobian).max())


def test_it_stands_beside_what_is_known_of_splits(truth: dict[str, PlaneModel]) -> None:
    model = second_changed(truth["x"], 0.05)
    end = float(model.modes[1, 0]) - 1.0
    held, _ = held_rows(model, Split.of(model, end))
    assert np.allclose(held[:BEYOND_ROWS], beyond_rows(model, SECOND)[0])
    assert np.allclose(held[BEYOND_ROWS:], 0.0)  # the splits last, where they are
    assert len(held_rows(model, Split.of(model, float(model.modes[1, 0]) + 1.0))[0]) == 2
    known, _ = held_rows(model, Knowledge(None, (True, True), NONE, NONE, 0.1, end))
    none, _ = held_rows(model, Knowledge(None, (True, True), NONE, NONE, 0.1))
    assert np.allclose(known[BEYOND_ROWS : 2 * BEYOND_ROWS], beyond_rows(model, SECOND, counting=True)[0])
    assert np.allclose(none[: 2 * BEYOND_ROWS], 0.0)
    assert len(known) == len(none)  # also while a mode crosses the band's end


def test_two_modes_beyond_the_band_cannot_pass_for_ki() -> None:
    """Two at one frequency, with shapes of twelve times the rigid one's, left ki to 2.4 % where data tell 0.07 %."""
    values = iter(CLOSE_BEYOND)
    rig = drawn_rig("close modes", lambda low, high: next(values))
    plane = identify(rig.experiment(0.00495, 893), rig.sheet).planes["x"]
    for name, value in zip(("kiA", "kiB", "ksA", "ksB"), [*rig.model.ki, *rig.model.ks], strict=True):
        estimate = plane.stiffness[name]
        assert estimate.std < 0.003 * value, name
        assert abs(estimate.value - value) < 4 * estimate.std, name
