"""Experiments, models, gap diagnoses and health checks: what jobs make. Made twice, they are the same row."""

from __future__ import annotations

from typing import Any, TypeVar

from sqlalchemy import ColumnElement, UnaryExpression, func, select
from sqlalchemy.orm import Session

from service.errors import NotFoundError
from service.storage import listing
from service.storage.listing import Page, page_by_making
from service.storage.tables import Base, ExperimentRow, GapRow, HealthRow, ModelRow, Rig

Row = TypeVar("Row", ExperimentRow, ModelRow, GapRow, HealthRow)

_NAMES: dict[type[Base], tuple[str, str]] = {
    ExperimentRow: ("experiment", "experiments"),
    ModelRow: ("model", "models"),
    GapRow: ("gap diagnosis", "gaps"),
    HealthRow: ("health check", "health-checks"),
}


def get(session: Session, table: type[Row], row_id: str) -> Row:
    """One result.

    Raises
    ------
    NotFoundError
        There is none of that id.
    """
    name, path = _NAMES[table]
    return listing.row(session, table, row_id, name, f"at /api/v1/{path}")


def keep(session: Session, row: Row) -> Row:
    """Insert a row, or replace the one of the same id: a job that is repeated makes it again."""
    return session.merge(row)


def made_by(session: Session, job_id: str) -> dict[str, str]:
    """What a job has made so far: ids by kind, as in its result."""
    found = {
        kind: session.scalar(select(table.id).where(table.job_id == job_id))
        for kind, table in (("experiment", ExperimentRow), ("model", ModelRow), ("gap", GapRow), ("health", HealthRow))
    }
    return {kind: row_id for kind, row_id in found.items() if row_id is not None}


def listed(
    session: Session,
    table: type[Row],
    rig_id: str | None = None,
    after: str | None = None,
    limit: int = 100,
    newest: bool = False,
    **equal: Any,
) -> Page[Row]:
    """A page of results, of one rig or of all, that which was made last first.

    ``equal`` are columns and their values, None for any. ``newest`` leaves only that of each rig which was made last,
    before any column is asked for.
    """
    conditions: list[ColumnElement[bool]] = [
        getattr(table, name) == value for name, value in {"rig_id": rig_id, **equal}.items() if value is not None
    ]
    if newest:
        place = func.row_number().over(partition_by=table.rig_id, order_by=_last_made(table))
        of_rig = () if rig_id is None else (table.rig_id == rig_id,)
        placed = select(table.id, place.label("place")).where(*of_rig).subquery()
        conditions.append(table.id.in_(select(placed.c.id).where(placed.c.place == 1)))
    return page_by_making(session, table, *conditions, after=after, limit=limit)


def _last_made(table: type[Row]) -> tuple[UnaryExpression[Any], ...]:
    """Order of rows, the one that was made last first."""
    return table.created_at.desc(), table.id.desc()


def baseline(session: Session, rig: Rig) -> ModelRow:
    """The model that a rig's health is compared with.

    Raises
    ------
    NotFoundError
        The rig has no model of a whole commissioning that identified it.
    """
    if rig.baseline_model_id is not None:
        return get(session, ModelRow, rig.baseline_model_id)
    query = (
        select(ModelRow)
        .join(ExperimentRow, ExperimentRow.id == ModelRow.experiment_id)
        .where(ModelRow.rig_id == rig.id, ExperimentRow.complete, ExperimentRow.purpose == "commissioning")
        .where(ModelRow.summary["identified"].as_boolean().is_not(False))  # of models from before it was said, too
        .order_by(*_last_made(ModelRow))
        .limit(1)
    )
    found = session.scalar(query)
    if found is None:
        raise NotFoundError(f"the rig {rig.name!r} has no model to compare with; commission it first")
    return found
