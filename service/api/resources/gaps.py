"""Gap diagnoses: where the twin departs from the rig, and which effect explains it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import ConfigDict

from service.api import etags
from service.api.access import KeyFirst
from service.api.lists import NEWEST, Asked, Listed, OfRig, asked_by_making
from service.api.resources import example_documents, examples
from service.api.shapes import GapId, IfNoneMatch, Shape, Time, Viewer
from service.api.state import Api
from service.storage import results
from service.storage.tables import GapRow

router = APIRouter(prefix="/api/v1/gaps", tags=["gaps"], route_class=KeyFirst)


class GapShape(Shape):
    """A gap diagnosis; its whole content is in gap.json."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.GAP,
                    "rig": examples.RIG,
                    "rig_version": 2,
                    "experiment": examples.EXPERIMENT,
                    "job": examples.JOB,
                    "summary": {"verdict": "effect", "effects": ["loop_delay"], "probability": 0.97},
                    "created_at": examples.TIME,
                    "created_by": "lab bench",
                    "links": {"gap": f"/api/v1/gaps/{examples.GAP}/gap.json"},
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
    created_at: Time
    created_by: str
    links: dict[str, str]


def shape(row: GapRow) -> GapShape:
    """A diagnosis as it is sent."""
    return GapShape(
        id=row.id,
        rig=row.rig_id,
        rig_version=row.rig_version,
        experiment=row.experiment_id,
        job=row.job_id,
        summary=row.summary,
        created_at=row.created_at,
        created_by=row.created_by,
        links={
            name: f"/api/v1/gaps/{row.id}/{file}" for name, file in (("gap", "gap.json"), ("report", "report.html"))
        },
    )


@router.get("", response_model=Listed[GapShape], responses=etags.documented_list())
def list_gaps(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_by_making("gap")],
    rig: OfRig = None,
    newest: Annotated[bool, Query(description=NEWEST)] = False,
) -> Response:
    """All diagnoses, newest first."""
    with api.database.read() as session:
        page = results.listed(session, GapRow, rig, asked.after, asked.limit, newest)
    return asked.answer(Listed[GapShape], page, shape)


@router.get("/{gap_id}", response_model=GapShape, responses=etags.documented_resource())
def get_gap(gap_id: GapId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """A diagnosis in short."""
    return etags.document(shape(_row(api, gap_id)), if_none_match)


@router.get(
    "/{gap_id}/gap.json",
    response_class=Response,
    responses=etags.documented_json("The diagnosis, amb-gap-report", example_documents.GAP),
)
def get_gap_document(gap_id: GapId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """The whole diagnosis."""
    row = _row(api, gap_id)
    return etags.stored(api.blobs, row.gap_sha256, etags.JSON, if_none_match)


@router.get(
    "/{gap_id}/report.html",
    response_class=Response,
    responses=etags.documented_page(),
)
def get_gap_report(gap_id: GapId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """The report of a diagnosis, one page that needs nothing else."""
    row = _row(api, gap_id)
    return etags.stored(api.blobs, row.report_sha256, etags.HTML, if_none_match)


def _row(api: Api, gap_id: str) -> GapRow:
    with api.database.read() as session:
        return results.get(session, GapRow, gap_id)
