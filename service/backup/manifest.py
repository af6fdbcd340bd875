"""What a backup holds, and the proof that it is whole."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from hashlib import file_digest
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from service.errors import DocumentError, StorageError
from service.output import first_problem, json_text, read_document, write_text

FORMAT = "amb-backup"
NAME = "manifest.json"
STORE = "store"
NAMES = "store.json"
"""SHA-256 of every file of the common store that this backup needs."""


@dataclass(frozen=True)
class Manifest:
    """The first thing to read of a backup, and the last to be written: without it a backup is no backup."""

    created: str
    """ISO 8601, UTC."""
    product: str
    """Version of the product that made it."""
    engine: str
    """Version of the job engine."""
    database: str
    """sqlite or postgresql."""
    jobs_database: str
    """The same of the job engine's tables; empty where there were none yet."""
    revision: str
    """Of our own tables."""
    rows: dict[str, int]
    """Rows of our own tables."""
    files: dict[str, str]
    """SHA-256 of every file of the backup, the store's left out: they are named by theirs."""
    blobs: int
    """Files of the store."""
    blob_bytes: int
    missing: tuple[str, ...]
    """SHA-256 of files that the tables name and the store had not, or not whole; names of controllers' files that could
    not be read."""


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


def write(folder: Path, manifest: Manifest) -> None:
    """Finish a backup."""
    document: dict[str, Any] = {"format": FORMAT, "version": 1} | asdict(manifest)
    write_text(folder / NAME, json_text(document))


def read(folder: Path) -> Manifest:
    """Manifest of a backup whose files are as they were written.

    Raises
    ------
    DocumentError
        There is no manifest, or one of another version.
    StorageError
        A file of the backup is missing or was changed.
    """
    document = read_document(folder / NAME, FORMAT)
    try:
        manifest: Manifest = TypeAdapter(Manifest).validate_python(document)
    except ValidationError as error:
        raise DocumentError(f"{folder / NAME} {first_problem(error)}; take another backup") from error
    for name, sha256 in manifest.files.items():
        path = folder / name
        if not path.is_file() or digest(path) != sha256:
            raise StorageError(f"{path} is missing or damaged; take another backup")
    return manifest


def sidecar(path: Path, content: Any) -> None:
    """A small JSON file of a backup."""
    path.write_text(json.dumps(content), encoding="utf-8")
