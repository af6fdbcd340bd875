"""Experiments: measured by a job, or uploaded."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import ConfigDict
from sqlalchemy.orm import Session

from service.access.audit import Action
from service.access.keys import Identity
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.lists import Asked, Listed, OfRig, asked_by_making
from service.api.once import Answer, once
from service.api.problems import MediaTypeError, TooLargeError, UnprocessableError, documented
from service.api.resources import examples
from service.api.shapes import (
    ExperimentId,
    IdempotencyKey,
    IfNoneMatch,
    Operator,
    RigId,
    Shape,
    Time,
    Viewer,
)
from service.api.state import Api, Services
from service.private import private_folder
from service.remarks import can_be_shown
from service.storage import results, rigs
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow
from service.uploads import Limits, Parsed, UploadContentError, UploadError, parse
from sim import rig_file
from sim.datasheet import Datasheet

router = APIRouter(prefix="/api/v1", tags=["experiments"], route_class=KeyFirst)

Purpose = Literal["commissioning", "health"]
HDF5 = "application/x-hdf5"
TYPES = {HDF5: ".h5", "application/x-matlab-data": ".mat", "application/octet-stream": ".h5"}


class ExperimentShape(Shape):
    """An experiment."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.EXPERIMENT,
                    "rig": examples.RIG,
                    "rig_version": 2,
                    "job": examples.JOB,
                    "source": "measured",
                    "purpose": "commissioning",
                    "complete": True,
                    "file_name": "experiment.h5",
                    "file_bytes": 710116,
                    "file_sha256": "3b1f" * 16,
                    "summary": {"axes": ["xA", "xB", "yA", "yB"], "sweeps": []},
                    "created_at": examples.TIME,
                    "created_by": "lab bench",
                }
            ]
        }
    )

    id: str
    rig: str
    rig_version: int
    job: str | None
    source: str
    """measured or uploaded."""
    purpose: str
    """commissioning or health."""
    complete: bool
    """False for what a stopped campaign kept, an uploaded file of one, too."""
    file_name: str
    file_bytes: int
    file_sha256: str
    summary: dict[str, Any]
    created_at: Time
    created_by: str


def shape(row: ExperimentRow) -> ExperimentShape:
    """An experiment as it is sent."""
    return ExperimentShape(
        id=row.id,
        rig=row.rig_id,
        rig_version=row.rig_version,
        job=row.job_id,
        source=row.source,
        purpose=row.purpose,
        complete=row.complete,
        file_name=row.file_name,
        file_bytes=row.file_bytes,
        file_sha256=row.file_sha256,
        summary=row.summary,
        created_at=row.created_at,
        created_by=row.created_by,
    )


_UPLOAD = {
    "requestBody": {
        "required": True,
        "description": "An experiment file, HDF5 or MATLAB (v5 or v7.3), as `docs/experiment-file.md` describes it.",
        "content": {name: {"schema": {"type": "string", "format": "binary"}} for name in TYPES},
    }
}


