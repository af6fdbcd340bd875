"""A job as it goes on: server-sent events until it has ended."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Header, Request
from sqlalchemy.exc import SQLAlchemyError
from sse_starlette import EventSourceResponse, ServerSentEvent

from service.access.errors import RateError
from service.api.access import Gate, KeyFirst
from service.api.problems import documented
from service.api.resources.jobs import JobShape, shape
from service.api.shapes import JobId, Viewer
from service.api.state import Api, Services
from service.storage import jobs

router = APIRouter(prefix="/api/v1/jobs", tags=["jobs"], route_class=KeyFirst)

POLL_S = 0.2
LARGEST = 100
"""Watchers at a time: each of them reads the database again and again."""
RETRY_S = 5.0
PING_S = 15
KEY_S = 2.0
"""How long a stream goes on after the key that opened it has ended."""
_EVENT = {
    "type": "object",
    "description": "One event; comments between them are signs of life.",
    "properties": {
        "event": {"enum": ["progress", "state"]},
        "id": {"type": "string", "description": "Of the change; send it back as Last-Event-ID to go on."},
        "data": {"type": "string", "description": "The job, JSON."},
    },
    "required": ["event", "id", "data"],
}
_EXAMPLE = (
    'event: progress\nid: 17\ndata: {"id": "job_01k9...", "state": "running", "progress": {"percent": 42.0, '
    '"point": 126, "points": 300, "phase": "main", "time_left_s": 180.0}}\n\n'
    'event: state\nid: 31\ndata: {"id": "job_01k9...", "state": "done"}\n\n'
)


class Watchers:
    """Streams that are open."""

    def __init__(self) -> None:
        self.count = 0

    def must_have_room(self) -> None:
        """Raise RateError when there are as many as this service serves."""
        if self.count >= LARGEST:
            raise RateError(
                f"{LARGEST} watchers are served at a time; ask for the job itself now and then", retry_after_s=RETRY_S
            )


@router.get(
    "/{job_id}/events",
    response_class=EventSourceResponse,
    responses=documented(404)
    | {
        200: {
            "description": "Events `progress` and `state`, the data of both the job as JSON; ends with the job.",
            "content": {"text/event-stream": {"schema": _EVENT, "example": _EXAMPLE}},
        }
    },
)
async def job_events(
    request: Request,
    job_id: JobId,
    who: Viewer,
    api: Api,
    last_event_id: Annotated[
        str | None, Header(description="Id of the last event that the caller has.", max_length=40)
    ] = None,
) -> EventSourceResponse:
    """Watch a job: an event for every change, with percent, point and time left."""
    watchers: Watchers = request.app.state.watchers
    watchers.must_have_room()
    first = await to_thread.run_sync(_job, api, job_id)
    known = int(last_event_id) if last_event_id and last_event_id.isascii() and last_event_id.isdigit() else -1
    return EventSourceResponse(_counted(watchers, _changes(request, api, first, known)), ping=PING_S)


async def _counted(watchers: Watchers, stream: AsyncGenerator[ServerSentEvent]) -> AsyncIterator[ServerSentEvent]:
    watchers.count += 1
    try:
        async with aclosing(stream):
            async for event in stream:
                yield event
    finally:
        watchers.count -= 1


def _job(api: Services, job_id: str) -> tuple[int, JobShape]:
    with api.database.read() as session:
        job = jobs.get(session, job_id)
    return job.changes, shape(job)


async def _changes(
    request: Request, api: Services, first: tuple[int, JobShape], known: int
) -> AsyncGenerator[ServerSentEvent]:
    gate: Gate = request.app.state.gate
    state, asked = "", time.monotonic()
    changes, job = first
    while True:
        if changes != known or state == "":
            kind = "state" if job.state != state else "progress"
            yield ServerSentEvent(data=_data(job), event=kind, id=str(changes))
            known, state = changes, job.state
        if job.state in jobs.ENDED:
            return
        await asyncio.sleep(POLL_S)
        if await request.is_disconnected():
            return
        try:
            if time.monotonic() - asked > KEY_S:
                if not await gate.still_lets_in(request):
                    return
                asked = time.monotonic()
            changes, job = await to_thread.run_sync(_job, api, job.id)
        except SQLAlchemyError:  # the database is away for a moment: the watcher need not know
            await asyncio.sleep(1.0)


def _data(job: JobShape) -> str:
    body: dict[str, Any] = job.model_dump(mode="json")
    return json.dumps(body, separators=(",", ":"))
