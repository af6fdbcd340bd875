"""Which installation a command works on: the options of everything that needs no API, and what they mean."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[Path | None, typer.Option(help="Settings of the service, TOML; else AMBIT_CONFIG.")]
Home = Annotated[Path | None, typer.Option(help="Folder of databases, store and work in progress; else AMBIT_HOME.")]
