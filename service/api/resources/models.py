"""Models: what identification found, as documents, curves and a report; and how a rig's figures changed over time."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import ConfigDict

from service.api import etags
from service.api.access import KeyFirst
from service.api.lists import NEWEST, Asked, Listed, OfRig, asked_by_making
from service.api.resources import example_documents as documents
from service.api.resources import examples
from service.api.shapes import (
    IfNoneMatch,
    ModelId,
    RigId,
    Shape,
    Time,
    Viewer,
)
from service.api.state import Api, KeptModel, Services
from service.errors import NotFoundError
from service.storage import results, rigs
from service.storage.blobs import Blobs
from service.storage.tables import ModelRow

router = APIRouter(prefix="/api/v1", tags=["models"], route_class=KeyFirst)

AskedOfModels = Annotated[Asked[str], asked_by_making("mod")]


class ModelShape(Shape):
    """A model; its whole content is in result.json."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.MODEL,
                    "rig": examples.RIG,
                    "rig_version": 2,
                    "experiment": examples.EXPERIMENT,
                    "job": examples.JOB,
                    "summary": {
                        "planes": {
                            "x": {
                                "stiffness": {"kiA": {"value": 181.0, "std": 0.02, "unit": "N/A", "nominal": 340.0}},
                                "iso_14839_3_zone": "A",
                            }
                        }
                    },
                    "created_at": examples.TIME,
                    "created_by": "lab bench",
                    "links": {"result": f"/api/v1/models/{examples.MODEL}/result.json"},
                }
            ]
        }
    )

    id: str
    rig: str
    rig_version: int
    experiment: str
    job: str | None
    summary: dict[str, Any]
    """The result in a sentence with its tone, good, warn or bad; stiffness, modes, fits and margins, plane by plane."""
    created_at: Time
    created_by: str
    links: dict[str, str]


class HistoryEntry(Shape):
    """Figures of one model."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "model": examples.MODEL,
                    "experiment": examples.EXPERIMENT,
                    "created_at": examples.TIME,
                    "planes": {"x": {"kiA": {"value": 181.0, "std": 0.02, "unit": "N/A", "nominal": 340.0}}},
                },
            ]
        }
    )

    model: str
    experiment: str
    created_at: Time
    planes: dict[str, Any]


def shape(row: ModelRow) -> ModelShape:
    """A model as it is sent."""
    address = f"/api/v1/models/{row.id}"
    return ModelShape(
        id=row.id,
        rig=row.rig_id,
        rig_version=row.rig_version,
        experiment=row.experiment_id,
        job=row.job_id,
        summary=row.summary,
        created_at=row.created_at,
        created_by=row.created_by,
        links={
            "result": f"{address}/result.json",
            "report": f"{address}/report.html",
            "curves": f"{address}/curves.json",
            "frequency_response": f"{address}/frequency-response",
            "nyquist": f"{address}/nyquist",
            "step": f"{address}/step",
            "state_space": f"{address}/state-space",
            **_exports(row, address),
        },
    )


def _exports(row: ModelRow, address: str) -> dict[str, str]:
    """Files for other tools, plane by plane: the state space, and the response that was measured."""
    measured = f"/api/v1/experiments/{row.experiment_id}/export/responses"
    return {
        name: where
        for plane in row.summary["planes"]
        for name, where in (
            (f"state_space_{plane}_mat", f"{address}/export/state-space?plane={plane}&format=mat"),
            (f"responses_{plane}_mat", f"{measured}?plane={plane}&format=mat"),
            (f"responses_{plane}_uff", f"{measured}?plane={plane}&format=uff"),
        )
    }


@router.get("/models", response_model=Listed[ModelShape], responses=etags.documented_list())
def list_models(
    who: Viewer,
    api: Api,
    asked: AskedOfModels,
    rig: OfRig = None,
    newest: Annotated[bool, Query(description=NEWEST)] = False,
) -> Response:
    """All models, newest first."""
    with api.database.read() as session:
        page = results.listed(session, ModelRow, rig, asked.after, asked.limit, newest)
    return asked.answer(Listed[ModelShape], page, shape)


@router.get("/models/{model_id}", response_model=ModelShape, responses=etags.documented_resource())
async def get_model(model_id: ModelId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """A model's figures, and where the rest of it is."""
    model = await _kept(api, model_id)
    return etags.content_response(model.document, etags.JSON, model.tag, if_none_match)


