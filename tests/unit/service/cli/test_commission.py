"""What the command line says of a campaign that its controller did not see through."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from drivers.errors import BusError
from service import bootstrap
from service.campaign.journal import line
from service.campaign.run import JOURNAL
from service.cli import run
from service.cli.commission import commission_directly
from sim.reference import reference_datasheet
from sim.rig_file import to_toml


@pytest.mark.parametrize(("lines", "measured"), [(2, True), (1, False), (0, False)])
def test_a_bus_that_fails_is_told_with_what_is_kept_where_anything_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lines: int, measured: bool
) -> None:
    """A journal begins with what the campaign is: that alone is nothing measured."""

    def silent(*_: object) -> None:
        if lines:
            (tmp_path / JOURNAL).write_bytes(line({"phase": "main"}) * lines)
        raise BusError("cannot connect: Connection refused")

    monkeypatch.setattr(bootstrap, "measure", silent)
    with pytest.raises(BusError, match=r"^cannot connect: Connection refused") as told:
        commission_directly(nullcontext(), reference_datasheet(), tmp_path, True, True, False, None)  # type: ignore[arg-type]
    assert (f"kept in {tmp_path}: run it again to go on" in str(told.value)) is measured


def test_a_controller_that_is_not_reached_leaves_no_empty_folder(tmp_path: Path, capsys) -> None:
    sheet = tmp_path / "rig.toml"
    sheet.write_text(to_toml(reference_datasheet()))
    words = ["commission", "--controller", "modbus://127.0.0.1:9", "--rig", str(sheet), "--out"]
    assert run([*words, str(tmp_path / "new" / "one")]) == 1
    assert "127.0.0.1:9" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    (tmp_path / "mine").mkdir()
    assert run([*words, str(tmp_path / "mine" / "two")]) == 1
    assert list((tmp_path / "mine").iterdir()) == []


def test_an_experiment_that_cannot_be_read_leaves_no_empty_folder(tmp_path: Path) -> None:
    sheet = tmp_path / "rig.toml"
    sheet.write_text(to_toml(reference_datasheet()))
    out = tmp_path / "out"
    assert run(["identify", str(tmp_path / "nothing.h5"), "--rig", str(sheet), "--out", str(out)]) == 1
    assert not out.exists()


@pytest.mark.parametrize("command", [["identify"], ["gap", "diagnose"]])
def test_a_file_that_is_no_experiment_leaves_no_empty_folder(tmp_path: Path, capsys, command: list[str]) -> None:
    sheet = tmp_path / "rig.toml"
    sheet.write_text(to_toml(reference_datasheet()))
    assert run([*command, str(sheet), "--rig", str(sheet), "--out", str(tmp_path / "new" / "one")]) == 1
    assert f"{sheet} is no HDF5 or MATLAB file" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
