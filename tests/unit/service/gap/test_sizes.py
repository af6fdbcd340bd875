"""No verdict hangs on the size of a rig: the same experiment, were the rotor a hundredth as heavy."""

from dataclasses import replace

import pytest

from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from sim.datasheet import Datasheet, Mode
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def of_mass(sheet: Datasheet, factor: float) -> Datasheet:
    """A rig whose rotor and magnets are so much heavier and stronger, which moves as the one it is taken from."""

    def mode(m: Mode) -> Mode:
        at_bearings, at_sensors = (
            (a / factor**0.5, b / factor**0.5) for a, b in (m.shape_at_bearings, m.shape_at_sensors)
        )
        return replace(m, shape_at_bearings=at_bearings, shape_at_sensors=at_sensors)

    return replace(
        sheet,
        mass_kg=sheet.mass_kg * factor,
        transverse_inertia_kgm2=sheet.transverse_inertia_kgm2 * factor,
        current_stiffness_n_per_a=tuple(factor * v for v in sheet.current_stiffness_n_per_a),
        position_stiffness_n_per_m=tuple(factor * v for v in sheet.position_stiffness_n_per_m),
        modes=tuple(map(mode, sheet.modes)),
    )


@pytest.mark.parametrize(
    ("effect", "values", "per_kg"),
    [
        ("support_resonance", {"inverse_mass_per_kg": 1 / 900, "frequency_hz": 430.0}, {"inverse_mass_per_kg": -1.0}),
        (
            "extra_flexible_mode",
            {"frequency_hz": 700.0, "sensor_A_per_sqrt_kg": 0.03, "sensor_B_per_sqrt_kg": -0.03},
            {"bearing_A_per_sqrt_kg": -0.5, "bearing_B_per_sqrt_kg": -0.5},
        ),
    ],
)
def test_a_light_rotor_has_the_same_gap(effect: str, values: dict[str, float], per_kg: dict[str, float]) -> None:
    sheet, truth = known_datasheet(seed=2)
    measured, sheet = one_plane(experiment(with_effects(true_rig(truth), {effect: values})), sheet)
    heavy, light = (gap_document(diagnose(measured, s)) for s in (sheet, of_mass(sheet, 0.01)))
    assert heavy["verdict"]["effects"] == light["verdict"]["effects"] == [effect]
    assert light["verdict"]["probability"] == pytest.approx(heavy["verdict"]["probability"], abs=0.01)
    assert light["shrinkage"]["closure"] == pytest.approx(heavy["shrinkage"]["closure"], abs=0.01)
    for name, power in per_kg.items():
        of_heavy, of_light = (d["candidates"][0]["parameters"][name] for d in (heavy, light))
        assert of_light["value"] == pytest.approx(of_heavy["value"] * 0.01**power, rel=0.01)
        assert of_light["std"] == pytest.approx(of_heavy["std"] * 0.01**power, rel=0.05)
