"""A rig as it is now: asked of its controller. Reading moves nothing; `stop` is safe at any time, `acknowledge` too."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict

from drivers.errors import ControllerError
from service import bootstrap
from service.access.audit import Action
from service.access.keys import Identity
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.problems import UnavailableError, documented
from service.api.resources.controllers import IN_PROCESS
from service.api.shapes import Operator, RigId, Shape, Viewer
from service.api.state import Api, Services
from service.campaign.leased import acknowledged
from service.errors import ConflictError
from service.storage import jobs, rigs

if TYPE_CHECKING:
    from drivers.controller import Controller
    from service.storage.tables import Rig

log = logging.getLogger(__name__)
T = TypeVar("T")
router = APIRouter(prefix="/api/v1/rigs", tags=["rigs"], route_class=KeyFirst)

FRESH_S = 0.5
"""Whoever asks again within this time gets the same answer: a page that many look at does not load the bus."""
STOPS = 8
"""Stops that are worked on at once, beside all other requests: none of those is waited for."""
STOPPED = "the rig was stopped by hand"
IDLE_S = 30.0
"""A connection that nobody asked for so long is given up."""


class LiveStatus(Shape):
    """A controller now; only the first three where it does not answer."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "reachable": True,
                    "detail": "",
                    "controller_url": "modbus://10.0.0.7:502?unit=1",
                    "identity": "amb reference rig",
                    "state": "levitated",
                    "trip": "none",
                    "trip_message": "",
                    "excitation_a": 0.0,
                    "displacement_m": [1e-7, -2e-7, 0.0, 0.0],
                    "current_a": [0.01, 0.0, -0.02, 0.0],
                    "lease_holder": "",
                    "lease_seconds_left": 0.0,
                    "speed_rad_s": 0.0,
                    "uptime_s": 3600.0,
                }
            ]
        }
    )

    reachable: bool
    detail: str = ""
    """Why it does not answer."""
    controller_url: str
    identity: str | None = None
    state: str | None = None
    trip: str | None = None
    trip_message: str | None = None
    excitation_a: float | None = None
    displacement_m: list[float] | None = None
    current_a: list[float] | None = None
    lease_holder: str | None = None
    """Who may move the rotor now; empty when nobody does."""
    lease_seconds_left: float | None = None
    speed_rad_s: float | None = None
    uptime_s: float | None = None


