"""Tables of the service, the same on SQLite and PostgreSQL.

What is large (experiments, results, reports) is in the store; a row has its SHA-256.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, ClassVar

from sqlalchemy import (
    JSON,
    Boolean,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    String,
    Text,
    true,
)
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeDecorator

Document = dict[str, Any]


class UtcDateTime(TypeDecorator[datetime]):
    """A point in time, UTC, whatever the database thinks of time zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To the database."""
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """From the database; SQLite forgets the zone."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Base of every table."""

    type_annotation_map: ClassVar = {
        datetime: UtcDateTime,
        Document: JSON().with_variant(JSONB(), "postgresql"),
        list[Any]: JSON().with_variant(JSONB(), "postgresql"),
    }


ID = String(40)
NAME = String(200)


def _id() -> Mapped[str]:
    return mapped_column(ID, primary_key=True)


def _listed(table: str) -> tuple[Index, ...]:
    """Indices of a table whose pages are in the order in which its rows were made, of one rig or of all."""
    made = ("created_at", "id")
    return (
        Index(f"ix_{table}_created_at_id", *made),
        Index(f"ix_{table}_rig_id_created_at_id", "rig_id", *made),
    )


def _reference(to: str, nullable: bool = False, index: bool = True) -> Mapped[Any]:
    return mapped_column(ID, ForeignKey(to), nullable=nullable, index=index)


class Rig(Base):
    """A rig; what may change is in its versions."""

    __tablename__ = "rigs"

    id: Mapped[str] = _id()
    name: Mapped[str] = mapped_column(NAME, unique=True)
    version: Mapped[int] = mapped_column(Integer)
    """Newest version."""
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    retired_at: Mapped[datetime | None]
    """A retired rig takes no jobs; its history stays."""
    baseline_model_id: Mapped[str | None] = mapped_column(ID)
    """What health checks compare with; None for the newest model of a whole commissioning."""


class RigVersion(Base):
    """A datasheet and where the controller is, as they were from one time to the next."""

    __tablename__ = "rig_versions"

    rig_id: Mapped[str] = mapped_column(ID, ForeignKey("rigs.id"), primary_key=True)
    version: Mapped[int] = mapped_column(Integer, primary_key=True)
    datasheet: Mapped[str] = mapped_column(Text)
    """rig.toml as it was given."""
    controller_url: Mapped[str] = mapped_column(Text, default="")
    note: Mapped[str] = mapped_column(Text, default="")
    created_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME)


class ExperimentRow(Base):
    """An experiment file, measured or uploaded."""

    __tablename__ = "experiments"
    __table_args__ = _listed(__tablename__)

    id: Mapped[str] = _id()
    rig_id: Mapped[str] = _reference("rigs.id", index=False)
    rig_version: Mapped[int] = mapped_column(Integer)
    job_id: Mapped[str | None] = mapped_column(ID, index=True)
    source: Mapped[str] = mapped_column(String(20))
    """measured or uploaded."""
    purpose: Mapped[str] = mapped_column(String(20), default="commissioning")
    """commissioning or health."""
    complete: Mapped[bool] = mapped_column(Boolean)
    """False for what a stopped campaign kept."""
    file_sha256: Mapped[str] = mapped_column(String(64))
    file_bytes: Mapped[int] = mapped_column(Integer)
    media_type: Mapped[str] = mapped_column(String(80))
    file_name: Mapped[str] = mapped_column(NAME)
    summary: Mapped[Document]
    created_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME)


class ModelRow(Base):
    """An identified model."""

    __tablename__ = "models"
    __table_args__ = _listed(__tablename__)

    id: Mapped[str] = _id()
    rig_id: Mapped[str] = _reference("rigs.id", index=False)
    rig_version: Mapped[int] = mapped_column(Integer)
    experiment_id: Mapped[str] = _reference("experiments.id")
    job_id: Mapped[str | None] = mapped_column(ID, index=True)
    result_sha256: Mapped[str] = mapped_column(String(64))
    report_sha256: Mapped[str] = mapped_column(String(64))
    plots_sha256: Mapped[str] = mapped_column(String(64))
    summary: Mapped[Document]
    """Stiffness, modes and fits by plane: what lists and histories show."""
    created_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME)


