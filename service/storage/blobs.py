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
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

from service.errors import NotFoundError, StorageError
from service.storage.remote import answering, opened

CHUNK = 1 << 20
INCOMING = "incoming"
"""Folder of files that are being written."""
_CACHED_BYTES = 64 << 20
_LARGEST_CACHED = 8 << 20
_BUCKET = "make the bucket, or correct store_url"


class Blobs:
    """The store.

    Parameters
    ----------
    url
        Folder or fsspec URL, such as ``s3://bucket/ambit``, see `service.storage.remote`.

    Raises
    ------
    StorageError
        The URL is unknown, or its library is not installed.
    """

    def __init__(self, url: str) -> None:
        self._fs, self._root, self._local = opened(url)
        self._has_folders = not url.startswith("s3:")
        self._cache: OrderedDict[str, bytes] = OrderedDict()
        self._cached_bytes = 0
        self._lock = threading.Lock()

    def _path(self, sha256: str) -> str:
        return f"{self._root}/{sha256[:2]}/{sha256}"

    def put_file(self, path: Path, repair: bool = False) -> str:
        """Keep a file; its SHA-256. With ``repair``, one that is there and damaged is replaced."""
        digest = hashlib.sha256()
        with path.open("rb") as source:
            while chunk := source.read(CHUNK):
                digest.update(chunk)
        sha256 = digest.hexdigest()
        if repair and self.has(sha256) and not self._is_whole(sha256):
            with answering("repair a file of", self._local):
                self._fs.rm(self._path(sha256))
        self._keep(sha256, lambda target: _copy(path, target))
        return sha256

    def _is_whole(self, sha256: str) -> bool:
        digest = hashlib.sha256()
        for piece in self._pieces(sha256):
            digest.update(piece)
        return digest.hexdigest() == sha256

    def put(self, content: bytes) -> str:
        """Keep bytes; their SHA-256."""
        sha256 = hashlib.sha256(content).hexdigest()
        self._keep(sha256, lambda target: target.write(content))
        return sha256

    def _keep(self, sha256: str, write: Any) -> None:
        target = self._path(sha256)
        temporary = f"{self._root}/{INCOMING}/{sha256}.{secrets.token_hex(4)}"
        with answering("write to", self._local):
            if self._fs.exists(target):
                return
            for path in (temporary, target):
                self._make_folder(path.rpartition("/")[0])
            try:
                with self._fs.open(temporary, "wb") as file:
                    write(file)
                    if self._local:
                        file.flush()
                        os.fsync(file.fileno())
                self._fs.mv(temporary, target)
            except FileNotFoundError as error:
                raise StorageError(f"cannot write to the store: {self._root} is not there; {_BUCKET}") from error
            except Exception:
                if self._local:  # a disk that is full must not stay full of what did not fit
                    with suppress(OSError):
                        self._fs.rm(temporary)
                raise

    def tidy(self, after: timedelta) -> None:
        """Remove what writers left that were killed: parts so old that nobody writes them any more."""
        with answering("tidy", self._local):
            try:
                found = self._fs.find(f"{self._root}/{INCOMING}")
            except FileNotFoundError:
                return
            for path in found:
                with suppress(FileNotFoundError):  # it has just got its name, or another worker tidies, too
                    if datetime.now(UTC) - self._fs.modified(path) > after:
                        self._fs.rm(path)

    def _make_folder(self, path: str) -> None:
        """Where there are folders. A bucket is never made: a misspelt one would be."""
        if self._has_folders:
            self._fs.makedirs(path, exist_ok=True)

    def names(self) -> Iterator[str]:
        """SHA-256 of everything in the store."""
        with answering("list", self._local):
            try:
                found = self._fs.find(self._root)
            except FileNotFoundError:
                return
        for path in found:
            folder, _, name = str(path).rpartition("/")
            if len(name) == 64 and folder.endswith(f"/{name[:2]}"):
                yield name

    def has(self, sha256: str) -> bool:
        """Whether the content is there."""
        with answering("look into", self._local):
            return bool(self._fs.exists(self._path(sha256)))

    def size(self, sha256: str) -> int:
        """Bytes of a content."""
        try:
            with answering("look into", self._local):
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
        StorageError
            It is damaged, or the store does not answer.
        """
        if (found := self.at_hand(sha256)) is not None:
            return found
        try:
            with answering("read from", self._local):
                content: bytes = self._fs.cat_file(self._path(sha256))
        except FileNotFoundError as error:
            raise _missing(sha256) from error
        if hashlib.sha256(content).hexdigest() != sha256:
            raise _damaged(sha256)
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
        StorageError
            It is damaged, which is known at its end, before the last piece; or the store does not answer.
        """
        digest, held = hashlib.sha256(), b""
        for piece in self._pieces(sha256):
            digest.update(piece)
            if held:
                yield held
            held = piece
        if digest.hexdigest() != sha256:
            raise _damaged(sha256)
        if held:
            yield held

    def _pieces(self, sha256: str) -> Iterator[bytes]:
        try:
            with answering("read from", self._local):
                file = self._fs.open(self._path(sha256), "rb")
            with file:
                while chunk := self._piece(file):
                    yield chunk
        except FileNotFoundError as error:
            raise _missing(sha256) from error

    def _piece(self, file: BinaryIO) -> bytes:
        with answering("read from", self._local):
            return file.read(CHUNK)

    def fetch(self, sha256: str, to: Path) -> Path:
        """Copy a content into a file of this machine; `StorageError` when it is not what its name says."""
        temporary = to.with_name(f".{to.name}.{secrets.token_hex(4)}")
        to.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("wb") as target:
                for chunk in self.chunks(sha256):
                    target.write(chunk)
            os.replace(temporary, to)
        finally:
            temporary.unlink(missing_ok=True)
        return to

    def check(self) -> None:
        """Raise `StorageError` when the store does not answer."""
        with answering("use", self._local):
            if self._has_folders:
                self._fs.makedirs(self._root, exist_ok=True)
                self._fs.exists(self._root) if self._local else self._fs.ls(self._root, refresh=True)
                return
            bucket = self._root.partition("/")[0]
            try:
                self._fs.call_s3("head_bucket", Bucket=bucket)
            except FileNotFoundError as error:
                raise StorageError(f"cannot use the store: there is no bucket {bucket}; {_BUCKET}") from error


def _copy(path: Path, target: BinaryIO) -> None:
    with path.open("rb") as source:
        shutil.copyfileobj(source, target, CHUNK)


def _damaged(sha256: str) -> StorageError:
    return StorageError(f"the file {sha256} of the store is damaged; restore it from the backup")


def _missing(sha256: str) -> NotFoundError:
    return NotFoundError(f"the file {sha256} is not in the store; restore it from the backup")
