"""Rigs: a datasheet and where the controller is, every version kept."""

from __future__ import annotations

from typing import Annotated
from unicodedata import normalize

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import ConfigDict, Field
from sqlalchemy.orm import Session

from service.access.audit import Action
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.lists import Asked, Listed, asked_by_number, asked_of
from service.api.once import Answer, once
from service.api.problems import UnprocessableError, documented
from service.api.resources import examples
from service.api.resources.controllers import checked_url
from service.api.shapes import (
    Admin,
    IdempotencyKey,
    IfMatch,
    IfNoneMatch,
    Operator,
    RigId,
    Shape,
    Time,
    Viewer,
    Wanted,
)
from service.api.state import Api, Services
from service.errors import ConflictError
from service.storage import jobs, results, rigs, schedules
from service.storage.database import now
from service.storage.tables import ModelRow, Rig, RigVersion
from sim import rig_file

router = APIRouter(prefix="/api/v1/rigs", tags=["rigs"], route_class=KeyFirst)
RETIRED = "the rig was retired"
LONGEST_NAME = 200


class RigWanted(Wanted):
    """A rig as it is given."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"datasheet": examples.RIG_TOML, "controller_url": "modbus://10.0.0.7:502?unit=1", "note": "as built"}
            ]
        }
    )

    datasheet: str = Field(min_length=1, max_length=200_000, description="rig.toml, whole.")
    controller_url: str = Field(
        "", max_length=500, description="Where the controller is: modbus://host:502?unit=1, canopen://...; or empty."
    )
    note: str = Field("", max_length=2000)
    name: str | None = Field(
        None,
        min_length=1,
        max_length=LONGEST_NAME,
        description="Unique; the datasheet's without it. It stays for good.",
    )


class RigShape(Shape):
    """A rig."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "id": examples.RIG,
                    "name": "compressor 3",
                    "version": 2,
                    "axes": ["xA", "xB", "yA", "yB"],
                    "controller_url": "modbus://10.0.0.7:502?unit=1",
                    "datasheet": examples.RIG_TOML,
                    "note": "as built",
                    "created_at": examples.TIME,
                    "updated_at": examples.TIME,
                    "changed_by": "lab bench",
                    "retired_at": None,
                    "baseline_model": None,
                }
            ]
        }
    )

    id: str
    name: str
    version: int
    axes: list[str]
    controller_url: str
    datasheet: str
    note: str
    created_at: Time
    updated_at: Time
    changed_by: str
    retired_at: Time | None
    baseline_model: str | None
    """What health checks compare with; null for the newest model of a whole commissioning."""


class RigVersionShape(Shape):
    """A rig as it was from one time to the next."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "version": 2,
                    "controller_url": "modbus://10.0.0.7:502?unit=1",
                    "datasheet": examples.RIG_TOML,
                    "note": "sensors exchanged",
                    "created_at": examples.TIME,
                    "created_by": "lab bench",
                },
            ]
        }
    )

    version: int
    controller_url: str
    datasheet: str
    note: str
    created_at: Time
    created_by: str


class BaselineWanted(Wanted):
    """Which model health checks compare with."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"model": examples.MODEL}, {"model": None}]})

    model: str | None = Field(max_length=40, description="A model of this rig; null for the newest.")


def tag(rig: Rig) -> str:
    """ETag of a rig."""
    retired = "r" if rig.retired_at else ""
    return f"{rig.id}.{rig.version}{retired}.{(rig.baseline_model_id or '')[4:]}"


def shape(rig: Rig, version: RigVersion) -> RigShape:
    """A rig as it is sent."""
    return RigShape(
        id=rig.id,
        name=rig.name,
        version=version.version,
        axes=list(rig_file.kept_axes(version.datasheet)),
        controller_url=version.controller_url,
        datasheet=version.datasheet,
        note=version.note,
        created_at=rig.created_at,
        updated_at=rig.updated_at,
        changed_by=version.created_by,
        retired_at=rig.retired_at,
        baseline_model=rig.baseline_model_id,
    )


def _checked(wanted: RigWanted, services: Services) -> str:
    """Name of a rig that can be used, as it is kept.

    Raises
    ------
    DatasheetError, UnprocessableError
        It cannot.
    """
    sheet = rig_file.parse(wanted.datasheet, "datasheet")
    checked_url(wanted.controller_url, services.settings)
    name = normalize("NFC", wanted.name or sheet.name)  # as one letter, or letter and accent: it looks the same
    if len(name) > LONGEST_NAME or not name.isprintable():  # it is shown in logs and on terminals, which would obey it
        raise UnprocessableError(
            f"the name of a rig has at most {LONGEST_NAME} characters, none of which is a control character; give "
            "another one, or the field name"
        )
    if name != name.strip():  # it would look like another rig's, or like none
        raise UnprocessableError(f"the name {name!r} begins or ends with a space; leave it out, or give the field name")
    return name


def version_shape(row: RigVersion) -> RigVersionShape:
    """A version of a rig as it is sent."""
    return RigVersionShape(
        version=row.version,
        controller_url=row.controller_url,
        datasheet=row.datasheet,
        note=row.note,
        created_at=row.created_at,
        created_by=row.created_by,
    )


