"""What a gap means for the loop: S, T and stiffness are those of the rig, whatever lies between the measured lines."""

from dataclasses import fields, replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.loop import QUANTITIES, drawn_twins, loop_figures, measured_responses
from service.gap.measured.observation import observe
from sim.twin import linear_model, with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

TWIN = true_rig(known_datasheet(seed=1)[1])
RIG = with_effects(TWIN, {"loop_delay": {"delay_s": 4e-5}})
HZ = np.geomspace(10.0, 950.0, 24)
O = observe(sweep(RIG, HZ, 0.1, seed=3), TWIN)
FIGURES = loop_figures(TWIN, RIG, O, {"before": [TWIN] * 3, "after": [RIG] * 3})


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_the_right_twin_predicts_what_is_measured_where_it_is_measured(quantity: str) -> None:
    for axis, of in FIGURES["extremes"][quantity].items():
        seen = of["measured"]
        assert of["after"]["at_measured_lines"] == pytest.approx(
            seen["value"], abs=5 * seen["std"] + 2e-3 * seen["value"]
        ), axis
        assert seen["std"] < 0.05 * seen["value"]


def test_a_peak_between_the_lines_is_predicted() -> None:
    """Few lines miss the peak of a flexible mode; the prediction does not."""
    dense = np.linspace(HZ[0], HZ[-1], 40000)
    peak = np.abs(linear_model(RIG, dense).u_per_r[:, 0, 0]).max()
    of = FIGURES["extremes"]["sensitivity"]["xA"]["after"]
    assert of["value"] == pytest.approx(peak, rel=0.05)
    assert of["value"] > of["at_measured_lines"]


def test_the_smallest_stiffness_is_that_of_force_over_displacement() -> None:
    model = linear_model(TWIN, HZ)
    y_per_force = np.abs(
        (model.y_per_u @ model.u_per_r / (model.i_per_u[:, 0, 0] * TWIN.magnets.ki[0])[:, None, None])[:, 0, 0]
    )
    of = FIGURES["extremes"]["dynamic_stiffness"]["xA"]["before"]
    assert of["at_measured_lines"] == pytest.approx(1 / y_per_force.max(), rel=1e-6)


def test_a_point_that_had_not_settled_makes_no_peak() -> None:
    drifting = O.drifting.copy()
    worst = int(np.argmax(np.abs(O.U[:, O.fundamental]).max(axis=1)))
    drifting[worst] = True
    drift = np.where(drifting, 0.3, 0.0)
    found = loop_figures(TWIN, RIG, replace(O, drifting=drifting, drift=drift))
    assert O.points_hz[worst] in found["not_settled_hz"]
    assert O.points_hz[worst] not in [
        of["measured"]["frequency_hz"] for of in found["extremes"]["sensitivity"].values()
    ]


def test_peaks_are_told_with_and_without_the_line_that_had_not_settled() -> None:
    own = np.abs(
        O.U[np.arange(len(O.axis)), O.fundamental, O.axis] / O.R[np.arange(len(O.axis)), O.fundamental, O.axis]
    )
    worst = O.line == O.line[np.argmax(own)]
    found = loop_figures(TWIN, RIG, replace(O, drifting=worst, drift=np.where(worst, 0.3, 0.0)))
    assert found["not_settled_hz"] == [O.frequency_hz[O.line[np.argmax(own)]]]
    assert found["not_settled_change"] == 0.3
    assert found["not_every_axis_hz"] == []
    without, whole = found["sensitivity_peak"], found["sensitivity_peak_with_not_settled"]
    quiet = loop_figures(TWIN, RIG, replace(O, drifting=np.zeros(len(O.axis), dtype=bool)))
    assert whole == quiet["sensitivity_peak"]
    assert quiet["sensitivity_peak_with_not_settled"] is None
    assert any(without[of][axis] < whole[of][axis] for of in whole for axis in TWIN.axes)


def test_a_line_without_one_axis_is_not_said_not_to_have_settled() -> None:
    first = np.flatnonzero(O.line == 3)[0]
    kept = np.arange(len(O.axis)) != first
    arrays = {k: v[kept] for k, v in vars(O).items() if isinstance(v, np.ndarray) and len(v) == len(kept)}
    found = loop_figures(TWIN, RIG, replace(O, **arrays))
    assert found["not_every_axis_hz"] == [O.frequency_hz[3]]
    assert found["not_settled_hz"] == FIGURES["not_settled_hz"]


def test_twins_are_drawn_within_the_tolerances_however_loud_the_data() -> None:
    """Half of the directions are told to parts in ten million of the tolerances and less, the others not at all."""
    nu = nuisance(known_datasheet(seed=1)[0])
    k = len(nu)
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((k, k)))[0]
    loud = np.concatenate([np.zeros(k // 2), np.geomspace(1e10, 3e15, k - k // 2)])
    fit = Fit((), np.zeros(k), (), nu.rig, (), 0.0, np.arange(k), basis * loud @ basis.T, "")
    rigs = drawn_twins(nu, Candidate((), fit, 0.0, ()), count=400)
    spread = np.std([r.magnets.ki / nu.rig.magnets.ki for r in rigs], axis=0)
    assert np.all((spread > 0.03) & (spread < 0.3))


def test_the_stated_deviation_of_a_measured_figure_is_that_of_campaign_after_campaign() -> None:
    """What a part of the loop leaves scatters less than what the loop makes of it."""
    hz = np.geomspace(10.0, 950.0, 12)
    found = [loop_figures(TWIN, RIG, observe(sweep(RIG, hz, 0.1, seed), TWIN))["extremes"] for seed in range(30)]
    for quantity in QUANTITIES:
        ratios = []
        for axis in TWIN.axes:
            told = [of[quantity][axis]["measured"] for of in found]
            ratios.append(np.std([t["value"] for t in told], ddof=1) / np.mean([t["std"] for t in told]))
        # noise is least where T and the compliance are largest, and no twin is trusted as far: that counts, too
        assert (0.6 if quantity == "sensitivity" else 0.25) < np.mean(ratios) < 1.6, quantity


def test_of_a_line_that_was_measured_twice_both_points_count() -> None:
    twice = {
        f.name: np.concatenate([v, v])
        for f in fields(O)
        if isinstance(v := getattr(O, f.name), np.ndarray) and f.name != "frequency_hz"
    }
    off = np.repeat([1.1, 0.9], len(O.axis))[:, None, None]
    both = replace(O, **twice | {"Y": twice["Y"] * off})
    once, of_both = (measured_responses(o, np.ones(len(o.axis), dtype=bool)) for o in (O, both))
    assert once is not None
    assert of_both is not None
    for one, other in zip(once[:3], of_both[:3], strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-6, atol=1e-9 * np.abs(one).max())
