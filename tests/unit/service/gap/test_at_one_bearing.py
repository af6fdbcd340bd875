"""What is wrong at one bearing or in one axis alone is named as what it is, and where it is."""

from dataclasses import replace

import pytest

from service.gap.diagnose import diagnose
from service.gap.diagnosis import Diagnosis
from service.gap.document import gap_document
from sim.datasheet import Datasheet
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def test_the_bearing_that_drifts_is_told() -> None:
    datasheet, truth = known_datasheet(seed=18)
    values = {"ki_change": -0.02, "ks_change": -0.03, "duration_s": 300.0, "end_imbalance": -1.0}
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), {"thermal_drift": values})), datasheet))
    assert d.verdict.effects == ("thermal_drift",)
    found = d.chosen.fit.values[0]
    assert found["end_imbalance"] == pytest.approx(-1.0, abs=0.1)
    assert (found["ki_change"], found["ks_change"]) == pytest.approx((-0.02, -0.03), rel=0.25)
    told = gap_document(d)["candidates"][0]["parameters"]
    assert told["plane_imbalance"]["value"] == 0.0, "one plane has no other"


def test_one_slow_amplifier_is_told_from_the_others() -> None:
    datasheet, truth = known_datasheet(seed=6)
    values = {"frequency_change": -0.15, "damping_change": 0.0, "lag_s": 0.0, "end_imbalance": 1.0}
    slow = with_effects(true_rig(truth), {"amplifier_bandwidth": values})
    d = diagnose(*one_plane(experiment(slow), datasheet))
    assert d.verdict.effects == ("amplifier_bandwidth",)
    found = d.chosen.fit.values[0]
    assert found["end_imbalance"] == pytest.approx(1.0, abs=0.15)
    assert found["frequency_change"] == pytest.approx(-0.15, rel=0.1)


def test_a_seal_between_the_bearings_is_told_as_one() -> None:
    """An impeller's: it pushes where the rotor is neither bearing's displacement."""
    datasheet, truth = known_datasheet(seed=62)
    values = {"stiffness_n_per_m": 5e4, "end_imbalance": 0.3, "between": 1.0}
    d = diagnose(experiment(with_effects(true_rig(truth), {"cross_coupled_stiffness": values})), datasheet)
    assert d.verdict.effects == ("cross_coupled_stiffness",)
    found = d.chosen.fit.values[0]
    assert (found["stiffness_n_per_m"], found["end_imbalance"]) == pytest.approx((5e4, 0.3), rel=0.1)
    assert found["between"] == pytest.approx(1.0, abs=0.05)


def test_the_bearing_with_the_seal_is_told() -> None:
    datasheet, truth = known_datasheet(seed=5)
    values = {"stiffness_n_per_m": -1e5, "end_imbalance": -1.0}
    d = diagnose(experiment(with_effects(true_rig(truth), {"cross_coupled_stiffness": values})), datasheet)
    assert d.verdict.effects == ("cross_coupled_stiffness",)
    found = d.chosen.fit.values[0]
    assert (found["stiffness_n_per_m"], found["end_imbalance"]) == pytest.approx((-1e5, -1.0), rel=0.05)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("loop_delay", {"delay_s": 1.5e-5}),
        ("sensor_lag", {"time_constant_s": 5e-6, "delay_s": 0.0}),
        ("magnetic_hysteresis", {"loss_angle_rad": 0.01}),
    ],
)
def test_what_one_bearing_alone_has_is_told_by_the_bearing(effect: str, values: dict[str, float]) -> None:
    """Of a sensor, an amplifier or a magnet there is one in each axis: one may be at fault by itself."""
    datasheet, truth = known_datasheet(seed=11)
    at_a = with_effects(true_rig(truth), {effect: {**values, "end_imbalance": 1.0}})
    d = diagnose(*one_plane(experiment(at_a), datasheet))
    assert d.verdict.effects == (effect,)
    found = d.chosen.fit.values[0]
    assert found["end_imbalance"] == pytest.approx(1.0, abs=0.1)
    strength = next(iter(values))
    assert found[strength] == pytest.approx(values[strength], rel=0.15)


def test_amplifiers_that_are_faster_in_y_alone_are_told_with_the_plane() -> None:
    """The largest change is what is stated: on which side that is are valleys apart, and from x none leads to y."""
    datasheet, truth = known_datasheet(seed=64)
    values = {"frequency_change": 0.115, "damping_change": -0.03, "lag_s": 0.0, "plane_imbalance": -1.0}
    rig = with_effects(true_rig(truth), {"amplifier_bandwidth": values})
    d = diagnose(experiment(rig, noise=10.0), datasheet)
    assert d.verdict.effects == ("amplifier_bandwidth",)
    found = d.chosen.fit.values[0]
    assert found["plane_imbalance"] == pytest.approx(-1.0, abs=0.1)
    assert found["frequency_change"] == pytest.approx(0.115, rel=0.1)


def without_currents(datasheet: Datasheet, rig: Rig) -> Diagnosis:
    e = experiment(rig)
    return diagnose(replace(e, sweeps=tuple(replace(s, I=None) for s in e.sweeps)), datasheet)


def test_magnets_turned_at_one_bearing_are_no_crosstalk_where_no_currents_are_logged() -> None:
    """Crosstalk between the planes, as much one way as the other is against it, looks alike to all that is logged."""
    datasheet, truth = known_datasheet(seed=69)
    values = {"rotation_rad": 0.1, "symmetric_share": 0.01, "turned_whole": 1.0, "end_imbalance": 0.9}
    d = without_currents(datasheet, with_effects(true_rig(truth), {"magnetic_cross_coupling": values}))
    assert d.verdict.effects == ("magnetic_cross_coupling",)
    found = d.chosen.fit.values[0]
    assert (found["rotation_rad"], found["end_imbalance"]) == pytest.approx((0.1, 0.9), rel=0.02)


def test_crosstalk_in_one_plane_is_told_though_the_datasheet_had_made_up_for_it() -> None:
    """Without currents, crosstalk of both planes beside values off by tolerances is a valley of its own."""
    datasheet, truth = known_datasheet(seed=77)
    values = {"share_ab": 0.0, "share_ba": 0.015, "share_yx_A": 0.02, "plane_imbalance": 1.0}
    d = without_currents(datasheet, with_effects(true_rig(truth), {"channel_crosstalk": values}))
    assert d.verdict.effects == ("channel_crosstalk",)
    found = d.chosen.fit.values[0]
    assert {name: found[name] for name in values} == pytest.approx(values, rel=0.02, abs=2e-4)
