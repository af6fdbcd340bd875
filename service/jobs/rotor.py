"""A controller whose lease is in the audit log: no rotor moves before it is written down for whom."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from drivers.controller import (
    Capabilities,
    Controller,
    PeriodicController,
    PointResult,
    Status,
    Tone,
    Waveform,
    WaveformResult,
)
from drivers.errors import BusError
from service.access.audit import Action, AuditEvent
from service.jobs.context import Context
from service.storage import audit
from service.storage.tables import JobRow

log = logging.getLogger(__name__)


class AuditedController:
    """A controller of a job.

    Parameters
    ----------
    controller
        Does everything.
    stopped
        Whether the job shall end: then a database that is away is not waited for.
    silent
        Told each time that the bus failed while a point was measured, which whoever measures may try again.
    """

    def __init__(
        self,
        controller: Controller,
        worker: Context,
        job: JobRow,
        stopped: Callable[[], bool],
        silent: Callable[[BusError], None] = lambda error: None,
    ) -> None:
        self._controller = controller
        self._worker = worker
        self._job = job
        self._stopped = stopped
        self._silent = silent
        self._tones = 0

    def capabilities(self) -> Capabilities:
        """What the controller is and allows."""
        return self._controller.capabilities()

    def status(self) -> Status:
        """Snapshot of state, trip, excitation, lease."""
        return self._controller.status()

    @contextmanager
    def lease(self, holder: str, seconds: float | None = None) -> Iterator[None]:
        """Hold the rig exclusively, for the seconds of the settings; both ends are in the audit log."""
        how = "done"
        leased = False
        try:
            with self._controller.lease(holder, seconds or self._worker.settings.lease_s):
                self._record(Action.rotor_excited, holder=holder)
                leased = True
                yield
        except BaseException as error:
            how = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise
        finally:
            if leased:
                try:
                    self._record(Action.rotor_released, how=how, tones=self._tones)
                except SQLAlchemyError:  # what ended the lease is the error to tell
                    log.exception("job %s: the audit log lacks that the rotor was released: %s", self._job.id, how)

    def measure(self, tone: Tone) -> PointResult:
        """Excite with one tone, wait, measure, and ramp back to zero."""
        self._tones += 1
        with self._telling():
            return self._controller.measure(tone)

    def measure_periodic(self, waveform: Waveform) -> WaveformResult:
        """The same with a periodic waveform on all axes, where the capabilities say ``periodic``."""
        assert isinstance(self._controller, PeriodicController)
        self._tones += 1
        with self._telling():
            return self._controller.measure_periodic(waveform)

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except BusError as error:
            self._silent(error)
            raise

    def stop(self) -> None:
        """Ramp the excitation to zero."""
        self._controller.stop()

    def acknowledge(self) -> None:
        """Clear a latched trip."""
        self._controller.acknowledge()

    def close(self) -> None:
        """Stop, and give up the link."""
        self._controller.close()

    def _record(self, action: Action, **detail: str | int) -> None:
        job = self._job
        name = self._worker.settings.worker
        key = job.requested_key or f"worker:{name}"[:40]
        event = AuditEvent(action, key, job.requested_by, job.id, job.rig_id, {"worker": name, **detail})

        def write(session: Session) -> None:
            audit.record(session, event)

        self._worker.database.surely(write, self._stopped)
