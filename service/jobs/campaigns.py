"""The step that moves a rotor: a campaign on the rig's controller, resumed from its journal."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.errors import BusError, CancelledError, LeaseError, RestartError, StoppedElsewhereError
from service import bootstrap
from service.aside import aside
from service.campaign.aims import Profile
from service.campaign.journal import began, entries
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.predecessor import put_aside, too_old
from service.campaign.progress import Progress
from service.campaign.run import EXPERIMENT, JOURNAL, has_all, in_use, recover_into_file, run_campaign
from service.errors import ConflictError, InUseError, JobError, StoppedError
from service.experiment.errors import CampaignError, JournalError
from service.jobs.context import Context
from service.jobs.control import Control
from service.jobs.progress import WHOLE, Part, Share
from service.jobs.rotor import AuditedController
from service.jobs.steps import datasheet_file
from service.storage import audit, jobs, results, rigs
from service.storage.database import now
from service.storage.ids import derived_id, new_id
from service.storage.tables import ExperimentRow, JobRow
from service.uploads.child import summary
from sim import rig_file

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from drivers.controller import Controller
    from service.experiment.data import Experiment
    from sim.datasheet import Datasheet

log = logging.getLogger(__name__)
LEASE_POLL_S = 0.5
RECONNECT_S = 1.0
CONNECT_S = 10.0
"""Time that a driver has to connect in, however little patience the settings leave."""
UNHEARD_S = 5.0
"""A rotor that nobody could stop by cancelling for so long, because the database is away, is left alone until it is
back."""
STOP_NOTED_S = 2.0
"""So soon after the controller has stopped, the audit log has who asked for it over this service."""
ANEW = "submit a new job, which measures anew"
HANGS = "waiting for the worker that had the job before, which hangs: end it, or let it go on"
PURPOSES = {"experiment": "commissioning", "health": "health"}
"""What a job's experiment is for, by the job's kind."""
MEDIA_TYPE = "application/x-hdf5"


def profile_of(options: dict[str, Any]) -> Profile | MultisineProfile:
    """The plan that a job's options ask for."""
    excitation, wanted = options.get("excitation", "stepped-sine"), options.get("profile", "standard")
    if isinstance(wanted, dict):
        return MultisineProfile(**wanted) if excitation == "multisine" else Profile(**wanted)
    return bootstrap.profile_for(excitation, wanted == "quick") or Profile()


def measure(
    worker: Context,
    job: JobRow,
    control: Control,
    profile: Profile | MultisineProfile,
    share: Share = WHOLE,
    recent_s: float | None = None,
) -> dict[str, Any]:
    """Run a campaign to its end and keep its experiment; ``{"experiment": id}``.

    What was measured when the job is cancelled or fails is for `keep`. ``share`` is its part of the job's percent.
    With ``recent_s`` the campaign goes on with what it measured so long ago at most.

    Raises
    ------
    StoppedError
        Cancelled, superseded, or the worker ends.
    JobError
        The rig was retired, or the controller does not answer for longer than the patience, or was stopped by hand.
    AmbError
        The rig or the plan does not allow it.
    """
    if (whole := _measured_before(worker, job)) is not None:
        control.made(experiment=whole)
        return {"experiment": whole}
    _must_be_active(worker, job)
    version, path = datasheet_file(worker, job)
    sheet = rig_file.read(path)
    folder = worker.folder(job.id)
    _restore_journal(worker, job, folder / JOURNAL, control, control.stopped)
    run = _Campaign(
        worker, job, control, sheet, version.controller_url, profile, folder, Part(control, share), recent_s
    )
    experiment = run.to_the_end()
    kept = _kept(worker, job, folder / EXPERIMENT, experiment, complete=True)
    control.made(experiment=kept)
    return {"experiment": kept}


def keep(worker: Context, job: JobRow, control: Control) -> None:
    """Make an experiment of what a job has measured that ends before its campaign does.

    The journal has it all, also where this process measured none of it: a worker that was killed did, and the job was
    cancelled, or its rig retired, before another one went on. The journal stays, for a job that is tried again.
    """
    try:
        if (kept := _measured_before(worker, job)) is None:
            _restore_journal(
                worker, job, worker.folder(job.id) / JOURNAL, control, lambda: control.stopping or control.superseded
            )
            kept = _partial(worker, job)
    except Exception:
        log.exception("what job %s has measured is in its journal, but no experiment could be made of it", job.id)
    else:
        if kept is not None:
            control.made(experiment=kept)


class _UnheardError(Exception):
    """The database is away: ends a campaign between two points, to go on when it is back."""