@router.post(
    "/rigs/{rig_id}/experiments",
    status_code=201,
    response_model=ExperimentShape,
    responses=documented(404, 409, 413, 415),
    openapi_extra=_UPLOAD,
)
async def upload_experiment(
    request: Request,
    rig_id: RigId,
    who: Operator,
    api: Api,
    filename: Annotated[
        str, Query(max_length=200, pattern=r"^[^/\\\x00-\x1f]+$", description="Name of the file.")
    ] = "experiment.h5",
    idempotency_key: IdempotencyKey = None,
) -> Response:
    """Upload an experiment file. It is read in a process of its own, and kept as what was understood of it."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type not in TYPES:
        raise MediaTypeError(f"the body is {media_type or 'of no type'}; send one of {', '.join(TYPES)}")
    if not all(map(can_be_shown, filename)):
        raise UnprocessableError("the name of the file has a character that a terminal would obey; rename it")
    with tempfile.TemporaryDirectory(prefix="upload-", dir=_incoming(api)) as folder:
        received, sent = await _received(request, Path(folder) / f"received{TYPES[media_type]}", api)
        name = filename if Path(filename).suffix else filename + TYPES[media_type]
        answer, replayed = await to_thread.run_sync(
            _keep, request, rig_id, who, api, received, sent, name, idempotency_key
        )
    return answer.response(replayed)


def _incoming(api: Services) -> Path:
    return private_folder(api.settings.work / "uploads")


async def _received(request: Request, path: Path, api: Services) -> tuple[Path, str]:
    """The file, and the SHA-256 of what was sent."""
    size = 0
    digest = sha256()
    with path.open("wb") as file:
        async for chunk in request.stream():
            size += len(chunk)
            if size > api.settings.max_upload_bytes:
                raise TooLargeError(f"the file is larger than {api.settings.max_upload_bytes:,} bytes")
            digest.update(chunk)
            file.write(chunk)
    return path, digest.hexdigest()


def _keep(
    request: Request, rig_id: str, who: Identity, api: Services, received: Path, sent: str, name: str, key: str | None
) -> tuple[Answer, bool]:
    with api.database.read() as session:
        rigs.active(session, rig_id)
        datasheet = _datasheet_of(session, rig_id)
    try:
        parsed = parse(received, name, received.with_name("understood.h5"), _limits(api), datasheet)
        _must_have(list(datasheet.axes), parsed)
    except UploadError as error:
        with api.database.write() as session:
            audit(session, request, who, Action.upload_refused, rig_id, rig=rig_id, reason=str(error)[:500])
        raise
    kept = api.blobs.put_file(parsed.file, repair=True)  # sent again, perhaps, because the store's is damaged

    def make(session: Session) -> Answer:
        row = _row(session, rig_id, who.name, parsed, kept, name)
        audit(session, request, who, Action.experiment_uploaded, row.id, rig=rig_id, sha256=kept)
        return Answer(201, f"/api/v1/experiments/{row.id}", shape(row).model_dump(mode="json"))

    return once(api.database, who, request, key, f"{name}\n{sent}", make)


def _datasheet_of(session: Session, rig_id: str) -> Datasheet:
    """The newest datasheet of a rig."""
    return rig_file.parse(rigs.version(session, rigs.get(session, rig_id)).datasheet)


def _must_have(axes: list[str], parsed: Parsed) -> None:
    # every job on the file would fail for it, long after whoever sent it has gone
    if parsed.summary["axes"] != axes:
        raise UploadContentError(
            f"the file has axes {', '.join(parsed.summary['axes'])} and the rig {', '.join(axes)}; "
            "send it to the rig that was measured, or first give the rig a datasheet with these axes"
        )


def _limits(api: Services) -> Limits:
    s = api.settings
    return Limits(file_bytes=s.max_upload_bytes, memory_bytes=s.upload_memory_bytes, wall_s=s.upload_seconds)


def _row(session: Session, rig_id: str, by: str, parsed: Parsed, kept: str, name: str) -> ExperimentRow:
    row = ExperimentRow(
        id=new_id("exp"),
        rig_id=rig_id,
        rig_version=rigs.get(session, rig_id).version,
        source="uploaded",
        purpose="commissioning",
        complete=parsed.summary["incomplete"] is None,
        file_sha256=kept,
        file_bytes=parsed.file.stat().st_size,
        media_type=HDF5,
        file_name=Path(name).stem + ".h5",
        summary=parsed.summary,
        created_at=now(),
        created_by=by,
    )
    session.add(row)
    session.flush()
    return row


@router.get("/experiments", response_model=Listed[ExperimentShape], responses=etags.documented_list())
def list_experiments(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_by_making("exp")],
    rig: OfRig = None,
    purpose: Annotated[Purpose | None, Query(description="Only commissionings, or only health checks.")] = None,
    complete: Annotated[bool | None, Query(description="Only whole ones, or only what stopped campaigns kept.")] = None,
) -> Response:
    """All experiments, newest first."""
    with api.database.read() as session:
        page = results.listed(session, ExperimentRow, rig, asked.after, asked.limit, purpose=purpose, complete=complete)
    return asked.answer(Listed[ExperimentShape], page, shape)


@router.get(
    "/experiments/{experiment_id}",
    response_model=ExperimentShape,
    responses=etags.documented_resource(),
)
def get_experiment(experiment_id: ExperimentId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """An experiment."""
    with api.database.read() as session:
        row = results.get(session, ExperimentRow, experiment_id)
    return etags.document(shape(row), if_none_match)


@router.get(
    "/experiments/{experiment_id}/file",
    response_class=Response,
    responses=etags.documented_resource({HDF5: {"schema": {"type": "string", "format": "binary"}}}, "The file, HDF5"),
)
def get_experiment_file(
    experiment_id: ExperimentId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None
) -> Response:
    """The file of an experiment."""
    with api.database.read() as session:
        row = results.get(session, ExperimentRow, experiment_id)
    headers = {"ETag": etags.quoted(row.file_sha256), "Cache-Control": etags.REVALIDATE}
    if etags.matches(if_none_match, row.file_sha256):
        return Response(status_code=304, headers=headers)
    content: Iterator[bytes] = api.blobs.chunks(row.file_sha256)
    first = next(content, b"")  # a file that is gone, or a small one that is damaged, is told before the answer begins
    headers |= {
        "Content-Disposition": 'attachment; filename="experiment.h5"',
        "Content-Length": str(api.blobs.size(row.file_sha256)),
    }
    return StreamingResponse(chain([first], content), 200, headers, media_type=row.media_type)
