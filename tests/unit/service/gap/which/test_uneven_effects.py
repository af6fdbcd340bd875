"""A controller, a crosstalk or a pedestal that one axis or plane alone has, or filters tuned otherwise."""

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.which.explained import Explained
from service.gap.which.search import explain
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.no_cover  # other tests cover the lines; traced they take a third longer


def explained(path: str, effect: str, values: dict[str, float]) -> tuple[Explained, Rig]:
    """What a part of the loop of a rig with an effect is explained by, and that rig."""
    datasheet, truth = known_datasheet(seed=3)
    nu, rig = nuisance(datasheet), with_effects(true_rig(truth), {effect: values})
    o = observe(sweep(rig, lines(), 0.15, seed=1), nu.rig)
    part = next(part for part in parts(nu, (o,)) if part.path == path)
    return explain(Fitter(), Ground(nu, part, (o,), np.zeros(len(nu)))), rig


def test_one_soft_pedestal_of_four_is_told_by_its_axis() -> None:
    """Taken for alike under all bearings it would leave nearly half, and a datasheet that is another rig's."""
    values = {"inverse_mass_per_kg": 8e-4, "frequency_hz": 420.0, "damping_ratio": 0.01, "pedestals": 1.0}
    e, rig = explained("plant", "support_resonance", {**values, "end_imbalance": 1.0, "plane_imbalance": 1.0})
    best = e.order[0].candidate
    assert best.effects == ("support_resonance",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found, true = best.fit.rig.support, rig.support
    assert found is not None
    assert true is not None
    assert found.natural_frequency_rad_s == pytest.approx(true.natural_frequency_rad_s, rel=1e-3)
    mobility = [np.array([s.of_axis(k) for k in range(4)]) / s.mass_kg for s in (found, true)]
    np.testing.assert_allclose(*mobility, atol=0.03 * mobility[1].max())


SAME = {"gain_change": 0.0, "derivative_change": 0.0, "lag_samples": 0.0}
ONE_AXIS = {"end_imbalance": -1.0, "plane_imbalance": 1.0}
TUNED = {"filter_frequency_change": 0.03, "zero_damping_change": 0.0, "pole_damping_change": 0.0}
OTHER = {"filter_frequency_change": 0.0, "zero_damping_change": 0.0, "pole_damping_change": 0.1}


@pytest.mark.parametrize("change", [{"gain_change": -0.00375, **ONE_AXIS}, TUNED, OTHER])
def test_a_controller_of_one_axis_and_filters_tuned_otherwise_are_a_mismatch(change: dict[str, float]) -> None:
    e, _ = explained("controller", "controller_mismatch", {**SAME, **change})
    best = e.order[0].candidate
    assert best.effects == ("controller_mismatch",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found = best.fit.values[0]
    assert {name: found[name] for name in change} == pytest.approx(change, rel=0.05, abs=2e-3)


def test_crosstalk_from_one_channel_in_one_plane_is_told_with_the_plane() -> None:
    e, rig = explained("amplifier", "channel_crosstalk", {"share_ab": 0.0175, "share_ba": 0.0, "plane_imbalance": 1.0})
    best = e.order[0].candidate
    assert best.effects == ("channel_crosstalk",)
    np.testing.assert_allclose(best.fit.rig.amplifiers.crosstalk, rig.amplifiers.crosstalk, atol=1e-3)
