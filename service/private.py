"""Files and folders of the service that nobody but its own user reads: addresses of rigs, secrets of webhooks, data.

What was made before, or by somebody else, keeps its mode: who may read it has been decided there.
"""

from __future__ import annotations

import os
from pathlib import Path

from service.config import Settings
from service.errors import StorageError

PRIVATE = 0o700
"""Mode of a folder."""


def private_folder(folder: Path) -> Path:
    """The folder; where it is made here, its owner alone enters it."""
    folder.mkdir(PRIVATE, parents=True, exist_ok=True)
    return folder


def private_file(path: str | Path, flags: int) -> int:
    """Descriptor of a file that its owner alone reads, where it is made here; the ``opener`` of `open`."""
    return os.open(path, flags, 0o600)


def make_folders(settings: Settings) -> None:
    """The service's own folders, where they are not there.

    Raises
    ------
    StorageError
        One cannot be made.
    """
    folders = [settings.home, settings.work] + ([] if settings.store_url else [Path(settings.store)])
    for folder in folders:
        try:
            private_folder(folder)
        except OSError as error:
            raise StorageError(
                f"cannot make the folder {folder}: {error.strerror}; choose another home with AMBIT_HOME"
            ) from error
