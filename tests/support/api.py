"""What tests of the API share: a rig that has been commissioned, and what a refusal looks like."""

from __future__ import annotations

import httpx

from service.storage.database import now
from service.storage.tables import ExperimentRow, ModelRow
from tests.support.serving import Serving


def commissioned(service: Serving, rig: str, result: bytes | None = None) -> str:
    """The experiment of a rig that has been commissioned, with this result.json where it is read."""
    with service.services.database.write() as session:
        row = ExperimentRow(
            id=rig.replace("rig_", "exp_"), rig_id=rig, rig_version=1, source="measured", purpose="commissioning",
            complete=True, file_sha256="0" * 64, file_bytes=1, media_type="application/x-hdf5", file_name="e.h5",
            summary={}, created_at=now(), created_by="test",
        )  # fmt: skip
        session.add(row)
        session.flush()
        session.add(
            ModelRow(
                id=rig.replace("rig_", "mod_"), rig_id=rig, rig_version=1, experiment_id=row.id,
                result_sha256="0" * 64 if result is None else service.services.blobs.put(result),
                report_sha256="0" * 64, plots_sha256="0" * 64,
                summary={"planes": {"x": {"stiffness": {"kiA": {"value": 181.0}}, "modes": []}}},
                created_at=now(), created_by="test",
            )
        )  # fmt: skip
    return row.id


def assert_problem(answer: httpx.Response, status: int, *words: str) -> None:
    """An RFC 9457 problem of that status, whose detail has the words."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["request_id"] == answer.headers["x-request-id"]
    for word in words:
        assert word in body["detail"]