@dataclass
class _Campaign:
    worker: Context
    job: JobRow
    control: Control
    sheet: Datasheet
    url: str
    profile: Profile | MultisineProfile
    folder: Path
    part: Part
    recent_s: float | None
    answered: float = 0.0
    """When the controller last answered, monotonic."""

    def to_the_end(self) -> Experiment:
        """Run the campaign, again and again while the controller is away, or rig or folder are held by another one."""
        self.answered = time.monotonic()
        while True:
            self._raise_if_stopped()
            try:
                controller = self._connected()
            except BusError as error:
                self._away(error)
                continue
            try:
                return self._run(controller)
            except LeaseError as error:
                self.answered = time.monotonic()
                self._wait_for_lease(controller, error)
            except InUseError:
                self._wait_for_folder()
            except RestartError as error:
                self._away(error)
            except BusError as error:
                self._away(error)
            except _UnheardError:
                self._wait_for_database()
            except CancelledError as error:
                if not isinstance(error, StoppedElsewhereError):
                    self._raise_if_stopped()
                raise self._stopped_elsewhere() from None
            finally:
                with suppress(Exception):
                    controller.close()

    def _connected(self) -> Controller:
        """The controller; whoever cancels meanwhile waits for no driver that does not come back."""
        connecting = aside(lambda: bootstrap.connect(self.url), "connecting")
        patience_s = max(self.worker.settings.controller_patience_s, CONNECT_S)
        try:
            while not wait([connecting], 0.1).done:
                self._raise_if_stopped()
                if time.monotonic() - self.answered > patience_s:
                    raise BusError(f"{self.url}: nothing comes of the connection; see that its address is right")
        except (StoppedError, BusError):
            connecting.add_done_callback(_close_late)
            raise
        return connecting.result()

    def _run(self, controller: Controller) -> Experiment:
        self.control.report(phase="connected")
        if too_old(self.folder / JOURNAL, self.recent_s):
            self._begin_anew()
        return run_campaign(
            AuditedController(controller, self.worker, self.job, self.control.stopped, self._silent),
            self.sheet,
            self.folder,
            self._progress,
            self.control.stopped,
            resume=True,
            profile=self.profile,
            holder=self.job.id,  # whole: devices keep 32 characters of it
            anew=ANEW,
        )

    def _begin_anew(self) -> None:
        """Go on with no point so far: they are kept as an experiment of their own, for the job makes another one."""
        try:
            kept = f"they are kept as {_kept_apart(self.worker, self.job, self.folder)}"
        except (CampaignError, JournalError) as error:
            kept = f"no experiment can be made of them: {error}"
        log.warning("the points so far are too old to go on with, and the campaign begins anew; %s", kept)
        # Before anything new is measured: the older journal is the longer one, and would be restored in its place.
        self.worker.database.surely(self._forget_journal, self.control.stopped)
        put_aside(self.folder / EXPERIMENT)
        put_aside(self.folder / JOURNAL)
        self.control.begin_journal(0)

    def _forget_journal(self, session: Session) -> None:
        mine, _ = jobs.note(session, self.job.id, self.job.attempt)
        if mine:
            jobs.drop_journal(session, self.job.id)

    def _progress(self, p: Progress) -> None:
        self.answered = time.monotonic()
        if self.control.unheard_s() > UNHEARD_S:
            raise _UnheardError
        self.part.points(p.phase, p.done, p.total, p.seconds_left or None)

    def _wait_for_database(self) -> None:
        """Until a cancellation can be heard again; the rig is free meanwhile."""
        log.warning("the rig is left alone until the database answers")
        while self.control.unheard_s() > UNHEARD_S:
            self._raise_if_stopped()
            time.sleep(0.1)
        self.answered = time.monotonic()

    def _wait_for_lease(self, controller: Controller, error: LeaseError) -> None:
        """Until the rig is free; another host's excitation is not ours to stop."""
        while True:
            self.control.report(phase=self._waiting(error))
            time.sleep(LEASE_POLL_S)
            self._raise_if_stopped()
            try:
                status = controller.status()
            except BusError:
                return
            if not status.lease_holder:
                return
            error = LeaseError(status.lease_holder, status.lease_seconds_left)

    def _wait_for_folder(self) -> None:
        """Until the worker that had the job before lets go of its files.

        It was taken for dead, but is not: it hangs. When it wakes it finds that the job is another one's, and stops
        what it excites; before that nobody shall excite the rig beside it.
        """
        log.warning("the worker that had the job before hangs, and has its files yet; they are waited for")
        while in_use(self.folder):
            self.control.report(phase=HANGS)
            time.sleep(LEASE_POLL_S)
            self._raise_if_stopped()
        self.answered = time.monotonic()

    def _waiting(self, error: LeaseError) -> str:
        """What is told of the wait; the lease may be this job's own, of the worker that it had before."""
        left = f"{error.seconds_left:.0f} s"
        if error.holder == self.job.id:
            return f"going on after a restart in {left}"
        more = f" for another {left}" if error.seconds_left else ""
        return f"waiting for the rig, which {error.holder or 'another host'} holds{more}"

    def _silent(self, error: Exception) -> None:
        """Tell that the controller is away, until the next point tells of the plan again."""
        self.control.report(phase=f"controller does not answer, waiting: {error}"[:500], time_left_s=None)

    def _away(self, error: Exception) -> None:
        silent = time.monotonic() - self.answered
        patience = self.worker.settings.controller_patience_s
        if silent > patience:
            raise JobError(
                "controller does not answer", f"{error}; waited {silent:.0f} s: see to the controller, then try again"
            ) from error
        self._silent(error)
        deadline = time.monotonic() + RECONNECT_S
        while time.monotonic() < deadline:
            self._raise_if_stopped()
            time.sleep(0.1)

    def _stopped_elsewhere(self) -> JobError:
        """Why the controller says that somebody stopped it: whom this service has done it for, if anybody.

        A service that finds the lease given back already cancels the job, too: who stopped the rig is the reason still.
        """
        began = self.job.started_at or self.job.created_at
        deadline = time.monotonic() + STOP_NOTED_S
        while True:
            told_to_end = self.control.stopped()  # before one looks: it is noted together with who stopped the rig
            stop = self.worker.database.surely(
                lambda session: audit.stop_of_rig(session, self.job.rig_id, began), self.control.stopped
            )
            if stop is not None:
                by = f"{stop.who} stopped the rig over this service at {stop.at:%Y-%m-%d %H:%M:%S} UTC"
                return JobError("rig stopped", f"{by}; see to the rig, then try again")
            if told_to_end:
                self._raise_if_stopped()
            if time.monotonic() > deadline:
                why = "the excitation was stopped by hand or by another host; see to the rig, then try again"
                return JobError("stopped at the rig", why)
            time.sleep(0.1)

    def _raise_if_stopped(self) -> None:
        if self.control.stopped():
            raise StoppedError("the job was stopped; the excitation is off")