class Acknowledged(Shape):
    """A controller whose trip was to be cleared."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"acknowledged": "sensor supply lost", "state": "levitated"}]}
    )

    acknowledged: str | None
    """What it had tripped of; null where no trip was latched."""
    state: str
    """Now."""


@dataclass
class _Line:
    """A connection to one controller, used by one caller at a time."""

    url: str
    lock: threading.Lock = field(default_factory=threading.Lock)
    controller: Controller | None = None
    asked: float = 0.0
    answer: LiveStatus | None = None

    def ask(self, question: Callable[[Controller], T]) -> T:
        try:
            if self.controller is None:
                self.controller = bootstrap.connect(self.url)
            return question(self.controller)
        except Exception:
            self.close()
            raise

    def close(self) -> None:
        controller, self.controller = self.controller, None
        if controller is not None:
            with suppress(Exception):
                controller.close()


class Lines:
    """Connections of the API to controllers."""

    def __init__(self) -> None:
        self.stops = CapacityLimiter(STOPS)
        self._lines: dict[str, _Line] = {}
        self._lock = threading.Lock()

    def status(self, url: str) -> LiveStatus:
        """Status of a controller, at most half a second old."""
        line = self._line(url)
        with line.lock:
            if line.answer is not None and time.monotonic() - line.asked < FRESH_S:
                return line.answer
            try:
                line.answer = line.ask(lambda controller: _status(url, controller))
            except ControllerError as error:
                line.answer = LiveStatus(reachable=False, detail=str(error), controller_url=url)
            line.asked = time.monotonic()
            return line.answer

    def acknowledge(self, url: str) -> Acknowledged:
        """Clear the latched trip of a controller that nobody holds."""
        line = self._line(url)
        with line.lock:
            line.answer = None
            line.asked = time.monotonic()
            trip = line.ask(acknowledged)
            return Acknowledged(acknowledged=trip, state=line.ask(_state))

    def stop(self, urls: Collection[str]) -> tuple[set[str], dict[str, str]]:
        """Ramp the excitation to zero at all of these controllers at once, whoever holds the leases.

        Nobody is waited for who asks a controller that does not answer, and none keeps another one from its stop.

        Returns
        -------
        holders
            Who hears of it from a controller.
        failures
            Why a URL was not reached.
        """
        holders: set[str] = set()
        failures: dict[str, str] = {}

        def stop(url: str) -> None:
            try:
                holders.add(self._stop(url))
            except ControllerError as error:
                failures[url] = str(error)
            except Exception as error:  # a defect of one driver is no reason to let any rotor go on
                log.exception("the stop of %s met a defect", url)
                failures[url] = f"{type(error).__name__}: {error}"

        if urls:
            with ThreadPoolExecutor(len(urls)) as pool:
                list(pool.map(stop, urls))
        return holders, failures

    def _stop(self, url: str) -> str:
        line = self._line(url)
        line.answer = None
        controller = line.controller
        if controller is not None:
            with suppress(Exception):  # it has restarted, or somebody has just given the line up
                controller.stop()
                return controller.status().lease_holder
        controller = bootstrap.connect(url)
        try:
            controller.stop()
            return controller.status().lease_holder
        finally:
            controller.close()

    def _line(self, url: str) -> _Line:
        with self._lock:
            old = [k for k, line in self._lines.items() if time.monotonic() - line.asked > IDLE_S and k != url]
            dropped = [self._lines.pop(k) for k in old if not self._lines[k].lock.locked()]
            line = self._lines.setdefault(url, _Line(url))
        for other in dropped:
            other.close()
        return line

    def close(self) -> None:
        """Give up every connection."""
        with self._lock:
            lines, self._lines = list(self._lines.values()), {}
        for line in lines:
            line.close()


def _state(controller: Controller) -> str:
    return controller.status().state.name.lower()


def _status(url: str, controller: Controller) -> LiveStatus:
    s = controller.status()
    return LiveStatus(
        reachable=True,
        controller_url=url,
        identity=controller.capabilities().identity,
        state=s.state.name.lower(),
        trip=s.trip.name.lower(),
        trip_message=s.trip_message,
        excitation_a=s.excitation_a,
        displacement_m=list(s.displacement_m),
        current_a=list(s.current_a),
        lease_holder=s.lease_holder,
        lease_seconds_left=s.lease_seconds_left,
        speed_rad_s=s.speed_rad_s,
        uptime_s=s.uptime_s,
    )


def _seen_by_all(url: str) -> bool:
    """Whether there is a controller that others than the job on it reach."""
    return bool(url) and url.partition(":")[0].lower() not in IN_PROCESS


def _must_be_seen(rig: Rig, url: str) -> None:
    if not url:
        raise ConflictError(f"the rig {rig.name!r} has no controller_url; give it one to see it live")
    if not _seen_by_all(url):
        raise ConflictError(
            f"the rig {rig.name!r} is simulated inside each job, so that nobody else sees or stops it: cancel its job, "
            "or serve a simulated rig to all with `ambit rig serve` and give the rig that URL"
        )


@router.get("/{rig_id}/status", response_model=LiveStatus, responses=documented(404, 409))
def rig_status(request: Request, rig_id: RigId, who: Viewer, api: Api) -> Response:
    """The rig now: state, trip, excitation, displacements, and who holds the lease."""
    lines: Lines = request.app.state.lines
    with api.database.read() as session:
        rig = rigs.get(session, rig_id)
        url = rigs.version(session, rig).controller_url
    _must_be_seen(rig, url)
    return etags.document(lines.status(url))


@router.post("/{rig_id}/acknowledge", response_model=Acknowledged, responses=documented(404, 409))
def acknowledge_trip(request: Request, rig_id: RigId, who: Operator, api: Api) -> Acknowledged:
    """Clear the latched trip of the rig's controller, once its cause is found: jobs may excite the rotor again.

    Nothing moves by it. A controller that somebody holds is left alone.
    """
    lines: Lines = request.app.state.lines
    with api.database.read() as session:
        rig = rigs.get(session, rig_id)
        url = rigs.version(session, rig).controller_url
    _must_be_seen(rig, url)
    done = lines.acknowledge(url)
    if done.acknowledged is not None:
        with api.database.write() as session:
            audit(session, request, who, Action.trip_acknowledged, rig_id, rig=rig_id, trip=done.acknowledged)
    return done


@router.post("/{rig_id}/stop", status_code=204, response_class=Response, responses=documented(404, 409))
async def stop_rig(request: Request, rig_id: RigId, who: Operator, api: Api) -> Response:
    """Ramp the rig's excitation to zero at once, and let no job that there is move its rotor again.

    The rig's controller is stopped, and that of every job that moves the rotor or waits to do so, which may be the one
    of an earlier version. The job that holds a lease hears of it from the controller and fails, "rig stopped", and says
    who asked for it.
    Every other one is cancelled, that one too when its controller does not answer, which is told as a problem all the
    same. Any of them can be tried again. Calculations go on; so do schedules, until they are switched off.
    """
    lines: Lines = request.app.state.lines
    return await to_thread.run_sync(_stop, request, rig_id, who, api, lines, limiter=lines.stops)


def _stop(request: Request, rig_id: str, who: Identity, api: Services, lines: Lines) -> Response:
    with api.database.read() as session:
        rig = rigs.get(session, rig_id)
        current = rigs.version(session, rig).controller_url
        urls = {url for url in (current, *jobs.controllers_moving(session, rig_id)) if _seen_by_all(url)}
    holders, failures = lines.stop(urls)
    with api.database.write() as session:
        ended = [job.id for job in jobs.cancel_moving(session, rig_id, STOPPED, but=holders)]
        if not urls and not ended:
            _must_be_seen(rig, current)
        how = "stop asked for by hand; the controller did not confirm it" if failures else "stopped by hand"
        audit(session, request, who, Action.rotor_released, rig_id, rig=rig_id, how=how, cancelled=" ".join(ended))
    if failures:
        told = "; ".join(f"{url}: {why}" for url, why in sorted(failures.items()))
        asked = f"; asked to end: {', '.join(ended)}" if ended else ""
        raise UnavailableError(f"the stop did not reach the controller {told}{asked}")
    return Response(status_code=204)
