"""What the operating system refuses is told with the thing and in words, without the system's numbers."""

import re

import pytest

from service.cli import run


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["identify", "folder", "--rig", "rig.toml", "--out", "out"], "folder cannot be read.*Is a directory"),
        (["keys", "create", "--home", "file/home"], "cannot use the database .*file/home/ambit.db: Not a directory"),
        (["serve", "--config", "folder"], "cannot read the settings folder: Is a directory"),
        (["jobs", "--url", "https://127.0.0.1", "--ca", "no.pem"], "cannot read the authority no.pem: No such file"),
        (["rig", "serve", "--protocol", "modbus", "--map", "folder"], "cannot read the map folder: Is a directory"),
    ],
)
def test_a_file_that_cannot_be_used_is_told_in_words(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    assert run(["rig", "datasheet", "--out", "rig.toml"]) == 0
    capsys.readouterr()
    assert run(words) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "Errno" not in line
    assert re.match(f"ambit: {said}", line), line
