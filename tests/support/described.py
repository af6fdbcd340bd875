"""A service that has one of everything, and schemathesis, which asks it whatever its description allows and forbids."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from service.client import Client
from service.experiment import file
from service.jobs import calculations
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import GapRow, HealthRow, JobRow, ModelRow, ScheduleRow, ScheduleRunRow
from sim.rig_file import to_toml
from tests.support.measured import small_experiment
from tests.support.processes import ENVIRONMENT, ROOT
from tests.support.serving import Serving

CHECKS = (
    "not_a_server_error,status_code_conformance,content_type_conformance,response_headers_conformance,"
    "response_schema_conformance"
)
UNLIMITED: dict[str, Any] = {"port": 0, "requests_per_s": 1e6, "requests_burst": 1_000_000}


def filled(service: Serving, key: str, home: Path) -> dict[str, str]:
    """One of everything; their ids by the names of path parameters."""
    experiment, datasheet = small_experiment("x")
    sheet = home / "rig.toml"
    sheet.write_text(to_toml(datasheet))
    file.write(home / "experiment.h5", experiment)
    with Client(service.url, key) as client:
        rig = client.rigs.create(sheet.read_text(), "simulated://")
        sent = client.experiments.upload(rig.id, home / "experiment.h5")
        jobs = [client.jobs.submit("identification", rig.id, sent.id).id for _ in range(2)]
    (home / "out").mkdir()
    summary = calculations.identification(str(home / "experiment.h5"), str(sheet), str(home / "out"), "experiment.h5")
    result, short = home / "out" / "result.json", (home / "short")
    short.mkdir()
    (home / "history.jsonl").write_text("")
    checked = calculations.health_compare(
        *map(str, (result, sheet, home / "experiment.h5", short, home / "history.jsonl")), now().isoformat()
    )
    blobs = service.services.blobs
    kept = {name: blobs.put_file(home / "out" / name) for name in ("result.json", "report.html", "plots.json")}
    page, document = blobs.put(b"<!doctype html><title>x</title>"), blobs.put(b'{"format": "amb-gap-report"}')
    ids = {name: new_id(prefix) for name, prefix in (("model", "mod"), ("gap", "gap"), ("health", "hc"), ("s", "sch"))}
    common = {"rig_id": rig.id, "rig_version": 1, "experiment_id": sent.id, "created_at": now()}
    with service.services.database.write() as session:
        session.get(JobRow, jobs[0]).state = "done"  # the events of one that waits do not end
        session.add(
            ModelRow(
                id=ids["model"], **common, result_sha256=kept["result.json"], report_sha256=kept["report.html"],
                plots_sha256=kept["plots.json"], summary=summary, created_by="x",
            )
        )  # fmt: skip
        session.add(
            GapRow(id=ids["gap"], **common, gap_sha256=document, report_sha256=page, summary={}, created_by="x")
        )
        session.add(
            ScheduleRow(
                id=ids["s"], rig_id=rig.id, cron="0 6 * * *", options={}, enabled=True, created_at=now(),
                updated_at=now(), created_by="x", next_at=now() + timedelta(days=1),
            )
        )  # fmt: skip
        session.flush()
        session.add(ScheduleRunRow(schedule_id=ids["s"], due_at=now(), state="missed", recorded_at=now()))
        session.add(
            HealthRow(
                id=ids["health"], **common, model_id=ids["model"], document=checked,
                alarm=False, report_sha256=page,
            )
        )  # fmt: skip
    return {
        "rig_id": rig.id,
        "experiment_id": sent.id,
        "job_id": jobs[0],
        "other_job": jobs[1],
        "model_id": ids["model"],
        "gap_id": ids["gap"],
        "health_id": ids["health"],
        "schedule_id": ids["s"],
    }


@dataclass(frozen=True)
class Tried:
    """What schemathesis found."""

    passed: bool
    operations: int
    requests: int
    whole: bool
    """Whether every operation of the description was tried."""
    said: str


def tried(
    service: Serving, key: str, ids: dict[str, str], folder: Path, examples: int, timeout_s: float, *which: str
) -> Tried:
    """Every operation, or which of them: examples, borders, and so many random requests, right and wrong ones."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "schemathesis.cli", "run", f"{service.url}/openapi.json"),
            *("--checks", CHECKS, "--phases", "examples,coverage,fuzzing", "--max-examples", str(examples)),
            *("--header", f"Authorization: Bearer {key}", "--request-timeout", "60", "--generation-deterministic"),
            *("--no-shrink", "--continue-on-failure", "--suppress-health-check", "all", "--warnings", "off"),
            *("--no-color", "--output-truncate", "true", *which),
        ],
        env=ENVIRONMENT
        | {"SCHEMATHESIS_HOOKS": "tests.support.api_hooks", "AMBIT_TEST_IDS": json.dumps(ids), "PYTHONPATH": str(ROOT)},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    said = done.stdout[-20_000:] + done.stderr[-2000:]
    counted = re.search(r"Selected: (\d+)/(\d+)\n\s*Tested: \1\n", done.stdout)
    asked = re.search(r"(\d+) generated", done.stdout)
    operations = 0 if counted is None else int(counted[1])
    return Tried(
        done.returncode == 0 and operations > 0,
        operations,
        0 if asked is None else int(asked[1]),
        counted is not None and counted[1] == counted[2],
        said,
    )
