"""Which rig a device simulates; what is withheld in it is in test_withheld.py."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.device.rigs import RigOptions, build_rig, parse_effect
from sim.errors import DatasheetError, EffectError
from sim.reference import reference_datasheet, reference_rig
from sim.rig_file import to_toml


def test_without_options_it_is_the_reference_rig() -> None:
    built = build_rig(RigOptions())
    assert built.rig.name == reference_rig().name
    assert built.rig.noise == reference_rig().noise
    assert built.simulation.rig is built.rig
    assert (built.commitment, built.datasheet) == ("", None)


def test_datasheet_gets_the_noise_of_real_sensors(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(to_toml(replace(reference_datasheet(), name="other")))
    assert build_rig(RigOptions(rig=path)).rig.noise.displacement_m == 20e-9
    assert build_rig(RigOptions(rig=path, noise=False)).rig.noise.displacement_m == 0
    assert build_rig(RigOptions(rig=path)).rig.name == "other"
    with pytest.raises(DatasheetError):
        build_rig(RigOptions(rig=tmp_path / "nowhere.toml"))


def test_effects_are_put_on() -> None:
    rig = build_rig(RigOptions(effects=("loop_delay=35e-6",))).rig
    np.testing.assert_allclose(rig.amplifiers.delay_s, 35e-6)


@pytest.mark.parametrize("text", ["loop_delay=slow", "gremlins", "loop_delay:colour=1"])
def test_wrong_effect_is_refused(text: str) -> None:
    with pytest.raises(EffectError):
        build_rig(RigOptions(effects=(text,)))


def test_effect_without_value_is_typical() -> None:
    assert parse_effect("loop_delay") == ("loop_delay", {})
