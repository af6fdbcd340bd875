"""Which rig a device simulates, and what is withheld in it."""

import json
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.device.rigs import RigOptions, build_rig, parse_effect
from drivers.device.withheld import Withheld, draw, opened, seal
from sim.errors import AmbError, DatasheetError, EffectError
from sim.reference import reference_datasheet, reference_rig
from sim.rig_file import to_toml


def test_without_options_it_is_the_reference_rig() -> None:
    built = build_rig(RigOptions())
    assert built.rig.name == reference_rig().name
    assert built.rig.noise == reference_rig().noise
    assert built.commitment == ""


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


def test_withheld_effect_is_in_the_rig_and_only_in_the_sealed_file(tmp_path: Path) -> None:
    sealed = tmp_path / "withheld.json"
    built = build_rig(RigOptions(withheld=12, sealed=sealed))
    truth = opened(sealed, built.commitment)
    assert truth == draw(reference_rig(), 12)
    assert repr(built.rig) == repr(truth.on(reference_rig()))
    assert truth.effect not in built.commitment
    assert stat.S_IMODE(sealed.stat().st_mode) == 0o600


def test_seeds_draw_different_effects() -> None:
    assert len({draw(reference_rig(), seed).effect for seed in range(12)}) > 2


def test_changed_sealed_file_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "withheld.json"
    commitment = seal(Withheld("loop_delay", (("delay_s", 3e-5),)), path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"truth": content["truth"].replace("3e-05", "4e-05")}))
    with pytest.raises(AmbError, match="was changed"):
        opened(path, commitment)
    path.write_text("{}")
    with pytest.raises(AmbError, match="cannot read the sealed file"):
        opened(path, commitment)


def test_two_seals_of_one_truth_differ(tmp_path: Path) -> None:
    """The commitment must not tell the effect to someone who tries them all."""
    truth = Withheld("loop_delay", (("delay_s", 3e-5),))
    assert seal(truth, tmp_path / "a.json") != seal(truth, tmp_path / "b.json")
