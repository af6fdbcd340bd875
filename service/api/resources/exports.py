"""Models and frequency responses as files of other tools."""

from __future__ import annotations

import json
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from service.api import etags
from service.api.access import KeyFirst
from service.api.problems import Documented
from service.api.resources import example_documents
from service.api.shapes import ExperimentId, IfNoneMatch, ModelId, Viewer
from service.api.state import Api, Services
from service.private import private_folder
from service.storage import results
from service.storage.tables import ExperimentRow, ModelRow

router = APIRouter(prefix="/api/v1", tags=["exports"], route_class=KeyFirst)

TYPES = {
    "json": "application/json",
    "csv": "text/csv; charset=utf-8",
    "mat": "application/x-matlab-data",
    "uff": "application/octet-stream",
}
_BINARY = {"schema": {"type": "string", "format": "binary"}}


def _documented(example: dict[str, Any], *formats: str) -> Documented:
    content = {TYPES[f].partition(";")[0]: ({"example": example} if f == "json" else _BINARY) for f in formats}
    return etags.documented_resource(content, "The file")


Plane = Annotated[Literal["x", "y"], Query(description="Plane of the rig.")]


@router.get(
    "/models/{model_id}/export/state-space",
    response_class=Response,
    responses=_documented(example_documents.LINEAR_FILE, "json", "csv", "mat"),
)
def export_state_space(
    model_id: ModelId,
    who: Viewer,
    api: Api,
    plane: Plane = "x",
    part: Annotated[
        Literal["plant", "amplifiers", "whole"],
        Query(description="Coil current to displacement, control to coil current, or one after the other."),
    ] = "plant",
    format: Annotated[Literal["json", "csv", "mat"], Query(description="Format of the file.")] = "mat",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """A plane's state space, continuous time, with the names and units of its signals."""
    from service.exports import files, linear  # what reads and writes files of other tools loads for a second

    with api.database.read() as session:
        row = results.get(session, ModelRow, model_id)
    model = linear.of_result(json.loads(api.blobs.read(row.result_sha256)), plane, part)
    name = f"{plane}-{part}.{format}"
    with tempfile.TemporaryDirectory(dir=_scratch(api)) as folder:
        content = files.write_linear(Path(folder) / name, model).read_bytes()
    tag = f"{row.result_sha256[:24]}.{name}"
    return etags.content_response(content, TYPES[format], tag, if_none_match, filename=name)


@router.get(
    "/experiments/{experiment_id}/export/responses",
    response_class=Response,
    responses=_documented(example_documents.RESPONSES_FILE, "json", "csv", "mat", "uff"),
)
def export_responses(
    experiment_id: ExperimentId,
    who: Viewer,
    api: Api,
    plane: Plane = "x",
    path: Annotated[
        Literal["u->y", "i->y", "u->i", "r->u", "r->y"], Query(description="From which signal to which.")
    ] = "u->y",
    format: Annotated[Literal["json", "csv", "mat", "uff"], Query(description="Format; uff is UFF-58.")] = "uff",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """A plane's measured frequency response with its standard deviation."""
    from service.experiment import file
    from service.exports import files, responses

    with api.database.read() as session:
        row = results.get(session, ExperimentRow, experiment_id)
    name = f"{plane}-{path.replace('->', '-to-')}.{format}"
    with tempfile.TemporaryDirectory(dir=_scratch(api)) as folder:
        measured = file.read(api.blobs.fetch(row.file_sha256, Path(folder) / "experiment.h5"))
        found = responses.of_experiment(measured, path, plane=plane)
        content = files.write_responses(Path(folder) / name, [found[plane]])[0].read_bytes()
    tag = f"{sha256(content).hexdigest()[:24]}.{name}".replace(">", "")
    return etags.content_response(content, TYPES[format], tag, if_none_match, filename=name)


def _scratch(api: Services) -> Path:
    return private_folder(api.settings.work / "exports")
