"""Folders of results: proven to be writable, and left as they were where they are not."""

import errno
import os
import threading
from pathlib import Path

import pytest

from service.errors import OutputError
from service.output import ready_folder, results_in, write_text


def test_a_full_disk_is_told_and_nothing_is_left_on_it(tmp_path, monkeypatch):
    def half(self: Path, _: bytes) -> None:
        self.touch()  # the name needs no space, what is written does
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(OutputError, match="No space left on device"):
        ready_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_can_be_written_holds_nothing_new(tmp_path):
    assert ready_folder(tmp_path / "new" / "one") == tmp_path / "new" / "one"
    assert list((tmp_path / "new" / "one").iterdir()) == []


def test_what_a_link_leads_to_is_written_and_the_link_stays(tmp_path: Path) -> None:
    target, link = tmp_path / "real.toml", tmp_path / "link.toml"
    target.write_text("old")
    link.symlink_to(target)
    assert write_text(link, "new") == link
    assert (link.is_symlink(), target.read_text()) == (True, "new")


def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", list[str]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    write_text(pipe, "text")
    reader.join(10)
    assert read == ["text"]
    assert pipe.is_fifo()


def test_a_folder_in_which_nothing_came_to_lie_goes_again_and_what_is_in_one_stays(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), results_in(tmp_path / "a" / "b"):
        _ = 1 // 0
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ZeroDivisionError), results_in(tmp_path / "a" / "b"):
        (tmp_path / "a" / "kept").write_text("")
        _ = 1 // 0
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["kept"]
    with pytest.raises(ZeroDivisionError), results_in(tmp_path / "a"):
        (tmp_path / "a" / "kept").unlink()
        _ = 1 // 0
    assert (tmp_path / "a").exists(), "it was there before"
