"""A rig as it is now: asked of its controller. Reading moves nothing; `stop` is safe at any time, `acknowledge` too."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import wait
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import BusError, ControllerError
from service import bootstrap
from service.access.audit import Action
from service.access.keys import Identity
from service.api import etags
from service.api.access import KeyFirst
from service.api.auditing import audit
from service.api.kept import Momentary
from service.api.problems import UnavailableError, documented
from service.api.resources.controllers import IN_PROCESS, OF_ONE
from service.api.shapes import Operator, RigId, Shape, Viewer
from service.api.state import Api, Services
from service.aside import aside, within
from service.campaign.leased import acknowledged
from service.errors import ConflictError
from service.storage import jobs, rigs
from service.storage.audit import holding
from sim.errors import reason

if TYPE_CHECKING:
    from drivers.controller import Controller
    from service.storage.tables import Rig

log = logging.getLogger(__name__)
T = TypeVar("T")
router = APIRouter(prefix="/api/v1/rigs", tags=["rigs"], route_class=KeyFirst)

FRESH_S = 0.5
"""Whoever asks again within this time gets the same answer: a page that many look at does not load the bus."""
ANSWER_S = 5.0
"""How long a request waits for a controller, whatever its driver does; most drivers say earlier that nobody answers."""
STOPS = 8
"""Stops that look into the database at once, beside all other requests: none of those is waited for."""
STOPS_EACH = 4
"""Stops of one controller that are under way at once; the others wait their turn, as long as they may."""
STOPPED = "the rig was stopped by hand"
END_IT_THERE = "end the excitation at the controller, or see that it is on and that its address is right"
IDLE_S = 30.0
"""A connection that nobody asked for so long is given up."""
CLOSE_S = 1.0
"""Time that connections have to be given up in when the service ends."""


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


class _Line:
    """A connection to one controller, used by one caller at a time; what its driver does is waited for by nobody else.

    However often it is asked, a controller that hangs has one thread that looks, one that acknowledges, and a few that
    stop.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.lock = threading.Lock()
        self.controller: Controller | None = None
        self.asked = time.monotonic()
        self.now: Momentary[LiveStatus] = Momentary(FRESH_S, ANSWER_S)
        self.acknowledging: Momentary[Acknowledged] = Momentary(0.0, ANSWER_S)
        self._stops = threading.Semaphore(STOPS_EACH)
        self._stopped: tuple[float, str] | None = None
        """When a stop that reached the controller began, and whose lease it was; the last one that began."""

    def status(self) -> LiveStatus:
        """The controller now."""
        try:
            with self._turn():
                return self._ask(lambda controller: _status(self.url, controller))
        except ControllerError as error:
            return LiveStatus(reachable=False, detail=str(error), controller_url=self.url)

    def acknowledge(self, keep: Callable[[str], None]) -> Acknowledged:
        """Clear the latched trip, which ``keep`` is told."""
        with self._turn():
            trip = self._ask(acknowledged)
            self.now.forget()
            if trip is not None:
                keep(trip)
            return Acknowledged(acknowledged=trip, state=self._ask(_state))

    def stop(self) -> str:
        """Ramp the excitation to zero, past whoever asks something else; whose lease it was.

        One that waits for its turn is answered by any stop that began after it was asked for and reached the
        controller: however many come together, none has to wait for all of them.
        """
        asked = time.monotonic()
        if not self._stops.acquire(timeout=ANSWER_S / 2):
            raise BusError(f"{STOPS_EACH} stops before this one are not answered yet; {END_IT_THERE}")
        try:
            began, last = time.monotonic(), self._stopped
            if last is not None and last[0] > asked:
                return last[1]
            holder = self._stop()
            last = self._stopped
            if last is None or last[0] < began:
                self._stopped = (began, holder)
            return holder
        finally:
            self._stops.release()
            self.now.forget()

    def _stop(self) -> str:
        """Stop over the connection that is open, or over one of its own."""
        controller = self.controller
        if controller is not None:
            with suppress(Exception):  # it has restarted, or somebody has just given the line up
                controller.stop()
                return _holder(controller)
        with bootstrap.connected(self.url) as controller:
            controller.stop()
            return _holder(controller)

    def close(self) -> None:
        """Give the connection up."""
        controller, self.controller = self.controller, None
        if controller is not None:
            with suppress(Exception):
                controller.close()

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self.lock.acquire(timeout=ANSWER_S / 2):  # in time for whoever asks to be told so
            raise BusError(f"{self.url}: what it was asked before is not answered yet; see that the controller is on")
        try:
            yield
        finally:
            self.lock.release()

    def _ask(self, question: Callable[[Controller], T]) -> T:
        try:
            if self.controller is None:
                self.controller = bootstrap.connect(self.url)
            answer = question(self.controller)
        except Exception:
            self.close()
            raise
        if _scheme(self.url) in OF_ONE:  # a job could not open it
            self.close()
        return answer


