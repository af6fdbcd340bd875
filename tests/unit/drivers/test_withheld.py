"""A rig with something withheld: a case of the blind trial, told by its hash, its sealed file and a datasheet alone."""

import json
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.device.machine import RigDevice
from drivers.device.rigs import RigOptions, build_rig
from sim.errors import AmbError
from sim.reference import reference_datasheet
from sim.rig_file import read, to_toml
from sim.withheld.case import draw
from sim.withheld.given import Given
from sim.withheld.seal import names_a_seal, opened
from sim.withheld.unlisted_laws import CoarseLog

SINGLE, CLEAN, LAW = 0, 2, 4


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    return tmp_path / "withheld.json"


@pytest.fixture
def mill(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(to_toml(replace(reference_datasheet(), name="mill")))
    return path


@pytest.mark.parametrize("seed", range(8))
def test_it_is_a_case_of_the_blind_trial(seed: int, sealed: Path) -> None:
    built, case = build_rig(RigOptions(withheld=seed, sealed=sealed)), draw(seed, seed)
    assert opened(json.loads(sealed.read_text()), built.commitment) == case.truth()
    assert repr(built.rig) == repr(case.rig)
    assert built.datasheet == sealed.with_name("withheld.rig.toml")
    assert read(built.datasheet) == case.datasheet


def test_only_its_owner_can_read_the_sealed_file(sealed: Path) -> None:
    sealed.write_text("it was here, for everyone")
    sealed.chmod(0o644)
    built = build_rig(RigOptions(withheld=SINGLE, sealed=sealed))
    assert stat.S_IMODE(sealed.stat().st_mode) == 0o600
    assert built.datasheet is not None
    for word in draw(SINGLE, SINGLE).truth()["effects"]:
        assert word in sealed.read_text()
        assert word not in built.datasheet.read_text() + built.commitment


def test_the_commitment_cannot_be_had_by_sealing_every_case(sealed: Path) -> None:
    one, other = (build_rig(RigOptions(withheld=SINGLE, sealed=sealed)).commitment for _ in range(2))
    assert one != other


def test_a_device_of_a_sealed_truth_names_its_seal(sealed: Path, mill: Path) -> None:
    """And on a bus the name, of 48 characters, still has it."""
    built = build_rig(RigOptions(rig=mill, withheld=CLEAN, sealed=sealed))
    name = RigDevice(built.rig, simulation=built.simulation, identity=built.identity).capabilities().identity
    assert name == f"withheld {built.commitment[:12]}, simulated rig mill"
    assert names_a_seal(name[:48])
    plain = build_rig(RigOptions(rig=mill))
    assert RigDevice(plain.rig, identity=plain.identity).capabilities().identity == "simulated rig mill"


def test_a_law_between_rig_and_log_runs_in_the_device(sealed: Path) -> None:
    case = draw(LAW, LAW)
    assert isinstance(case.tampering, CoarseLog)
    y = build_rig(RigOptions(withheld=LAW, sealed=sealed)).simulation.advance(np.zeros((200, 4))).y
    np.testing.assert_allclose(y / case.tampering.step_m, np.round(y / case.tampering.step_m), atol=1e-9)


def test_a_law_sets_in_when_the_campaign_is_as_far(sealed: Path) -> None:
    seed = next(s for s in range(400) if draw(s, s).law == "loose_connector")

    def y(campaign_s: float) -> np.ndarray:
        options = RigOptions(withheld=seed, sealed=sealed, campaign_s=campaign_s)
        return build_rig(options).simulation.advance(np.zeros((2000, 4))).y

    assert not np.array_equal(y(0.2), y(300.0))
    np.testing.assert_array_equal(y(1400.0), y(300.0))


def test_on_a_rig_that_is_given(sealed: Path, mill: Path) -> None:
    built = build_rig(RigOptions(rig=mill, withheld=SINGLE, sealed=sealed, speed_rad_s=80.0))
    truth = opened(json.loads(sealed.read_text()), built.commitment)
    assert truth == draw(SINGLE, SINGLE, Given(read(mill), speed_rad_s=80.0)).truth()
    assert truth["effects"]
    assert built.datasheet == mill
    assert not sealed.with_name("withheld.rig.toml").exists()


@pytest.mark.parametrize(
    "more", [{"noise": False}, {"gravity_m_per_s2": 9.8}, {"speed_rad_s": 0.0}, {"effects": ("loop_delay",)}]
)
def test_options_that_a_drawn_case_has_no_use_for_are_refused(more: dict[str, object], sealed: Path) -> None:
    with pytest.raises(AmbError, match="--rig"):
        build_rig(RigOptions(withheld=SINGLE, sealed=sealed, **more))  # type: ignore[arg-type]
    assert not sealed.exists()


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(AmbError, match="cannot write the sealed file"):
        build_rig(RigOptions(withheld=SINGLE, sealed=tmp_path / "nowhere" / "withheld.json"))
    (tmp_path / "withheld.rig.toml").mkdir()
    with pytest.raises(AmbError, match="cannot write the datasheet"):
        build_rig(RigOptions(withheld=SINGLE, sealed=tmp_path / "withheld.json"))