def _close_late(connecting: Future[Controller]) -> None:
    """Give up a connection that came when nobody waited for it any more."""
    if connecting.exception() is None:
        with suppress(Exception):
            connecting.result().close()


def _must_be_active(worker: Context, job: JobRow) -> None:
    """A job that was submitted while its rig was retired is not among those that the retirement cancelled."""
    with worker.database.read() as session:
        try:
            rigs.active(session, job.rig_id)
        except ConflictError as error:
            raise JobError("rig retired", str(error)) from error


def _measured_before(worker: Context, job: JobRow) -> str | None:
    """The whole experiment of an earlier run, of which only what came after failed."""
    with worker.database.read() as session:
        row = session.get(ExperimentRow, derived_id("exp", job.id))
    return row.id if row is not None and row.complete else None


def _restore_journal(worker: Context, job: JobRow, path: Path, control: Control, given_up: Callable[[], bool]) -> None:
    """The longer one of this machine's journal and the database's: what was begun elsewhere goes on here.

    Of both only whole lines count: what a machine that died had written of a point is measured again, in other bytes.
    """
    sent = worker.database.surely(lambda session: jobs.journal(session, job.id), given_up)
    content = path.read_bytes() if path.exists() else b""
    kept, local = sent[: entries(sent)[1]], content[: entries(content)[1]]
    if cut := len(sent) - len(kept):
        log.warning("the journal of %s was cut short: %d bytes at its end are no whole point", job.id, cut)
    if len(kept) > len(local):
        path.write_bytes(kept)
        local = kept
    elif len(content) > len(local) and (local or b"\n" not in content):  # else no journal at all: the campaign says so
        os.truncate(path, len(local))  # before it is kept from here on: other bytes will stand there
    control.begin_journal(len(kept) if local[: len(kept)] == kept else 0)


def _partial(worker: Context, job: JobRow) -> str | None:
    """The experiment of a campaign that did not end; None where it has no point yet."""
    from service.experiment import file

    folder = worker.folder(job.id)
    path = folder / EXPERIMENT
    if (folder / JOURNAL).exists() and not has_all(folder):
        try:
            recover_into_file(folder)
        except CampaignError as error:
            log.info("no experiment is made of what %s has measured: %s", job.id, error)
        except Exception:  # then what its file has is what there is
            log.exception("no experiment can be made of the journal of %s", job.id)
    return _kept(worker, job, path, file.read(path), complete=False) if path.exists() else None


def _kept_apart(worker: Context, job: JobRow, folder: Path) -> str:
    path, experiment = recover_into_file(folder)
    row = _row(worker, job, path, experiment, complete=False)
    row.id, row.job_id, row.created_at = new_id("exp"), None, began(folder / JOURNAL) or row.created_at
    worker.database.surely(lambda session: results.keep(session, row))
    return row.id


def _kept(worker: Context, job: JobRow, path: Path, experiment: Experiment, complete: bool) -> str:
    row = _row(worker, job, path, experiment, complete)
    worker.database.surely(lambda session: results.keep(session, row))
    return row.id


def _row(worker: Context, job: JobRow, path: Path, experiment: Experiment, complete: bool) -> ExperimentRow:
    return ExperimentRow(
        id=derived_id("exp", job.id),
        rig_id=job.rig_id,
        rig_version=job.rig_version,
        job_id=job.id,
        source="measured",
        purpose=PURPOSES[job.kind],
        complete=complete,
        file_sha256=worker.blobs.put_file(path),
        file_bytes=path.stat().st_size,
        media_type=MEDIA_TYPE,
        file_name=EXPERIMENT,
        summary=summary("HDF5", experiment),
        created_at=now(),
        created_by=job.submitted_by,
    )