@router.post("", status_code=201, response_model=RigShape, responses=documented(409, 413, 415))
def create_rig(
    request: Request, wanted: RigWanted, who: Operator, api: Api, idempotency_key: IdempotencyKey = None
) -> Response:
    """Make a rig known."""
    name = _checked(wanted, api)

    def make(session: Session) -> Answer:
        rig = rigs.create(session, name, wanted.datasheet, wanted.controller_url, wanted.note, who.name)
        audit(session, request, who, Action.rig_created, rig.id, rig=rig.id, name=name)
        body = shape(rig, rigs.version(session, rig)).model_dump(mode="json")
        return Answer(201, f"/api/v1/rigs/{rig.id}", body)

    answer, replayed = once(api.database, who, request, idempotency_key, wanted.model_dump_json(), make)
    return answer.response(replayed)


async def _retired_too(
    retired: Annotated[bool, Query(description="Those too that were retired.")] = False,
) -> bool:
    """What a list of rigs is asked beside its page, and is described after it."""
    return retired


@router.get("", response_model=Listed[RigShape], responses=etags.documented_list())
def list_rigs(
    who: Viewer,
    api: Api,
    asked: Annotated[Asked[str], asked_of("rig")],
    retired: Annotated[bool, Depends(_retired_too)],
) -> Response:
    """All rigs, newest first."""
    with api.database.read() as session:
        page = rigs.listed(session, retired, asked.after, asked.limit)
        return asked.answer(Listed[RigShape], page, lambda rig: shape(rig, rigs.version(session, rig)))


@router.get("/{rig_id}", response_model=RigShape, responses=etags.documented_resource())
def get_rig(
    rig_id: RigId,
    who: Viewer,
    api: Api,
    version: Annotated[int | None, Query(ge=1, le=1_000_000, description="An earlier version.")] = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """A rig, as it is or as it was."""
    with api.database.read() as session:
        rig = rigs.get(session, rig_id)
        found = shape(rig, rigs.version(session, rig, version))
    return etags.document(found, if_none_match, tag(rig) if version is None else None)


@router.get("/{rig_id}/versions", response_model=Listed[RigVersionShape], responses=etags.documented_list(404))
def list_versions(
    rig_id: RigId, who: Viewer, api: Api, asked: Annotated[Asked[int], asked_by_number(1, 1_000_000)]
) -> Response:
    """Every version of a rig, newest first."""
    with api.database.read() as session:
        page = rigs.versions(session, rigs.get(session, rig_id), asked.after, asked.limit)
    return asked.answer(Listed[RigVersionShape], page, version_shape)


@router.put("/{rig_id}", response_model=RigShape, responses=documented(404, 409, 412, 413, 415, 428))
def change_rig(
    request: Request, rig_id: RigId, wanted: RigWanted, who: Operator, api: Api, if_match: IfMatch = None
) -> Response:
    """Give a rig a new datasheet or controller; the version before is kept."""
    name = _checked(wanted, api)
    with api.database.write() as session:
        rig = rigs.get(session, rig_id, for_update=True)
        etags.require_match(if_match, tag(rig))
        if wanted.name is not None and name != normalize("NFC", rig.name):
            raise ConflictError(f"the rig is named {rig.name!r} and keeps its name; leave the field name out")
        rigs.change(session, rig, wanted.datasheet, wanted.controller_url, wanted.note, who.name)
        audit(session, request, who, Action.rig_changed, rig.id, rig=rig.id, version=rig.version)
        found = shape(rig, rigs.version(session, rig))
    return etags.document(found, None, tag(rig))


@router.put("/{rig_id}/baseline", response_model=RigShape, responses=documented(404, 409, 412, 413, 415, 428))
def set_baseline(
    request: Request, rig_id: RigId, wanted: BaselineWanted, who: Operator, api: Api, if_match: IfMatch = None
) -> Response:
    """Choose the model that the rig's health is compared with."""
    with api.database.write() as session:
        rig = rigs.get(session, rig_id, for_update=True)
        etags.require_match(if_match, tag(rig))
        if wanted.model is not None:
            model = results.get(session, ModelRow, wanted.model)
            if model.rig_id != rig.id:
                raise ConflictError(f"the model {wanted.model} is of another rig; choose one of this rig's models")
            if model.summary.get("identified") is False:
                raise ConflictError(
                    f"the model {wanted.model} does not identify the rig, its figures say nothing; choose another one"
                )
        rig.baseline_model_id = wanted.model
        audit(session, request, who, Action.baseline_changed, rig.id, rig=rig.id, model=wanted.model)
        found = shape(rig, rigs.version(session, rig))
    return etags.document(found, None, tag(rig))


@router.delete("/{rig_id}", status_code=204, response_class=Response, responses=documented(404))
def retire_rig(request: Request, rig_id: RigId, who: Admin, api: Api) -> Response:
    """Retire a rig: what waits is cancelled, what moves the rotor is stopped, no job is taken; its history stays."""
    with api.database.write() as session:
        rig = rigs.get(session, rig_id, for_update=True)
        if rig.retired_at is None:
            rig.retired_at = now()
            audit(session, request, who, Action.rig_removed, rig.id, rig=rig.id)
            for job in jobs.cancel_of_rig(session, rig.id, RETIRED):
                audit(session, request, who, Action.job_cancelled, job.id, rig=rig.id, why=RETIRED)
            for schedule in schedules.switch_off(session, rig.id):
                audit(session, request, who, Action.schedule_changed, schedule.id, rig=rig.id, why=RETIRED)
    return Response(status_code=204)
