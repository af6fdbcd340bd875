"""Steps that calculate: identification and gap diagnosis of an experiment."""

from __future__ import annotations

import os
from typing import Any

from service.jobs import calculations
from service.jobs.context import Context
from service.jobs.control import Control
from service.jobs.progress import IDENTIFYING, WHOLE, Part
from service.jobs.steps import datasheet_file, experiment_file
from service.storage import results
from service.storage.database import now
from service.storage.ids import derived_id
from service.storage.tables import GapRow, JobRow, ModelRow


def identify(worker: Context, job: JobRow, control: Control, experiment_id: str) -> dict[str, Any]:
    """Identify an experiment; ``{"experiment": id, "model": id}``."""
    row, path = experiment_file(worker, job, experiment_id)
    _, rig = datasheet_file(worker, job)
    part = Part(control, WHOLE if job.kind == "identification" else IDENTIFYING)
    part.tell("identification", 0.0)
    out = worker.folder(job.id) / "model"
    arguments = {
        "experiment": str(path),
        "rig": str(rig),
        "out": str(out),
        "name": f"{experiment_id}/{row.file_name}",
        "priors": bool(job.options.get("priors", False)),
    }
    summary = worker.calculator.run("identification", arguments, control.stopped, part.tell)
    kept = {
        name: worker.blobs.put_file(out / name)
        for name in (calculations.RESULT, calculations.REPORT, calculations.PLOTS)
    }
    model = ModelRow(
        id=derived_id("mod", job.id),
        rig_id=job.rig_id,
        rig_version=job.rig_version,
        experiment_id=experiment_id,
        job_id=job.id,
        result_sha256=kept[calculations.RESULT],
        report_sha256=kept[calculations.REPORT],
        plots_sha256=kept[calculations.PLOTS],
        summary=summary,
        created_at=now(),
        created_by=job.submitted_by,
    )
    worker.database.surely(lambda session: results.keep(session, model))
    return {"experiment": experiment_id, "model": model.id}


def diagnose(worker: Context, job: JobRow, control: Control, experiment_id: str) -> dict[str, Any]:
    """Diagnose the gap of an experiment; ``{"experiment": id, "gap": id}``."""
    _, path = experiment_file(worker, job, experiment_id)
    _, rig = datasheet_file(worker, job)
    part = Part(control)
    part.tell("gap diagnosis", 0.0)
    out = worker.folder(job.id) / "gap"
    arguments = {"experiment": str(path), "rig": str(rig), "out": str(out), "processes": _processes(worker)}
    summary = worker.calculator.run("gap", arguments, control.stopped, part.tell)
    gap = GapRow(
        id=derived_id("gap", job.id),
        rig_id=job.rig_id,
        rig_version=job.rig_version,
        experiment_id=experiment_id,
        job_id=job.id,
        gap_sha256=worker.blobs.put_file(out / calculations.GAP),
        report_sha256=worker.blobs.put_file(out / calculations.GAP_REPORT),
        summary=summary,
        created_at=now(),
        created_by=job.submitted_by,
    )
    worker.database.surely(lambda session: results.keep(session, gap))
    return {"experiment": experiment_id, "gap": gap.id}


def _processes(worker: Context) -> int:
    """Processes of one diagnosis: the cores that this worker may use, shared by those that it calculates at a time."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, cores // worker.settings.cpu_jobs)