class Lines:
    """Connections of the API to controllers. Nothing in here waits in a thread of the requests."""

    def __init__(self) -> None:
        self.stops = CapacityLimiter(STOPS)
        self._lines: dict[str, _Line] = {}

    async def status(self, url: str) -> LiveStatus:
        """Status of a controller, at most half a second old."""
        line = self._line(url)
        try:
            return await line.now.get(line.status)
        except TimeoutError:
            return LiveStatus(reachable=False, detail=_no_answer(url), controller_url=url)

    async def acknowledge(self, url: str, keep: Callable[[str], None]) -> Acknowledged:
        """Clear the latched trip of a controller that nobody holds, and have it written down, however late it is."""
        line = self._line(url)
        try:
            return await line.acknowledging.get(lambda: line.acknowledge(keep))
        except TimeoutError:
            raise BusError(f"{_no_answer(url)}; whether its trip is acknowledged is not known") from None

    async def stop(self, urls: Collection[str]) -> tuple[set[str], dict[str, str]]:
        """Ramp the excitation to zero at all of these controllers at once, whoever holds the leases.

        Nobody is waited for who asks a controller that does not answer, and none keeps another one from its stop.

        Returns
        -------
        holders
            Who has the controllers' leases right after it.
        failures
            Why a URL was not reached.
        """
        holders: set[str] = set()
        failures: dict[str, str] = {}

        async def stop(url: str) -> None:
            try:
                holders.add(await within(ANSWER_S, aside(self._line(url).stop, "stop")))
            except TimeoutError:
                failures[url] = f"no answer within {ANSWER_S:g} s; {END_IT_THERE}"
            except ControllerError as error:
                failures[url] = str(error)
            except Exception as error:  # a defect of one driver is no reason to let any rotor go on
                log.exception("the stop of %s met a defect", url)
                failures[url] = f"{type(error).__name__}: {error}"

        await asyncio.gather(*map(stop, urls))
        return holders, failures

    def _line(self, url: str) -> _Line:
        line = self._lines.setdefault(url, _Line(url))
        line.asked = time.monotonic()
        for other in [line for line in self._lines.values() if line.asked < time.monotonic() - IDLE_S]:
            if not other.lock.locked():
                del self._lines[other.url]
                aside(other.close, "line")
        return line

    def close(self) -> None:
        """Give up every connection, as far as their drivers do so in time."""
        closing = [aside(line.close, "line") for line in self._lines.values()]
        self._lines = {}
        wait(closing, CLOSE_S)


def _no_answer(url: str) -> str:
    return (
        f"{url}: the controller does not answer within {ANSWER_S:g} s; see that it is on, and that its address is right"
    )


def _holder(controller: Controller) -> str:
    """Whose lease it is that was stopped; empty where the status is one that cannot be read, which undoes no stop."""
    try:
        return controller.status().lease_holder
    except BusError:
        raise
    except ControllerError as error:
        log.warning("the controller was stopped, and its status cannot be read: %s", error)
        return ""


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
        excitation_a=_known(s.excitation_a),
        displacement_m=list(s.displacement_m) if all(map(math.isfinite, s.displacement_m)) else None,
        current_a=list(s.current_a) if all(map(math.isfinite, s.current_a)) else None,
        lease_holder=s.lease_holder,
        lease_seconds_left=_known(s.lease_seconds_left),
        speed_rad_s=_known(s.speed_rad_s),
        uptime_s=_known(s.uptime_s),
    )


def _known(value: float) -> float | None:
    """A figure for JSON, which has no not-a-number, as a controller may tell of what it cannot measure."""
    return value if math.isfinite(value) else None


def _seen_by_all(url: str) -> bool:
    """Whether there is a controller that others than the job on it reach."""
    return bool(url) and _scheme(url) not in IN_PROCESS


