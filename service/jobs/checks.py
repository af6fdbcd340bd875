"""Steps of a health check: a short experiment, and its comparison with the rig's baseline."""

from __future__ import annotations

import json
from datetime import timedelta
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.campaign.aims import Profile
from service.health import budget
from service.jobs import calculations, campaigns
from service.jobs.context import Context
from service.jobs.control import Control
from service.jobs.progress import COMPARING_CHECK, MEASURING_CHECK, PLANNING_CHECK, Part
from service.jobs.steps import datasheet_file, experiment_file
from service.storage import results
from service.storage.ids import derived_id
from service.storage.tables import HealthRow, JobRow, ModelRow

YEAR = timedelta(days=365)


def _baseline(worker: Context, job: JobRow) -> tuple[ModelRow, str]:
    """The model to compare with, and its result.json as a file."""
    with worker.database.read() as session:
        model = results.get(session, ModelRow, job.options["baseline"])
    path = worker.folder(job.id) / "baseline.json"
    if not path.exists():
        worker.blobs.fetch(model.result_sha256, path)
    return model, str(path)


def measure(worker: Context, job: JobRow, control: Control) -> dict[str, Any]:
    """Plan a few tones by what they tell, and measure them; ``{"experiment": id}``."""
    _, baseline = _baseline(worker, job)
    _, rig = datasheet_file(worker, job)
    Part(control, PLANNING_CHECK).tell("planning", 0.0)
    arguments = {"baseline": baseline, "rig": str(rig), "budget_s": job.options.get("budget_s", budget.USUAL_S)}
    found = worker.calculator.run("health_plan", arguments, control.stopped)
    profile = Profile(**{**found, "frequencies_hz": tuple(found["frequencies_hz"])})
    return campaigns.measure(worker, job, control, profile, MEASURING_CHECK, budget.RECENT_S)


def compare(worker: Context, job: JobRow, control: Control, experiment_id: str) -> dict[str, Any]:
    """Compare the short experiment with the baseline; ``{"experiment": id, "health": id}``."""
    model, baseline = _baseline(worker, job)
    _, rig = datasheet_file(worker, job)
    experiment, path = experiment_file(worker, job, experiment_id)
    part = Part(control, COMPARING_CHECK)
    part.tell("comparison", 0.0)
    out = worker.folder(job.id) / "health"
    out.mkdir(exist_ok=True)
    history = out / "history.jsonl"
    with worker.database.read() as session:
        earlier = _earlier(session, job, experiment.created_at - YEAR)
    history.write_text("".join(json.dumps(document) + "\n" for document in earlier), encoding="utf-8")
    arguments = {
        "baseline": baseline,
        "rig": str(rig),
        "experiment": str(path),
        "out": str(out),
        "history": str(history),
        "at": experiment.created_at.isoformat(),
        "false_alarms_per_year": job.options.get("false_alarms_per_year"),
    }
    document = worker.calculator.run("health_compare", arguments, control.stopped, part.tell)
    row = HealthRow(
        id=derived_id("hc", job.id),
        rig_id=job.rig_id,
        rig_version=job.rig_version,
        experiment_id=experiment_id,
        model_id=model.id,
        schedule_id=job.schedule_id,
        job_id=job.id,
        document=document,
        report_sha256=worker.blobs.put_file(out / calculations.HEALTH_REPORT),
        alarm=bool(document["alarm"]),
        created_at=experiment.created_at,
    )
    worker.database.surely(lambda session: results.keep(session, row))
    return {"experiment": experiment_id, "health": row.id}


def _earlier(session: Session, job: JobRow, since: Any) -> list[dict[str, Any]]:
    """Documents of the rig's checks of the last year, oldest first, this one's own left out."""
    query = (
        select(HealthRow.document)
        .where(HealthRow.rig_id == job.rig_id, HealthRow.job_id != job.id, HealthRow.created_at >= since)
        .order_by(HealthRow.created_at, HealthRow.id)
    )
    return list(session.scalars(query))
