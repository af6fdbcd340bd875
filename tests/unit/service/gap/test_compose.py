"""Whole twins: each part's values as the explanation chosen for that part has them."""

import numpy as np
import pytest

from service.gap.compose import composed
from service.gap.explain_parts import explain_parts
from service.gap.fitting.candidates import Fitter
from service.gap.observed import observed
from service.gap.progress import Progress
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def test_an_alternative_of_the_amplifiers_keeps_its_own_values() -> None:
    """The plant has moved those of the explanation that it was fitted behind, and of no other."""
    datasheet, truth = known_datasheet(seed=11)
    rig = with_effects(true_rig(truth), {"sensor_lag": {"time_constant_s": 2e-5}})
    data = observed(*one_plane(experiment(rig), datasheet))
    with Fitter() as fitter:
        parts = explain_parts(data, fitter, Progress(None)).parts
    amplifiers, plant = (next(e for e in parts if e.part.path == path) for path in ("amplifier", "plant"))
    assert (amplifiers.chosen.effects, plant.chosen.effects) == ((), ("sensor_lag",))
    order = composed(data.nuisance, parts).order
    whole = {frozenset(r.candidate.effects): r.candidate.fit for r in order}
    left_open = {frozenset(r.candidate.effects): r.open_strength for r in order}
    assert left_open[frozenset({"sensor_lag"})] == ()
    active = amplifiers.part.active
    np.testing.assert_array_equal(whole[frozenset({"sensor_lag"})].theta[active], plant.chosen.fit.theta[active])
    others = [r.candidate for r in amplifiers.order[:5] if r.candidate.effects]
    assert others
    for c in others:
        fit = whole[frozenset({"sensor_lag", *c.effects})]
        np.testing.assert_array_equal(fit.theta[active], c.fit.theta[active], err_msg=" + ".join(c.effects))
    limit = frozenset({"sensor_lag", "amplifier_voltage_limit"})
    assert left_open[limit] == ("amplifier_voltage_limit",), "of amplifiers that lack nothing no limit is told"
