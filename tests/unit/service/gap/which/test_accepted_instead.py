"""One effect that explains most of a gap is named, whatever is likelier and leaves more than its kind may."""

import numpy as np
import pytest

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.ranking import Ranked
from service.gap.which.accepted_instead import accepted_instead
from sim.effects import CATALOGUE
from sim.reference import reference_rig

RIG = reference_rig()
LEFT = 20.0
"""Significance of residuals, far beyond noise"""


def explanation(effects: tuple[str, ...], evidence: float, left: float) -> Ranked:
    values = tuple({p.name: p.typical for p in CATALOGUE[name].parameters} for name in effects)
    fit = Fit(effects, np.zeros(1), values, RIG, ((1.0, 1), (1.0, 1)), 0.0, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, ()), evidence, 0.5, left, (left, left))


PLAIN, OTHER_LAW = explanation((), -900.0, 1.0), explanation(("magnetic_hysteresis",), -400.0, 0.17)


@pytest.mark.parametrize(
    "likelier",
    [
        explanation(("magnetic_hysteresis", "sensor_position", "sensor_lag"), -200.0, 0.11),
        explanation(("eddy_currents",), -380.0, 0.36),
    ],
    ids=["a mixture", "another effect"],
)
def test_a_rejected_explanation_gives_way_to_an_effect_that_leaves_what_another_law_may(likelier: Ranked) -> None:
    """Bouc-Wen hysteresis, fitted by plays, leaves a sixth."""
    order = accepted_instead([likelier, OTHER_LAW, PLAIN], LEFT)
    assert [r.candidate for r in order] == [OTHER_LAW.candidate, likelier.candidate, PLAIN.candidate]
    assert order[1].log_evidence < order[0].log_evidence - ALIKE_LOG_EVIDENCE, "what is rejected is no alias"
    assert order[0].probability > 0.99


def test_an_accepted_explanation_stays_first() -> None:
    both = explanation(("magnetic_hysteresis", "magnetic_saturation"), -200.0, 0.01)
    assert accepted_instead([both, OTHER_LAW, PLAIN], LEFT) == [both, OTHER_LAW, PLAIN]


def test_what_is_left_by_chance_rejects_nothing() -> None:
    mixture = explanation(("magnetic_hysteresis", "sensor_lag"), -200.0, 0.11)
    assert accepted_instead([mixture, OTHER_LAW, PLAIN], remaining=2.0)[0] is mixture


def test_where_every_effect_leaves_too_much_none_is_put_first() -> None:
    worse = explanation(("magnetic_saturation",), -400.0, 0.4)
    mixture = explanation(("magnetic_saturation", "sensor_lag"), -200.0, 0.2)
    assert accepted_instead([mixture, worse, PLAIN], LEFT) == [mixture, worse, PLAIN]
