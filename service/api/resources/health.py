"""Health checks and their trend: what drifted against the commissioning."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import ConfigDict

from service.api import etags
from service.api.access import KeyFirst
from service.api.lists import Asked, Listed, OfRig, asked_by_making
from service.api.resources import examples
from service.api.shapes import HealthId, IfNoneMatch, RigId, Shape, Time, Viewer
from service.api.state import Api
from service.health.words import drifted_words
from service.health.zones import zone_is_calm
from service.storage import results, rigs
from service.storage.listing import LARGEST_PAGE
from service.storage.tables import HealthRow

router = APIRouter(prefix="/api/v1", tags=["health"], route_class=KeyFirst)


_SENTENCE = "compressor 3: nothing drifted; sensitivity peak 2.01, zone A of ISO 14839-3"
_EXAMPLE: dict[str, Any] = {
    "id": examples.HEALTH,
    "rig": examples.RIG,
    "rig_version": 2,
    "experiment": examples.EXPERIMENT,
    "baseline_model": examples.MODEL,
    "schedule": examples.SCHEDULE,
    "job": examples.JOB,
    "alarm": False,
    "zone": "A",
    "zone_calm": True,
    "drifted": [],
    "drifted_words": [],
    "sentence": _SENTENCE,
    "created_at": examples.TIME,
}
_FIGURE = {
    "plane": "x",
    "name": "kiA",
    "unit": "N/A",
    "now": {"value": 180.93, "std": 0.09},
    "baseline": {"value": 181.0, "std": 0.02},
    "change_percent": -0.04,
    "change_std_percent": 0.05,
    "drifted": False,
}
_DOCUMENT = {
    "format": "amb-health-check",
    "version": 1,
    "rig": "compressor 3",
    "alarm": False,
    "drifted": [],
    "sentence": _SENTENCE,
    "parameters": {"x.kiA": _FIGURE},
    "zone": "A",
}


class HealthShape(Shape):
    """A health check."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})

    id: str
    rig: str
    rig_version: int
    experiment: str
    baseline_model: str
    schedule: str | None
    job: str | None
    alarm: bool
    zone: str
    zone_calm: bool
    """Whether a rig may stay in that zone: as A and B of ISO 14839-3, the first two with a limit of the rig's table."""
    drifted: list[str]
    drifted_words: list[str]
    """The same in words, each figure with its change, as in the sentence."""
    sentence: str
    created_at: Time


class HealthDocument(HealthShape):
    """A health check with its whole document."""

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE | {"document": _DOCUMENT}]})

    document: dict[str, Any]
    """amb-health-check: every figure now and then, with both uncertainties."""


class TrendShape(Shape):
    """Every monitored figure of a rig over its checks."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "rig": examples.RIG,
                    "checks": [examples.HEALTH],
                    "next": None,
                    "series": {
                        "x.kiA": {
                            "at": [examples.TIME],
                            "change_percent": [-0.04],
                            "std_percent": [0.05],
                            "baseline_std_percent": 0.01,
                            "drifted": [False],
                            "slope_percent_per_year": None,
                            "slope_std_percent_per_year": None,
                            "slope_significance": None,
                            "drifting": False,
                        }
                    },
                },
            ]
        }
    )

    rig: str
    checks: list[str]
    """Ids, oldest first."""
    next: str | None
    """``after`` of the page with the checks before these; null where there are none."""
    series: dict[str, Any]


def _values(row: HealthRow) -> dict[str, Any]:
    return {
        "id": row.id,
        "rig": row.rig_id,
        "rig_version": row.rig_version,
        "experiment": row.experiment_id,
        "baseline_model": row.model_id,
        "schedule": row.schedule_id,
        "job": row.job_id,
        "alarm": row.alarm,
        "zone": row.document["zone"],
        "zone_calm": zone_is_calm(row.document),
        "drifted": row.document["drifted"],
        "drifted_words": drifted_words(row.document),
        "sentence": row.document["sentence"],
        "created_at": row.created_at,
    }


@router.get("/health-checks", response_model=Listed[HealthShape], responses=etags.documented_list())
def list_health_checks(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_by_making("hc")],
    rig: OfRig = None,
    alarm: Annotated[bool | None, Query(description="Only alarms, or only others.")] = None,
    newest: Annotated[bool, Query(description="Only the newest check of each rig: how it is now.")] = False,
) -> Response:
    """All health checks, newest first."""
    with api.database.read() as session:
        page = results.listed(session, HealthRow, rig, asked.after, asked.limit, newest, alarm=alarm)
    return asked.answer(Listed[HealthShape], page, lambda row: HealthShape(**_values(row)))


@router.get("/health-checks/{health_id}", response_model=HealthDocument, responses=etags.documented_resource())
def get_health_check(health_id: HealthId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """A health check: which figure drifted, by how much, and how sure that is."""
    with api.database.read() as session:
        row = results.get(session, HealthRow, health_id)
    return etags.document(HealthDocument(**_values(row), document=row.document), if_none_match)


@router.get(
    "/health-checks/{health_id}/report.html",
    response_class=Response,
    responses=etags.documented_page(),
)
def get_health_report(health_id: HealthId, who: Viewer, api: Api, if_none_match: IfNoneMatch = None) -> Response:
    """The report of a check with its trend plots, one page that needs nothing else."""
    with api.database.read() as session:
        row = results.get(session, HealthRow, health_id)
    return etags.stored(api.blobs, row.report_sha256, etags.HTML, if_none_match)


@router.get("/rigs/{rig_id}/trend", response_model=TrendShape, responses=etags.documented_list(404))
def health_trend(
    rig_id: RigId, who: Viewer, api: Api, asked: Annotated[Asked[str], asked_by_making("hc", LARGEST_PAGE)]
) -> Response:
    """How a rig's figures went over its newest checks, or those before, and whether one of them moves steadily."""
    from service.health import trend as trends  # with it comes scipy, for which every start would wait

    with api.database.read() as session:
        rigs.get(session, rig_id)
        page = results.listed(session, HealthRow, rig_id, asked.after, asked.limit)
    rows = page.items[::-1]
    history = [trends.Checked(row.created_at, row.document, row.id) for row in rows]
    series = {name: found.document() for name, found in trends.trend(history).items()} if history else {}
    found = TrendShape(rig=rig_id, checks=[row.id for row in rows], next=page.next, series=series)
    return etags.document(found, asked.if_none_match)
