"""For whoever runs the service: is it alive, is it ready, what does it do."""

from __future__ import annotations

from shutil import disk_usage

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from pydantic import ConfigDict
from sqlalchemy.exc import SQLAlchemyError

from service.api.kept import Momentary
from service.api.problems import Documented, documented
from service.api.query import KnownQuery
from service.api.shapes import Shape
from service.api.state import Api, Services
from service.storage import jobs, migrate, workers
from service.storage.clock import told

router = APIRouter(tags=["operations"], route_class=KnownQuery)

FRESH_S = 1.0
"""Whoever asks again within this time gets the same answer: no key is asked for here."""
PATIENCE_S = 2.0
"""Whoever asks is answered within this time, whatever database and store do."""
NO_ANSWER = "no answer yet"
LEAST_BYTES = 10_000_000
"""With less room neither rows nor an experiment can be kept, and what was measured is lost to a full disk."""
_UNKNOWN: Documented = {422: documented()[422]}
_LIMITED: Documented = _UNKNOWN | {429: documented()[429]}
BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Metrics(Collector):
    """Prometheus metrics of one application: requests as they come, jobs and workers as they are when asked."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "ambit_requests_total", "Requests", ["method", "route", "status"], registry=self.registry
        )
        self.seconds = Histogram(
            "ambit_request_seconds", "Time to answer", ["method", "route"], buckets=BUCKETS, registry=self.registry
        )
        self._now: Momentary[list[GaugeMetricFamily]] = Momentary(FRESH_S, PATIENCE_S)
        self._read_last: list[GaugeMetricFamily] = []
        self.registry.register(self)

    async def text(self) -> bytes:
        """All metrics; those of jobs and workers are left out while the database does not answer."""
        try:
            self._read_last = await self._now.get(self._read)
        except TimeoutError:  # what can be told is told
            self._read_last = []
        return generate_latest(self.registry)

    def collect(self) -> list[GaugeMetricFamily]:
        """Jobs by state, workers by age of their last sign of life; a second old at most."""
        return self._read_last

    def _read(self) -> list[GaugeMetricFamily]:
        by_state = GaugeMetricFamily("ambit_jobs", "Jobs by state", labels=["state"])
        silence = GaugeMetricFamily(
            "ambit_worker_silence_seconds", "Since a worker's last sign of life", labels=["worker"]
        )
        try:
            with self._services.database.read() as session:
                for state, count in jobs.counts(session).items():
                    by_state.add_metric([state], count)
                at = told(session)
                for row in workers.listed(session):
                    if row.stopped_at is None:
                        silence.add_metric([row.name], (at - row.beat_at).total_seconds())
        except SQLAlchemyError:  # what can be told is told
            return []
        return [by_state, silence]


class Ready(Shape):
    """Whether the service can do its work."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"ready": True, "database": "ok", "store": "ok", "workers": "ok", "version": "0.1.0"}]
        }
    )

    ready: bool
    database: str
    store: str
    workers: str
    """Without a worker jobs wait; the API is ready all the same."""
    version: str


class Alive(Shape):
    """The process answers."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"alive": True}]})

    alive: bool = True


@router.get("/healthz", response_model=Alive, responses=_UNKNOWN)
async def alive() -> Alive:
    """Whether the process answers: restart it when it does not."""
    return Alive()


@router.get("/readyz", response_model=Ready, responses=_LIMITED | {503: {"model": Ready, "description": "Not ready"}})
async def ready(request: Request, api: Api) -> Response:
    """Whether database and store answer: send no requests while they do not. A second old at most."""
    from service.bootstrap import product_version

    moment: Momentary[Ready] = request.app.state.ready
    try:
        found = await moment.get(lambda: readiness(api))
    except TimeoutError:
        found = Ready(ready=False, database=NO_ANSWER, store=NO_ANSWER, workers="unknown", version=product_version())
    return JSONResponse(found.model_dump(), 200 if found.ready else 503)


def readiness(api: Services) -> Ready:
    """Whether database and store answer now, and whether there is a worker."""
    from service.bootstrap import product_version

    database = store = worker = "ok"
    try:
        api.database.check()
        if migrate.revision(api.database) != migrate.head():
            database = "of another version; run ambit db upgrade"
        with api.database.read() as session:
            if not workers.count_alive(session):
                worker = "none is alive: jobs wait"
            if api.settings.store_of_this_machine and (other := workers.elsewhere(session)) is not None:
                store = f"of this machine alone, and a worker runs on {other.machine}: set store_url for all of them"
    except SQLAlchemyError:
        database, worker = "does not answer", "unknown"
    try:
        api.blobs.check()
        if disk_usage(api.settings.home).free < LEAST_BYTES:
            store = "no room is left on the disk of the service's home: free space there"
    except Exception:
        store = "does not answer"
    good = database == store == "ok"
    return Ready(ready=good, database=database, store=store, workers=worker, version=product_version())


@router.get(
    "/metrics",
    response_class=Response,
    responses=_LIMITED | {200: {"description": "Prometheus text", "content": {"text/plain": {}}}},
)
async def metrics(request: Request) -> Response:
    """Metrics for Prometheus; no key is needed, and nothing of a rig is told."""
    found: Metrics = request.app.state.metrics
    return Response(await found.text(), media_type=CONTENT_TYPE_LATEST)
