"""The files that controllers' URLs name, maps, certificates and their keys: small, in the home, and in no database."""

from __future__ import annotations

import os
from pathlib import Path

from service.backup import manifest
from service.config import CONTROLLERS
from service.errors import ConflictError
from service.private import private_file, private_folder

NAME = Path(CONTROLLERS)


def copy(source: Path, part: Path) -> list[str]:
    """Copy the folder into a backup; names of files in it that cannot be read."""
    unread = []
    for path in _files(source):
        name = NAME / path.relative_to(source)
        try:
            content = path.read_bytes()
        except OSError:
            unread.append(str(name))
            continue
        _make_folders(part, name)
        _write(part / name, content)
    return unread


def must_fit(backup: Path, home: Path) -> None:
    """Refuse a backup whose files are others than those that lie in the home under the same names.

    Raises
    ------
    ConflictError
        One is; nothing was changed.
    """
    for path in _files(backup / NAME):
        to = home / path.relative_to(backup)
        if to.exists() and not _same(path, to):
            raise ConflictError(f"{to} is another file than the backup's; --replace gives it up")


def put_back(backup: Path, home: Path) -> None:
    """Put a backup's files into the home, for the service's user alone; others that lie there stay."""
    for path in _files(backup / NAME):
        name = path.relative_to(backup)
        to = home / name
        if not _same(path, to):
            _make_folders(home, name)
            temporary = to.with_name(f".{to.name}.part")
            temporary.unlink(missing_ok=True)
            _write(temporary, path.read_bytes())
            temporary.replace(to)


def _files(folder: Path) -> list[Path]:
    """Files of a folder; what a link in it leads to elsewhere is no file that a controller's URL may name."""
    inside = folder.resolve()
    return sorted(p for p in folder.rglob("*") if p.is_file() and p.resolve().is_relative_to(inside))


def _same(path: Path, to: Path) -> bool:
    return to.is_file() and manifest.digest(to) == manifest.digest(path)


def _make_folders(root: Path, name: Path) -> None:
    for parent in reversed(name.parents):
        private_folder(root / parent)


def _write(path: Path, content: bytes) -> None:
    with open(path, "wb", opener=private_file) as out:
        out.write(content)
        out.flush()
        os.fsync(out.fileno())
