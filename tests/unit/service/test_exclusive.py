"""A folder that one process at a time has for itself."""

import errno
import fcntl

import pytest

from service.errors import ConflictError
from service.exclusive import LOCK, sole_use


def test_whoever_comes_second_is_told_who_is_there_and_what_to_do(tmp_path):
    with (
        sole_use(tmp_path, "another backup", "wait"),
        pytest.raises(ConflictError, match=f"^another backup is at work in {tmp_path}; wait$"),
        sole_use(tmp_path, "another backup", "wait"),
    ):
        pass


def test_different_works_share_a_folder(tmp_path):
    with sole_use(tmp_path, "a demo", "wait"), sole_use(tmp_path, "a campaign", "wait", ".other"):
        assert {p.name for p in tmp_path.iterdir()} == {LOCK, ".other"}
    assert list(tmp_path.iterdir()) == []


def test_the_lock_that_a_killed_process_left_keeps_nobody_out(tmp_path):
    (tmp_path / LOCK).touch()
    with sole_use(tmp_path, "another backup", "wait"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_is_removed_while_one_asks_for_it_is_asked_for_again(tmp_path, monkeypatch):
    """Its holder ends between the opening of the file and its locking: a lock of a file that is gone is none."""
    flock, times = fcntl.flock, []

    def after_its_holder_ended(*arguments):
        times.append(arguments)
        if len(times) == 1:
            (tmp_path / LOCK).unlink()
        flock(*arguments)

    monkeypatch.setattr(fcntl, "flock", after_its_holder_ended)
    with (
        sole_use(tmp_path, "another backup", "wait"),
        pytest.raises(ConflictError),
        sole_use(tmp_path, "another backup", "wait"),
    ):
        pass
    assert len(times) == 3


def test_a_file_system_without_locks_keeps_nobody_out(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    with sole_use(tmp_path, "another backup", "wait"):
        assert (tmp_path / LOCK).exists()
