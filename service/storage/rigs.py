"""Rigs and their versions."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from service.errors import ConflictError, NotFoundError
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.listing import Page, page, row
from service.storage.tables import Rig, RigVersion


def create(session: Session, name: str, datasheet: str, controller_url: str, note: str, by: str) -> Rig:
    """A new rig with its first version.

    Raises
    ------
    ConflictError
        The name is taken.
    """
    if (found := session.scalar(select(Rig).where(Rig.name == name))) is not None:
        if found.retired_at is not None:
            raise ConflictError(
                f"the rig named {name!r} ({found.id}) was retired at {_at(found.retired_at)}, and its history "
                "keeps the name; give another name"
            )
        raise ConflictError(
            f"there is a rig named {name!r} already ({found.id}); change that one, or take another name"
        )
    at = now()
    rig = Rig(id=new_id("rig"), name=name, version=1, created_at=at, updated_at=at)
    session.add(rig)
    session.flush()
    _add_version(session, rig, datasheet, controller_url, note, by)
    return rig


def _at(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M} UTC"


def change(session: Session, rig: Rig, datasheet: str, controller_url: str, note: str, by: str) -> Rig:
    """A further version of a rig; the ones before stay. Nothing new is no new version."""
    current = version(session, rig)
    if (current.datasheet, current.controller_url, current.note) != (datasheet, controller_url, note):
        rig.version += 1
        rig.updated_at = now()
        _add_version(session, rig, datasheet, controller_url, note, by)
    return rig


def _add_version(session: Session, rig: Rig, datasheet: str, controller_url: str, note: str, by: str) -> None:
    session.add(
        RigVersion(
            rig_id=rig.id,
            version=rig.version,
            datasheet=datasheet,
            controller_url=controller_url,
            note=note,
            created_at=rig.updated_at,
            created_by=by,
        )
    )
    session.flush()


def get(session: Session, rig_id: str, for_update: bool = False) -> Rig:
    """A rig.

    Raises
    ------
    NotFoundError
        There is none of that id.
    """
    return row(session, Rig, rig_id, "rig", "at /api/v1/rigs", for_update)


def active(session: Session, rig_id: str) -> Rig:
    """A rig that takes jobs.

    Raises
    ------
    NotFoundError
        There is none of that id.
    ConflictError
        It is retired.
    """
    rig = get(session, rig_id)
    if rig.retired_at is not None:
        raise ConflictError(f"the rig {rig.name!r} was retired at {_at(rig.retired_at)}; it takes no jobs")
    return rig


def version(session: Session, rig: Rig, number: int | None = None) -> RigVersion:
    """A version of a rig, the newest without a number.

    Raises
    ------
    NotFoundError
        There is none of that number.
    """
    found = session.get(RigVersion, (rig.id, number or rig.version))
    if found is None:
        raise NotFoundError(f"the rig {rig.name!r} has no version {number}; it has 1 to {rig.version}")
    return found


def versions(session: Session, rig: Rig, after: int | None = None, limit: int = 100) -> Page[RigVersion]:
    """A page of a rig's versions."""
    return page(session, RigVersion, RigVersion.rig_id == rig.id, after=after, limit=limit, key="version")


def listed(session: Session, retired: bool = False, after: str | None = None, limit: int = 100) -> Page[Rig]:
    """A page of rigs."""
    conditions = [] if retired else [Rig.retired_at.is_(None)]
    return page(session, Rig, *conditions, after=after, limit=limit)
