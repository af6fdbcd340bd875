"""Settings of the service: a TOML file, environment variables over it, flags over both."""

from __future__ import annotations

import os
import shlex
import socket
import tomllib
from collections.abc import Mapping
from ipaddress import ip_network
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from service.access.loopback import is_loopback
from service.errors import ConfigurationError
from sim.errors import reason

PREFIX = "AMBIT_"
FILE_VARIABLE = "AMBIT_CONFIG"
MOST_CPU_JOBS = 64
CONTROLLERS = "controllers"


def _default_home() -> Path:
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "ambit"


class Settings(BaseModel):
    """Everything that an installation may decide. Each field is also an environment variable, ``AMBIT_<FIELD>``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    home: Path = Field(default_factory=_default_home)
    """Folder of the SQLite databases, the default store and the work in progress."""
    database_url: str = ""
    """Our own tables: empty for SQLite in ``home``, or postgresql://user:password@host/name."""
    jobs_database_url: str = ""
    """Tables of the job engine: empty for SQLite in ``home``, or the PostgreSQL of ``database_url``."""
    store_url: str = ""
    """Where files are kept: any fsspec URL; empty for a folder in ``home``."""

    host: str = "127.0.0.1"
    port: int = Field(8311, ge=0, le=65535)
    tls_certificate: Path | None = None
    """PEM; with ``tls_key`` the API speaks HTTPS."""
    tls_key: Path | None = None
    behind_proxy: bool = False
    """Believe X-Forwarded-For and X-Forwarded-Proto of the proxy in front. Needs an API key: by its proxy every caller
    may seem to be of this machine."""
    trusted_proxies: str = "127.0.0.1"
    """Addresses and networks of the proxies themselves, separated by commas; nobody else is believed."""

    public_url: str = ""
    """Address at which people reach the service, https://host/path; the links of webhooks begin with it. Empty for
    links that are paths only."""
    webhook_loopback: bool | None = None
    """Whether webhooks may lead to this machine itself, as to a receiver beside the service: whoever may make a
    schedule then reaches all that listens here. None: where only this machine reaches the service. Private networks
    are always possible, link-local addresses never."""

    worker_name: str = Field("", max_length=60)
    """Stable and unique per worker; empty for the host's name."""
    cpu_jobs: int = Field(1, ge=1, le=MOST_CPU_JOBS)
    """Identifications and diagnoses that one worker calculates at a time. The engine keeps one number for all workers
    of a database: that of the worker that started last."""
    worker_timeout_s: float = Field(30.0, gt=1.0)
    """A worker that was silent for so long has lost its jobs to the others."""
    lease_s: float = Field(10.0, ge=1.0, le=60.0)
    """Time for which a controller stays leased to a job whose worker went silent."""
    controller_patience_s: float = Field(60.0, ge=0.0)
    """How long a job waits for a controller that does not answer before it fails."""

    max_body_bytes: int = Field(1_000_000, ge=1000)
    max_upload_bytes: int = Field(256_000_000, ge=1000)
    upload_memory_bytes: int = Field(2_000_000_000, ge=100_000_000)
    """Memory of the process that reads an upload."""
    upload_seconds: float = Field(20.0, gt=0)
    """Time that reading an upload may take."""
    requests_per_s: float = Field(500.0, gt=0)
    """Sustained rate that one key may ask for."""
    requests_burst: int = Field(1000, ge=1)

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["console", "json"] = "console"
    otlp_endpoint: str = ""
    """Where OpenTelemetry traces go; empty for none."""

    @field_validator("database_url", "jobs_database_url")
    @classmethod
    def _known_database(cls, url: str) -> str:
        if url and urlsplit(url).scheme not in ("sqlite", "postgresql"):
            raise ValueError("is neither sqlite:////folder/file.db nor postgresql://user:password@host/name")
        return url

    @field_validator("public_url")
    @classmethod
    def _address(cls, url: str) -> str:
        parts = urlsplit(url)
        if url and (parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment):
            raise ValueError(f"{url!r} is no address of a service; give https://host, or https://host/path")
        return url.rstrip("/")

    @field_validator("trusted_proxies")
    @classmethod
    def _addresses(cls, proxies: str) -> str:
        for one in proxies.split(","):
            try:
                ip_network(one.strip())
            except ValueError as error:
                raise ValueError(f"{one.strip()!r} is no address or network; give 10.0.0.2 or 10.0.0.0/30") from error
        return proxies

    @property
    def webhooks_to_itself(self) -> bool:
        """Whether webhooks may lead to this machine: as set, or where nobody else than this machine asks for them."""
        if self.webhook_loopback is not None:
            return self.webhook_loopback
        reached = self.behind_proxy or self.public_url or self.database.startswith("postgresql")
        return is_loopback(self.host) and not reached

    @property
    def database(self) -> str:
        """URL of our own tables."""
        return self.database_url or f"sqlite:///{self.home.absolute() / 'ambit.db'}"

    @property
    def jobs_database(self) -> str:
        """URL of the job engine's tables."""
        if self.jobs_database_url:
            return self.jobs_database_url
        if self.database_url.startswith("postgresql"):
            return self.database_url
        return f"sqlite:///{self.home.absolute() / 'jobs.db'}"

    def link(self, path: str) -> str:
        """Where people find something of the API."""
        return f"{self.public_url}/api/v1{path}"

    def here(self, command: str) -> str:
        """A command that works on our own tables, with ``--home`` where it would find other ones without."""
        if self.database_url or self.home == _default_home():
            return command
        return f"{command} --home {shlex.quote(str(self.home))}"

    @property
    def store(self) -> str:
        """fsspec URL of the store."""
        return self.store_url or str(self.home.absolute() / "store")

    @property
    def store_of_this_machine(self) -> bool:
        """Whether another machine on the same database would keep its files elsewhere: nobody has said where."""
        return self.database_url.startswith("postgresql") and not self.store_url

    @property
    def work(self) -> Path:
        """Folder of the work in progress of this machine."""
        return self.home.absolute() / "work"

    @property
    def controllers(self) -> Path:
        """Folder of the files that a controller's URL may name: maps, certificates, keys, simulated rigs."""
        return self.home.absolute() / CONTROLLERS

    @property
    def worker(self) -> str:
        """Name of this machine's worker."""
        return self.worker_name or socket.gethostname()[:60] or "worker"


def load(
    file: Path | None = None, environment: Mapping[str, str] | None = None, flags: Mapping[str, Any] | None = None
) -> Settings:
    """Settings from a TOML file, the environment, and flags that are not None; the later wins.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a value is unknown or out of range; names it and where it came from.
    """
    environment = os.environ if environment is None else environment
    if file is None and environment.get(FILE_VARIABLE):
        file = Path(environment[FILE_VARIABLE])
    values: dict[str, Any] = {} if file is None else _from_file(file)
    origin = dict.fromkeys(values, str(file))
    for name in Settings.model_fields:
        variable = PREFIX + name.upper()
        if variable in environment:
            values[name], origin[name] = environment[variable], variable
    for name, value in (flags or {}).items():
        if value is not None:
            values[name], origin[name] = value, f"--{name.replace('_', '-')}"
    try:
        return Settings(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0]) if first["loc"] else ""
        reason = "there is no such setting" if first["type"] == "extra_forbidden" else first["msg"]
        raise ConfigurationError(f"{origin.get(name, 'settings')}: {name}: {reason}") from error


def _from_file(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(f"cannot read the settings {file}: {reason(error)}; give a TOML file") from error