class GapRow(Base):
    """A gap diagnosis."""

    __tablename__ = "gaps"
    __table_args__ = _listed(__tablename__)

    id: Mapped[str] = _id()
    rig_id: Mapped[str] = _reference("rigs.id", index=False)
    rig_version: Mapped[int] = mapped_column(Integer)
    experiment_id: Mapped[str] = _reference("experiments.id")
    job_id: Mapped[str | None] = mapped_column(ID, index=True)
    gap_sha256: Mapped[str] = mapped_column(String(64))
    report_sha256: Mapped[str] = mapped_column(String(64))
    summary: Mapped[Document]
    created_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME)


class HealthRow(Base):
    """A health check: a short experiment compared with the baseline model."""

    __tablename__ = "health_checks"
    __table_args__ = _listed(__tablename__)

    id: Mapped[str] = _id()
    rig_id: Mapped[str] = _reference("rigs.id", index=False)
    rig_version: Mapped[int] = mapped_column(Integer)
    experiment_id: Mapped[str] = _reference("experiments.id")
    model_id: Mapped[str] = _reference("models.id")
    """The baseline."""
    schedule_id: Mapped[str | None] = mapped_column(ID, index=True)
    job_id: Mapped[str | None] = mapped_column(ID, index=True)
    document: Mapped[Document]
    report_sha256: Mapped[str] = mapped_column(String(64))
    alarm: Mapped[bool] = mapped_column(Boolean, index=True)
    created_at: Mapped[datetime]


class ScheduleRow(Base):
    """When a rig's health is checked, and who is told."""

    __tablename__ = "schedules"

    id: Mapped[str] = _id()
    rig_id: Mapped[str] = _reference("rigs.id")
    cron: Mapped[str] = mapped_column(String(100))
    timezone: Mapped[str] = mapped_column(String(60), default="UTC")
    options: Mapped[Document]
    """Options of the health jobs."""
    enabled: Mapped[bool] = mapped_column(Boolean)
    webhook_url: Mapped[str] = mapped_column(Text, default="")
    webhook_secret: Mapped[str] = mapped_column(Text, default="")
    webhook_on: Mapped[str] = mapped_column(String(10), default="alarm")
    """alarm or always."""
    next_at: Mapped[datetime | None] = mapped_column(UtcDateTime, index=True)
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME)
    deleted_at: Mapped[datetime | None]


class ScheduleRunRow(Base):
    """One time at which a schedule was due: run, or missed because the service was down."""

    __tablename__ = "schedule_runs"

    schedule_id: Mapped[str] = mapped_column(ID, ForeignKey("schedules.id"), primary_key=True)
    due_at: Mapped[datetime] = mapped_column(UtcDateTime, primary_key=True)
    state: Mapped[str] = mapped_column(String(20))
    """submitted, missed or refused."""
    detail: Mapped[str] = mapped_column(Text, default="")
    job_id: Mapped[str | None] = mapped_column(ID)
    recorded_at: Mapped[datetime]


class WebhookRow(Base):
    """A message to a webhook and what became of it."""

    __tablename__ = "webhook_deliveries"

    id: Mapped[str] = _id()
    schedule_id: Mapped[str] = _reference("schedules.id")
    health_id: Mapped[str] = mapped_column(ID, default="", index=True)
    """The check that it tells of; empty where there is none to tell of."""
    url: Mapped[str] = mapped_column(Text)
    contents: Mapped[Document] = mapped_column(default=dict, server_default="{}")
    """What is sent; empty in rows of an earlier version, which tell of their check."""
    next_at: Mapped[datetime | None] = mapped_column(UtcDateTime, index=True)
    """When the next attempt is due; None where there shall be none."""
    dispatched: Mapped[bool] = mapped_column(Boolean, default=False, server_default=true())
    """Whether the engine knows of the next attempt."""
    state: Mapped[str] = mapped_column(String(20))
    """pending, delivered or failed."""
    attempts: Mapped[int] = mapped_column(Integer, default=0)
    status_code: Mapped[int | None]
    detail: Mapped[str] = mapped_column(Text, default="")
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]


