"""Files by their content: named by SHA-256, in a folder or behind any fsspec URL.

A file appears whole or not at all, is never changed, and is the same file when it is put twice.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import threading
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from service.errors import NotFoundError, StorageError

CHUNK = 1 << 20
_CACHED_BYTES = 64 << 20
_LARGEST_CACHED = 8 << 20


class Blobs:
    """The store.

    Parameters
    ----------
    url
        Folder or fsspec URL, such as ``s3://bucket/ambit``.

    Raises
    ------
    StorageError
        The URL is unknown, or its library is not installed.
    """

    def __init__(self, url: str) -> None:
        try:
            self._fs, self._root = url_to_fs(url)
        except (ValueError, ImportError) as error:
            remedy = "; pip install 'amb-commissioning[s3]'" if url.startswith("s3:") else ""
            raise StorageError(f"cannot use the store {url}: {error}{remedy}") from error
        self._local = isinstance(self._fs, LocalFileSystem)
        self._cache: OrderedDict[str, bytes] = OrderedDict()
        self._cached_bytes = 0
        self._lock = threading.Lock()

    def _path(self, sha256: str) -> str:
        return f"{self._root}/{sha256[:2]}/{sha256}"

    def put_file(self, path: Path) -> str:
        """Keep a file; its SHA-256."""
        digest = hashlib.sha256()
        with path.open("rb") as source:
            while chunk := source.read(CHUNK):
                digest.update(chunk)
        sha256 = digest.hexdigest()
        self._keep(sha256, lambda target: _copy(path, target))
        return sha256

    def put(self, content: bytes) -> str:
        """Keep bytes; their SHA-256."""
        sha256 = hashlib.sha256(content).hexdigest()
        self._keep(sha256, lambda target: target.write(content))
        return sha256

    def _keep(self, sha256: str, write: Any) -> None:
        target = self._path(sha256)
        temporary = f"{self._root}/incoming/{sha256}.{secrets.token_hex(4)}"
        try:
            if self._fs.exists(target):
                return
            self._fs.makedirs(temporary.rpartition("/")[0], exist_ok=True)
            self._fs.makedirs(target.rpartition("/")[0], exist_ok=True)
            with self._fs.open(temporary, "wb") as file:
                write(file)
                if self._local:
                    file.flush()
                    os.fsync(file.fileno())
            self._fs.mv(temporary, target)
        except OSError as error:
            raise StorageError(f"cannot write to the store: {error}; free space, or check its address") from error

    def names(self) -> Iterator[str]:
        """SHA-256 of everything in the store."""
        try:
            for path in self._fs.find(self._root):
                folder, _, name = str(path).rpartition("/")
                if len(name) == 64 and folder.endswith(f"/{name[:2]}"):
                    yield name
        except FileNotFoundError:
            return

    def has(self, sha256: str) -> bool:
        """Whether the content is there."""
        return bool(self._fs.exists(self._path(sha256)))

    def size(self, sha256: str) -> int:
        """Bytes of a content."""
        try:
            return int(self._fs.size(self._path(sha256)))
        except FileNotFoundError as error:
            raise _missing(sha256) from error

    def at_hand(self, sha256: str) -> bytes | None:
        """A content that is in memory; None for another one, and nothing waits."""
        with self._lock:
            if (found := self._cache.get(sha256)) is not None:
                self._cache.move_to_end(sha256)
            return found

    def read(self, sha256: str) -> bytes:
        """A content, whole. What is read often is kept in memory.

        Raises
        ------
        NotFoundError
            It is not there.
        """
        if (found := self.at_hand(sha256)) is not None:
            return found
        try:
            content: bytes = self._fs.cat_file(self._path(sha256))
        except FileNotFoundError as error:
            raise _missing(sha256) from error
        except OSError as error:
            raise StorageError(f"cannot read from the store: {error}") from error
        self._remember(sha256, content)
        return content

    def _remember(self, sha256: str, content: bytes) -> None:
        if len(content) > _LARGEST_CACHED:
            return
        with self._lock:
            if sha256 not in self._cache:
                self._cache[sha256] = content
                self._cached_bytes += len(content)
            while self._cached_bytes > _CACHED_BYTES:
                _, dropped = self._cache.popitem(last=False)
                self._cached_bytes -= len(dropped)

    def chunks(self, sha256: str) -> Iterator[bytes]:
        """A content in pieces, for what is large.

        Raises
        ------
        NotFoundError
            It is not there.
        """
        try:
            with self._fs.open(self._path(sha256), "rb") as file:
                while chunk := file.read(CHUNK):
                    yield chunk
        except FileNotFoundError as error:
            raise _missing(sha256) from error

    def fetch(self, sha256: str, to: Path) -> Path:
        """Copy a content into a file of this machine."""
        temporary = to.with_name(f".{to.name}.{secrets.token_hex(4)}")
        to.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as target:
            for chunk in self.chunks(sha256):
                target.write(chunk)
        os.replace(temporary, to)
        return to

    def check(self) -> None:
        """Raise `StorageError` when the store does not answer."""
        try:
            self._fs.makedirs(self._root, exist_ok=True)
            self._fs.ls(self._root, refresh=True) if not self._local else self._fs.exists(self._root)
        except Exception as error:  # whatever a remote file system raises
            raise StorageError(f"the store does not answer: {error}") from error


def _copy(path: Path, target: BinaryIO) -> None:
    with path.open("rb") as source:
        shutil.copyfileobj(source, target, CHUNK)


def _missing(sha256: str) -> NotFoundError:
    return NotFoundError(f"the file {sha256} is not in the store; restore it from the backup")