def _scheme(url: str) -> str:
    return url.partition(":")[0].lower()


def _must_be_seen(rig: Rig, url: str) -> None:
    if not url:
        raise ConflictError(f"the rig {rig.name!r} has no controller_url; give it one to see it live")
    if not _seen_by_all(url):
        raise ConflictError(
            f"the rig {rig.name!r} is simulated inside each job, so that nobody else sees or stops it: cancel its job, "
            "or serve a simulated rig to all with `ambit rig serve` and give the rig that URL"
        )


def _controller(api: Services, rig_id: str) -> str:
    """URL of a rig's controller, which others than the job on it reach."""
    with api.database.read() as session:
        rig = rigs.get(session, rig_id)
        url = rigs.version(session, rig).controller_url
    _must_be_seen(rig, url)
    return url


@router.get("/{rig_id}/status", response_model=LiveStatus, responses=documented(404, 409))
async def rig_status(request: Request, rig_id: RigId, who: Viewer, api: Api) -> Response:
    """The rig now: state, trip, excitation, displacements, and who holds the lease."""
    lines: Lines = request.app.state.lines
    return etags.document(await lines.status(await to_thread.run_sync(_controller, api, rig_id)))


@router.post("/{rig_id}/acknowledge", response_model=Acknowledged, responses=documented(404, 409))
async def acknowledge_trip(request: Request, rig_id: RigId, who: Operator, api: Api) -> Acknowledged:
    """Clear the latched trip of the rig's controller, once its cause is found: jobs may excite the rotor again.

    Nothing moves by it. A controller that somebody holds is left alone.
    """
    lines: Lines = request.app.state.lines

    def keep(trip: str) -> None:
        with api.database.write() as session:
            audit(session, request, who, Action.trip_acknowledged, rig_id, rig=rig_id, trip=trip)

    return await lines.acknowledge(await to_thread.run_sync(_controller, api, rig_id), keep)


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
    urls, leased = await to_thread.run_sync(_moving, rig_id, api, limiter=lines.stops)
    holders, failures = await lines.stop(urls)
    # One whose lease began only after the stop has not heard of it, though the controller names it by now.
    hear = holders & leased
    try:
        ended = await to_thread.run_sync(
            _stopped, request, rig_id, who, api, urls, hear, bool(failures), limiter=lines.stops
        )
    except SQLAlchemyError as error:
        if not (reached := sorted(urls - set(failures))):
            raise
        log.error("what a stop ends cannot be written down: %s", reason(error))
        missed = "".join(f"; the stop did not reach the controller {url}: {failures[url]}" for url in sorted(failures))
        raise UnavailableError(
            f"the excitation was ended at {', '.join(reached)}, but the database cannot be written, and jobs that wait "
            f"may move the rotor again: see to the database and its disk, then stop once more{missed}"
        ) from error
    if failures:
        told = "; ".join(f"{url}: {why}" for url, why in sorted(failures.items()))
        asked = f"; asked to end: {', '.join(ended)}" if ended else ""
        raise UnavailableError(f"the stop did not reach the controller {told}{asked}")
    return Response(status_code=204)


def _moving(rig_id: str, api: Services) -> tuple[set[str], set[str]]:
    """Controllers that may excite the rig now or soon, as far as others than a job reach them; jobs with a lease."""
    with api.database.read() as session:
        current = rigs.version(session, rigs.get(session, rig_id)).controller_url
        urls = {url for url in (current, *jobs.controllers_moving(session, rig_id)) if _seen_by_all(url)}
        return urls, holding(session, rig_id, jobs.moving(session, rig_id))


def _stopped(
    request: Request, rig_id: str, who: Identity, api: Services, urls: set[str], hear: set[str], failed: bool
) -> list[str]:
    """Cancel the jobs that do not ``hear`` of the stop from a controller, and write it down; which ones."""
    with api.database.write() as session:
        ended = [job.id for job in jobs.cancel_moving(session, rig_id, STOPPED, but=hear)]
        if not urls and not ended:
            rig = rigs.get(session, rig_id)
            _must_be_seen(rig, rigs.version(session, rig).controller_url)
        how = "stop asked for by hand; the controller did not confirm it" if failed else "stopped by hand"
        audit(session, request, who, Action.rotor_released, rig_id, rig=rig_id, how=how, cancelled=" ".join(ended))
    return ended