@router.get(
    "/models/{model_id}/result.json",
    response_class=Response,
    responses=etags.documented_json("The result, amb-commissioning-result", documents.RESULT),
)
async def get_result(model_id: ModelId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """The whole result of the identification."""
    row = (await _kept(api, model_id)).row
    return await _stored(api.blobs, row.result_sha256, etags.JSON, if_none_match)


@router.get(
    "/models/{model_id}/report.html",
    response_class=Response,
    responses=etags.documented_page(),
)
async def get_report(model_id: ModelId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """The report, one page that needs nothing else."""
    row = (await _kept(api, model_id)).row
    return await _stored(api.blobs, row.report_sha256, etags.HTML, if_none_match)


@router.get(
    "/models/{model_id}/curves.json",
    response_class=Response,
    responses=etags.documented_json("All curves, amb-model-curves", documents.CURVES),
)
async def get_curves(model_id: ModelId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """Frequency response, Nyquist and step of every plane, for plotting."""
    row = (await _kept(api, model_id)).row
    return await _stored(api.blobs, row.plots_sha256, etags.JSON, if_none_match)


async def _stored(blobs: Blobs, digest: str, media_type: str, if_none_match: str | None) -> Response:
    """A file of the store: at once when it is in memory, else in a thread."""
    if blobs.at_hand(digest) is not None:
        return etags.stored(blobs, digest, media_type, if_none_match)
    return await run_in_threadpool(etags.stored, blobs, digest, media_type, if_none_match)


async def _kept(api: Services, model_id: str) -> KeptModel:
    def read() -> KeptModel:
        row = _row(api, model_id)
        document = shape(row).model_dump_json().encode()
        return KeptModel(row, document, etags.of_content(document))

    return await api.models.get(model_id, read)


def _row(api: Services, model_id: str) -> ModelRow:
    with api.database.read() as session:
        return results.get(session, ModelRow, model_id)


Plane = Annotated[str | None, Query(description="Only this plane.", pattern="^[xy]$")]


def _curve(api: Api, model_id: str, name: str, plane: str | None, if_none_match: str | None) -> Response:
    row = _row(api, model_id)
    planes = json.loads(api.blobs.read(row.plots_sha256))["planes"]
    wanted = [p for p in planes if plane in (None, p)]
    if not wanted:
        raise NotFoundError(f"the model {model_id} has no plane {plane!r}; it has {', '.join(planes)}")
    body = {p: {"axes": planes[p]["axes"], **planes[p][name]} for p in wanted}
    return etags.document(body, if_none_match, f"{row.plots_sha256[:24]}.{name}.{plane or ''}")


@router.get(
    "/models/{model_id}/frequency-response",
    response_model=dict[str, Any],
    responses=etags.documented_json("Response by plane", documents.BODE),
)
def get_frequency_response(
    model_id: ModelId, who: Viewer, api: Api, plane: Plane = None, if_none_match: IfNoneMatch = None
) -> Response:
    """Measured and modelled response from u to y (m/A), real and imaginary parts, by plane: a Bode plot."""
    return _curve(api, model_id, "frequency_response", plane, if_none_match)


@router.get(
    "/models/{model_id}/nyquist",
    response_model=dict[str, Any],
    responses=etags.documented_json("Loop by plane", documents.NYQUIST),
)
def get_nyquist(
    model_id: ModelId, who: Viewer, api: Api, plane: Plane = None, if_none_match: IfNoneMatch = None
) -> Response:
    """The loop of each axis with the others closed, by plane: a Nyquist plot."""
    return _curve(api, model_id, "nyquist", plane, if_none_match)


@router.get(
    "/models/{model_id}/step",
    response_model=dict[str, Any],
    responses=etags.documented_json("Step response by plane", documents.STEP),
)
def get_step(
    model_id: ModelId, who: Viewer, api: Api, plane: Plane = None, if_none_match: IfNoneMatch = None
) -> Response:
    """Displacement (m) of the closed loop after 1 A more on r, by plane: a step plot."""
    return _curve(api, model_id, "step", plane, if_none_match)


@router.get(
    "/models/{model_id}/state-space",
    response_model=dict[str, Any],
    responses=etags.documented_json("Matrices by plane", documents.STATE_SPACE),
)
def get_state_space(model_id: ModelId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """Plant and amplifiers in state space, continuous time, modal form, by plane."""
    row = _row(api, model_id)
    planes = json.loads(api.blobs.read(row.result_sha256))["planes"]
    body = {p: {"plant": d["state_space"], "amplifiers": d["amplifier_state_space"]} for p, d in planes.items()}
    return etags.document(body, if_none_match, f"{row.result_sha256[:24]}.ss")


def _history(api: Api, rig_id: str, asked: Asked[str], name: str) -> Response:
    with api.database.read() as session:
        rigs.get(session, rig_id)
        page = results.listed(session, ModelRow, rig_id, asked.after, asked.limit)

    def entry(row: ModelRow) -> HistoryEntry:
        return HistoryEntry(
            model=row.id,
            experiment=row.experiment_id,
            created_at=row.created_at,
            planes={p: values[name] for p, values in row.summary["planes"].items()},
        )

    return asked.answer(Listed[HistoryEntry], page, entry)


@router.get("/rigs/{rig_id}/stiffness", response_model=Listed[HistoryEntry], responses=etags.documented_list(404))
def stiffness_history(rig_id: RigId, who: Viewer, api: Api, asked: AskedOfModels) -> Response:
    """ki (N/A) and ks (N/m) of a rig's bearings with their standard deviations, newest model first."""
    return _history(api, rig_id, asked, "stiffness")


@router.get("/rigs/{rig_id}/modes", response_model=Listed[HistoryEntry], responses=etags.documented_list(404))
def mode_history(rig_id: RigId, who: Viewer, api: Api, asked: AskedOfModels) -> Response:
    """Natural frequencies (rad/s) and damping ratios of a rig's rotor, newest model first."""
    return _history(api, rig_id, asked, "modes")
