"""The service's own folders are its user's alone, where they are made here."""

import pytest

from service.config import Settings
from service.errors import StorageError
from service.private import make_folders


def mode(path):
    return path.stat().st_mode & 0o777


def test_nobody_else_enters_the_folders_of_a_new_service(tmp_path):
    home = tmp_path / "home"
    make_folders(Settings(home=home))
    assert {path.name: mode(path) for path in (home, *home.iterdir())} == {"home": 0o700, "work": 0o700, "store": 0o700}


def test_a_home_that_others_enter_stays_open_to_them(tmp_path):
    tmp_path.chmod(0o755)
    make_folders(Settings(home=tmp_path))
    assert mode(tmp_path) == 0o755


def test_a_home_that_cannot_be_made_is_named_with_the_remedy(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=f"cannot make the folder {tmp_path}/file/home: .*; choose another home"):
        make_folders(Settings(home=tmp_path / "file" / "home"))
