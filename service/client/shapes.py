"""What the service sends, typed. Fields that a newer service adds are kept and do no harm."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

T = TypeVar("T")
Kind = Literal["experiment", "identification", "gap", "health"]
ENDED = ("done", "failed", "cancelled")


class _Sent(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)


class Page(_Sent, Generic[T]):
    """A page of a list, newest first."""

    items: list[T]
    next: str | None = None


class Rig(_Sent):
    """A rig: its datasheet and where its controller is."""

    id: str
    name: str
    version: int
    datasheet: str = ""
    """rig.toml."""
    controller_url: str = ""
    retired_at: datetime | None = None
    baseline_model: str | None = None
    """What health checks compare with; None for the newest model of a whole commissioning."""


class Progress(_Sent):
    """How far a job is."""

    percent: float = 0.0
    point: int = 0
    points: int = 0
    phase: str = ""
    time_left_s: float | None = None


class Failure(_Sent):
    """Why a job failed."""

    title: str = ""
    detail: str = ""


class Job(_Sent):
    """A job."""

    id: str
    kind: str
    rig: str
    rig_version: int = 0
    state: str
    priority: int = 5
    submitted_by: str = ""
    experiment: str | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    created_at: datetime | None = None
    started_at: datetime | None = None
    ended_at: datetime | None = None
    worker: str = ""
    progress: Progress = Progress()
    result: dict[str, str] = Field(default_factory=dict)
    """Ids by kind: experiment, model, gap, health."""
    error: Failure | None = None

    @property
    def ended(self) -> bool:
        """Whether it is done, failed or cancelled."""
        return self.state in ENDED

    @property
    def why_cancelled(self) -> str:
        """Why it was cancelled, where it was not asked for by itself, as when its rig was stopped; empty otherwise."""
        return self.progress.phase.partition(": ")[2] if self.state == "cancelled" else ""


class Event(_Sent):
    """One event of a job that is watched."""

    kind: str
    """progress or state."""
    id: str
    job: Job


class Experiment(_Sent):
    """An experiment: the file is fetched by itself."""

    id: str
    rig: str
    job: str | None = None
    source: str = ""
    complete: bool = True
    file_name: str = ""
    file_bytes: int = 0
    file_sha256: str = ""
    summary: dict[str, Any] = Field(default_factory=dict)


class Model(_Sent):
    """A model in short; the whole of it is in result.json."""

    id: str
    rig: str
    rig_version: int = 0
    experiment: str = ""
    job: str | None = None
    summary: dict[str, Any] = Field(default_factory=dict)
    created_at: datetime | None = None
    links: dict[str, str] = Field(default_factory=dict)
    """Addresses of its documents and of its files for other tools."""


class Gap(_Sent):
    """A diagnosis of the gap in short; the whole of it is in gap.json."""

    id: str
    rig: str
    experiment: str = ""
    job: str | None = None
    summary: dict[str, Any] = Field(default_factory=dict)
    created_at: datetime | None = None


class HealthCheck(_Sent):
    """A health check in short; ``document`` only where one is read by itself."""

    id: str
    rig: str
    baseline_model: str = ""
    schedule: str | None = None
    job: str | None = None
    alarm: bool = False
    zone: str = ""
    zone_calm: bool = True
    drifted: list[str] = Field(default_factory=list)
    drifted_words: list[str] = Field(default_factory=list)
    """The same in words, each figure with its change."""
    sentence: str = ""
    created_at: datetime | None = None
    document: dict[str, Any] = Field(default_factory=dict)


class Webhook(_Sent):
    """Who is told of a check."""

    url: str
    on: str = "alarm"
    secret: str | None = None
    """Only in the answer that made it."""


class Schedule(_Sent):
    """When a rig's health is checked."""

    id: str
    rig: str
    cron: str
    timezone: str = "UTC"
    options: dict[str, Any] = Field(default_factory=dict)
    enabled: bool = True
    webhook: Webhook | None = None
    next_at: datetime | None = None
    updated_at: datetime | None = None


class Run(_Sent):
    """One time at which a check was due: submitted, missed or refused."""

    due_at: datetime
    state: str
    detail: str = ""
    job: str | None = None


class Delivery(_Sent):
    """A message to a schedule's webhook: pending, delivered or failed."""

    id: str
    health: str = ""
    url: str = ""
    state: str
    attempts: int = 0
    status_code: int | None = None
    detail: str = ""
    next_attempt_at: datetime | None = None
    created_at: datetime | None = None
    updated_at: datetime | None = None


class RigVersion(_Sent):
    """A rig as it was from one time to the next."""

    version: int
    datasheet: str = ""
    controller_url: str = ""
    note: str = ""
    created_at: datetime | None = None
    created_by: str = ""


class Status(_Sent):
    """A controller now; only the first ones where it does not answer."""

    reachable: bool
    detail: str = ""
    controller_url: str = ""
    identity: str | None = None
    state: str | None = None
    trip: str | None = None
    trip_message: str | None = None
    excitation_a: float | None = None
    displacement_m: list[float] | None = None
    current_a: list[float] | None = None
    lease_holder: str | None = None
    lease_seconds_left: float | None = None
    speed_rad_s: float | None = None
    uptime_s: float | None = None


class Acknowledged(_Sent):
    """A controller whose trip was to be cleared."""

    acknowledged: str | None
    """What it had tripped of; None where no trip was latched."""
    state: str


class Measured(_Sent):
    """A figure with its standard deviation, in the unit of its place."""

    value: float
    std: float | None = None
    unit: str = ""


class Stiffness(_Sent):
    """ki (N/A) and ks (N/m) of a rig, by plane and name, as one model has them."""

    model: str
    experiment: str = ""
    created_at: datetime | None = None
    planes: dict[str, dict[str, Measured]]


class Mode(_Sent):
    """A mode of the rotor."""

    natural_frequency_rad_s: Measured
    damping_ratio: Measured


class Modes(_Sent):
    """Modes of a rig's rotor by plane, ascending, as one model has them."""

    model: str
    experiment: str = ""
    created_at: datetime | None = None
    planes: dict[str, list[Mode]]


class Series(_Sent):
    """One monitored figure over the checks of a rig, oldest first."""

    at: list[datetime]
    change_percent: list[float]
    std_percent: list[float]
    baseline_std_percent: float
    drifted: list[bool]
    slope_percent_per_year: float | None = None
    slope_std_percent_per_year: float | None = None
    slope_significance: float | None = None
    drifting: bool = False


class Trend(_Sent):
    """Every monitored figure of a rig over its checks."""

    rig: str
    checks: list[str]
    series: dict[str, Series]
    next: str | None = None
    """``after`` of the checks before these."""


class StateSpace(_Sent):
    """Matrices of a continuous-time model."""

    A: list[list[float]]
    B: list[list[float]]
    C: list[list[float]]
    D: list[list[float]]


class PlaneStateSpace(_Sent):
    """A plane's plant and, where they were identified, its amplifiers."""

    plant: StateSpace
    amplifiers: StateSpace | None = None


class AuditLine(_Sent):
    """Who did what."""

    id: str
    at: datetime
    who: str
    key: str = ""
    action: str
    rig: str | None = None
    subject: str = ""
    detail: dict[str, Any] = Field(default_factory=dict)
    request_id: str = ""
