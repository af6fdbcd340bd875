"""A controller may have a filter that its datasheet does not know: what it does is named, whatever the filter."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.weighing.verdict import rejected
from service.gap.which.explained import Explained
from service.gap.which.search import explain
from sim.rig import ControlLaw
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.slow


def explained(b: np.ndarray, a: np.ndarray) -> Explained:
    """The controller of a rig that has b/a in series with the one of its datasheet."""
    datasheet, truth = known_datasheet(seed=17)
    rig, nu = true_rig(truth), nuisance(datasheet)
    law: ControlLaw = rig.controller
    law = replace(law, numerator=np.polymul(law.numerator, b), denominator=np.polymul(law.denominator, a))
    o = observe(sweep(replace(rig, controller=law), lines(24), 0.15, seed=3), nu.rig)
    part = next(p for p in parts(nu, (o,)) if p.path == "controller")
    with Fitter(1) as fitter:
        return explain(fitter, Ground(nu, part, (o,), np.zeros(len(nu))))


def two_pairs(hz: float, zeros: float, poles: float) -> tuple[np.ndarray, np.ndarray]:
    """A notch by matched roots, not by Tustin's rule: of unit gain at rest."""
    step = 2 * np.pi * hz * 1e-4
    b, a = (
        np.real(np.poly([np.exp(step * (-zeta + sign * 1j * (1 - zeta**2) ** 0.5)) for sign in (1, -1)]))
        for zeta in (zeros, poles)
    )
    return b * a.sum() / b.sum(), a


def test_a_notch_of_the_firmware_is_named_with_its_frequency_and_depth() -> None:
    found = explained(*two_pairs(230.0, 0.35, 0.5))
    best = found.order[0]
    assert best.candidate.effects == ("controller_mismatch",)
    assert not rejected(best, found.remaining)
    values = best.candidate.fit.values[0]
    assert values["filter_frequency_hz"] == pytest.approx(230.0, rel=0.01)
    assert values["filter_mid_change"] == pytest.approx(-0.3, abs=0.01)
    for name in ("gain_change", "filter_low_change", "filter_high_change"):
        assert values[name] == pytest.approx(0.0, abs=0.01)


def test_three_times_the_integral_part_by_a_slow_lag_is_named() -> None:
    """A part of a PID that is not in the form of a PID: one pole at 0.3 Hz, and a zero at 0.9 Hz."""
    zero, pole = (np.exp(-2 * np.pi * hz * 1e-4) for hz in (0.9, 0.3))
    found = explained(np.array([1.0, -zero]), np.array([1.0, -pole]))
    best = found.order[0]
    assert best.candidate.effects == ("controller_mismatch",)
    assert not rejected(best, found.remaining)
    assert best.unexplained < 1e-4
