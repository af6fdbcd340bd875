"""Folders of results: proven to be writable, and left as they were where they are not."""

import errno
import os
from pathlib import Path

import pytest

from service.errors import OutputError
from service.output import ready_folder


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
