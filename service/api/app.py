"""The application: wires the services, the routes and what is around them."""

from __future__ import annotations

import logging
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from anyio import to_thread
from fastapi import APIRouter, FastAPI

from service import tracing
from service.access.rate import Rate
from service.api import access, description, operations, page, problems
from service.api.kept import Kept, Momentary
from service.api.middleware import Around
from service.api.resources import events, experiments, exports, gaps, health, jobs, live, log, models, rigs, schedules
from service.api.state import Services
from service.bootstrap import product_version
from service.config import Settings
from service.jobs.engine import Dispatcher
from service.private import make_folders
from service.storage.blobs import Blobs
from service.storage.database import Database
from service.storage.migrate import upgrade

logger = logging.getLogger(__name__)
THREADS = 24
"""Requests that are worked on at once; the others wait their turn."""
DESCRIPTION = """Commissioning of active magnetic bearings as a service: rigs, experiments, models, diagnoses and
health checks. Every error is `application/problem+json` (RFC 9457). Lists are pages, newest first: the field `next`
is `after` of the next page. Documents and lists have ETags. What takes time is a job: `POST` answers 202 with its
URL, and `/api/v1/jobs/{id}/events` tells how far it is."""


def create_app(settings: Settings) -> FastAPI:
    """The application of these settings; migrates the tables.

    Raises
    ------
    StorageError
        A database or the store cannot be used.
    """
    make_folders(settings)
    database = Database(settings.database, pool_size=THREADS)
    upgrade(database)
    services = Services(settings, database, Blobs(settings.store), Dispatcher(settings), Kept(database))
    app = FastAPI(
        title="ambit",
        version=product_version(),
        description=DESCRIPTION,
        lifespan=_lifespan,
        docs_url=None,  # our own, in page: FastAPI's loads its files from elsewhere
        redoc_url=None,
    )
    app.state.services = services
    app.state.gate = access.Gate(database, Rate(settings.requests_per_s, settings.requests_burst))
    app.state.lines = live.Lines()
    app.state.metrics = operations.Metrics(services)
    app.state.ready = Momentary(operations.FRESH_S, operations.PATIENCE_S)
    app.state.watchers = events.Watchers()
    problems.install(app)
    for router in (*_routers(), operations.router, page.router):
        app.include_router(router)
    app.router.default = access.Elsewhere(app.router.default)
    app.add_middleware(
        Around,
        metrics=app.state.metrics,
        max_body_bytes=settings.max_body_bytes,
        max_upload_bytes=settings.max_upload_bytes,
    )
    if settings.otlp_endpoint:
        app.add_middleware(tracing.TraceRequests)
    app.openapi = lambda: description.described(app)  # type: ignore[method-assign]
    return app


def _routers() -> list[APIRouter]:
    found = [rigs, live, jobs, events, experiments, models, exports, gaps, health, schedules, log]
    return [module.router for module in found]


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    to_thread.current_default_thread_limiter().total_tokens = THREADS
    services: Services = app.state.services
    threading.Thread(target=services.dispatcher.warm, name="warm", daemon=True).start()
    yield
    app.state.lines.close()
    services.dispatcher.close()
    services.database.close()
