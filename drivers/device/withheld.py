"""The files of a rig with something withheld: the sealed truth, and the datasheet of who has to find out."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from sim.errors import AmbError, reason
from sim.rig_file import to_toml
from sim.withheld.seal import seal

if TYPE_CHECKING:
    from sim.withheld.case import Case


def sealed_in(path: Path, case: Case) -> str:
    """Commitment to a case's truth, which is written to ``path`` and nowhere else; only its owner can read it.

    Raises
    ------
    AmbError
        The file cannot be written.
    """
    kept = seal(case.truth())
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="utf-8") as stream:
            os.fchmod(stream.fileno(), 0o600)  # a file that was there may have been anyone's to read
            stream.write(json.dumps(kept.document()) + "\n")
    except OSError as error:
        raise AmbError(f"cannot write the sealed file {path}: {reason(error)}; give another one") from error
    return kept.commitment


def datasheet_beside(path: Path, case: Case) -> Path:
    """Where the datasheet of a case was written: beside its sealed file, ``withheld.rig.toml`` for ``withheld.json``.

    Raises
    ------
    AmbError
        The file cannot be written.
    """
    written = path.with_suffix(".rig.toml")
    try:
        written.write_text(to_toml(case.datasheet), encoding="utf-8")
    except OSError as error:
        raise AmbError(f"cannot write the datasheet {written}: {reason(error)}; give another sealed file") from error
    return written