class JobRow(Base):
    """A job as its owner sees it; the engine that runs it has tables of its own."""

    __tablename__ = "jobs"
    __table_args__ = (Index("ix_jobs_state_id", "state", "id"), Index("ix_jobs_rig_id_id", "rig_id", "id"))

    id: Mapped[str] = _id()
    kind: Mapped[str] = mapped_column(String(20), index=True)
    rig_id: Mapped[str] = mapped_column(ID, ForeignKey("rigs.id"))
    rig_version: Mapped[int] = mapped_column(Integer)
    experiment_id: Mapped[str | None] = mapped_column(ID, index=True)
    """What shall be worked on; None where the job measures."""
    schedule_id: Mapped[str | None] = mapped_column(ID)
    options: Mapped[Document]
    priority: Mapped[int] = mapped_column(Integer)
    """1 first, 9 last."""
    state: Mapped[str] = mapped_column(String(20))
    submitted_by: Mapped[str] = mapped_column(NAME)
    requested_by: Mapped[str] = mapped_column(NAME, default="", server_default="")
    """Who had this run done, the first or a retry: whose doing it is that the rotor moves."""
    requested_key: Mapped[str] = mapped_column(ID, default="", server_default="")
    """Id of that key, "local", or "schedule:<id>"; empty where it was not noted yet."""
    created_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]

    run: Mapped[int] = mapped_column(Integer, default=1)
    """How often it was submitted: a retry is one more."""
    dispatched_run: Mapped[int] = mapped_column(Integer, default=0)
    """The run that the engine knows of."""
    attempt: Mapped[int] = mapped_column(Integer, default=0)
    """How often a worker has begun with it; only the last one may write."""
    worker: Mapped[str] = mapped_column(NAME, default="")
    cancel_requested: Mapped[bool] = mapped_column(Boolean, default=False)
    changes: Mapped[int] = mapped_column(Integer, default=0)
    """Counts the changes of this row."""

    percent: Mapped[float] = mapped_column(Float, default=0.0)
    point: Mapped[int] = mapped_column(Integer, default=0)
    points: Mapped[int] = mapped_column(Integer, default=0)
    phase: Mapped[str] = mapped_column(Text, default="")
    time_left_s: Mapped[float | None]

    result: Mapped[Document]
    error_title: Mapped[str] = mapped_column(Text, default="")
    error_detail: Mapped[str] = mapped_column(Text, default="")
    """Why it failed; of a job that is asked to end and still runs, why that is, if there is a reason."""


class JournalPart(Base):
    """A piece of a running campaign's journal, so that another machine can go on with it."""

    __tablename__ = "journal_parts"

    job_id: Mapped[str] = mapped_column(ID, ForeignKey("jobs.id"), primary_key=True)
    offset: Mapped[int] = mapped_column(Integer, primary_key=True)
    content: Mapped[bytes] = mapped_column(LargeBinary)


class WorkerRow(Base):
    """A worker and its last sign of life."""

    __tablename__ = "workers"

    name: Mapped[str] = mapped_column(NAME, primary_key=True)
    instance: Mapped[str] = mapped_column(ID)
    """Changes with every start."""
    machine: Mapped[str] = mapped_column(NAME)
    process: Mapped[int] = mapped_column(Integer)
    started_at: Mapped[datetime]
    beat_at: Mapped[datetime]
    stopped_at: Mapped[datetime | None]


class KeyRow(Base):
    """An API key; of its secret only a hash."""

    __tablename__ = "api_keys"

    id: Mapped[str] = _id()
    name: Mapped[str] = mapped_column(NAME)
    scope: Mapped[str] = mapped_column(String(20))
    secret_hash: Mapped[str] = mapped_column(String(200))
    created_at: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(NAME, default="")
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    used_at: Mapped[datetime | None]
    used_from: Mapped[str] = mapped_column(String(60), default="", server_default="")
    """Address of the last use: a key that is used from elsewhere is a key that was lost."""


class AuditRow(Base):
    """Who did what: nothing here is ever changed or removed."""

    __tablename__ = "audit"

    id: Mapped[str] = _id()
    at: Mapped[datetime]
    who: Mapped[str] = mapped_column(NAME)
    """Name of the key."""
    key_id: Mapped[str] = mapped_column(ID, default="")
    action: Mapped[str] = mapped_column(String(60), index=True)
    rig_id: Mapped[str | None] = mapped_column(ID, index=True)
    resource: Mapped[str] = mapped_column(String(80), default="")
    detail: Mapped[Document]
    request_id: Mapped[str] = mapped_column(String(80), default="")


class IdempotencyRow(Base):
    """The answer that a request with an Idempotency-Key got."""

    __tablename__ = "idempotency"

    owner: Mapped[str] = mapped_column(ID, primary_key=True)
    """Id of the API key."""
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    request_sha256: Mapped[str] = mapped_column(String(64))
    status: Mapped[int] = mapped_column(Integer)
    location: Mapped[str] = mapped_column(Text)
    body: Mapped[Document]
    created_at: Mapped[datetime] = mapped_column(UtcDateTime, index=True)
