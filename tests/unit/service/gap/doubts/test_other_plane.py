"""A plane measured alone does not show what couples it to the other; what looks like it is not named for certain."""

from dataclasses import fields, replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.doubts.other_plane import across_alike, signatures
from service.gap.fitting.nuisance import nuisance
from service.gap.measured.observation import observe
from service.gap.overall_verdict import with_across
from service.gap.weighing.verdict import Verdict
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model, rig_from_datasheet, with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane
from tests.unit.service.gap.where.test_dependence import plant

DATASHEET, TRUTH = known_datasheet(seed=3)
OF_ALL_FLUX = (("time_constant_s", 1e-4), ("displacement_share", 1.0))


@pytest.mark.slow
def test_a_coupling_of_the_planes_is_among_the_causes_that_one_plane_cannot_tell_apart() -> None:
    coupled = with_effects(true_rig(TRUTH), {"magnetic_cross_coupling": {"rotation_rad": 0.04}})
    report = gap_document(diagnose(*one_plane(experiment(coupled), DATASHEET)))
    verdict = report["verdict"]
    assert any("magnetic_cross_coupling" in group for group in verdict["indistinguishable"]), verdict
    assert "magnetic cross coupling" in verdict["sentence"]


def test_four_axes_show_what_couples_them() -> None:
    assert across_alike(plant("linear")[0]) == []


@pytest.mark.parametrize("kind", ["none_of_these", "no_gap", "effect"])
def test_nothing_is_added_where_nothing_looks_alike(kind: str) -> None:
    verdict = Verdict(kind, (), (), 0.9, ())
    assert with_across(verdict, []) is verdict


@pytest.mark.parametrize(
    ("effect", "parameter", "way"),
    [
        ("cross_coupled_stiffness", "stiffness_n_per_m", 1.0),
        ("magnetic_cross_coupling", "symmetric_share", -1.0),
        ("magnetic_cross_coupling", "rotation_rad", 1.0),
    ],
)
@pytest.mark.parametrize("effects", [(), (("eddy_currents", OF_ALL_FLUX),)], ids=["plain", "eddy currents"])
def test_what_comes_back_from_the_other_plane_is_what_four_axes_do(
    effect: str, parameter: str, way: float, effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
) -> None:
    """The y plane's loop closed by elimination; per square of a small coupling, along both inputs."""
    sheet = replace(alike_planes(DATASHEET), effects=effects)
    measured, one = one_plane(experiment(rig_from_datasheet(sheet)), sheet)
    nu = nuisance(one)
    o = observe(measured.sweeps[0], nu.rig)
    hz, size = o.frequency_hz, 2e3 if parameter == "stiffness_n_per_m" else 2e-3
    rig = rig_from_datasheet(sheet)

    def of_x(rig: Rig) -> np.ndarray:
        m = linear_model(rig, hz)
        P, C = m.y_per_u, m.controller[:, None, None]
        return P[:, :2, :2] - P[:, :2, 2:] @ np.linalg.inv(np.eye(2) + C * P[:, 2:, 2:]) @ (C * P[:, 2:, :2])

    coupled = CATALOGUE[effect].on(rig, **{**CATALOGUE[effect].null(), parameter: size})
    change = (of_x(coupled) - of_x(rig)) / size**2
    if parameter == "rotation_rad":  # a turned magnet has less of its force in x as well, cos a

        def weaker(k: float) -> np.ndarray:
            return of_x(replace(rig, magnets=replace(rig.magnets, ki=rig.magnets.ki * k, ks=rig.magnets.ks * k)))

        change = change + 0.5 * (weaker(1 + 1e-5) - weaker(1 - 1e-5)) / 2e-5
    expected = way * (change[o.line] @ o.U[:, o.fundamental, :, None])[..., 0]
    found = signatures(nu.rig, o)[effect]
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def alike_planes(sheet: Datasheet) -> Datasheet:
    """The datasheet with y built as x."""
    of_axes = {
        f.name: (value[:2] * 2)
        for f in fields(sheet)
        if isinstance(value := getattr(sheet, f.name), tuple) and len(value) == 4 and f.name != "axes"
    }
    return replace(sheet, **of_axes)
