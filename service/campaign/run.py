"""Runs the plan of an experiment on a controller. With `leased`, the only module here that moves a rotor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from drivers.controller import (
    Controller,
)
from drivers.errors import CancelledError, ControllerError, LeaseError, StoppedElsewhereError
from service.campaign import journal, phases
from service.campaign.aims import Limits, Profile
from service.campaign.beginning import checked_limits, fingerprint, profile_of, speed_now, speed_of
from service.campaign.leased import Patient, alone, make_ready, stopped_by
from service.campaign.multisine.plan import MultisineProfile, PeriodicRequest
from service.campaign.plan import Request
from service.campaign.points import Point, experiment
from service.campaign.predecessor import holds_all, make_way, put_aside, too_old
from service.campaign.progress import Meter, ProgressCallback
from service.campaign.recorder import Recorder, Trip
from service.errors import InUseError
from service.exclusive import sole_use
from service.experiment import file
from service.experiment.data import Experiment
from service.experiment.errors import CampaignError, JournalError
from service.experiment.incomplete import INCOMPLETE
from service.experiment.speeds import SPEED_CHANGED, impossible, same
from service.output import ready_folder
from sim.datasheet import Datasheet
from sim.rig_file import parse, to_toml

EXPERIMENT = "experiment.h5"
JOURNAL = "experiment.journal"
LOCK = ".experiment.in-use"
"""Of the folder, while a campaign writes there."""
RIG_SECONDS = "rig_seconds"
"""Attribute of an experiment: the rig's time at its last point, s."""
OLDER = "recover it with the version that wrote it"
ANOTHER, ELSEWHERE = "another campaign", "wait for its end, or choose another folder"
_Done = dict[str, list[Point]]
_Extra = dict[str, str]


def run_campaign(
    controller: Controller,
    datasheet: Datasheet,
    out_dir: Path,
    progress: ProgressCallback | None = None,
    cancelled: Callable[[], bool] | None = None,
    resume: bool = True,
    profile: Profile | MultisineProfile | None = None,
    holder: str = "",
    recent_s: float | None = None,
    anew: str = journal.ANEW,
) -> Experiment:
    """Run the whole experiment on a controller and write ``out_dir/experiment.h5``.

    Parameters
    ----------
    controller
        Any driver. Leased for as long as this runs.
    datasheet
        Of the rig: limits, linear range, bias current.
    out_dir
        Made when it does not exist. Every finished point is on disk there, in ``experiment.journal``, before the
        next one begins; the journal is removed when experiment.h5 is complete.
    progress
        Called after every point, and before a record for which one waits.
    cancelled
        Polled some ten times a second, from another thread; True ends the campaign.
    resume
        Go on with a journal that lies in ``out_dir``; otherwise it is put aside and the campaign starts anew.
    profile
        What to reach, and by which excitation: a `Profile` for stepped sine, the default, which suits the reference
        rig; a `MultisineProfile` for multisines on all axes at once, where the controller can play them.
    holder
        Name under which the rig is leased; a further campaign of the same name, as a job that is taken over, hears of
        stops that this one did not. Empty for one of this campaign alone.
    recent_s
        A journal that began longer ago is put aside, too; None goes on with one of any age.
    anew
        What the caller can do about a journal that this campaign cannot go on with, as the error tells it.

    Returns
    -------
    experiment
        Sweeps "main", "validation", "amplifier", "noise", "preliminary"; the last not with multisines.

    Raises
    ------
    OutputError
        ``out_dir`` cannot be written; nothing has moved.
    InUseError
        Another campaign writes in ``out_dir``; nothing has moved.
    CampaignError
        The controller does not fit the datasheet, cannot play the excitation, or is tripped.
    JournalError
        A journal in ``out_dir`` is of another rig or plan.
    CancelledError
        Cancelled or interrupted from the keyboard. The rig is stopped, ``experiment.h5`` has what was measured, and
        the journal what is needed to resume.
    ControllerError
        The controller failed for good; what was measured is kept in the same way.
    """
    profile = profile or Profile()
    capabilities = controller.capabilities()
    limits = checked_limits(capabilities, datasheet)
    if isinstance(profile, MultisineProfile) and not capabilities.periodic:
        raise CampaignError(
            f"{capabilities.identity} plays tones only, no periodic waveforms; measure it by stepped sine"
        )
    ready_folder(out_dir)
    speed = speed_now(controller)
    about = {journal.BEGAN: datetime.now(UTC).isoformat(), "speed_rad_s": speed, "datasheet": to_toml(datasheet)}
    header = fingerprint(capabilities, datasheet, limits, profile) | {"about": about}
    log: journal.Journal | None = None
    meter = Meter(progress, record_wait_s=capabilities.record_wait_s)
    done: _Done = {}
    extra: _Extra = {}

    def assembled() -> Experiment:
        attributes = {"controller": capabilities.identity, RIG_SECONDS: f"{meter.rig_seconds:.3f}"}
        return experiment(
            datasheet.name,
            capabilities.axes,
            done,
            capabilities.harmonics,
            capabilities.sample_rate_hz,
            speed,
            attributes | extra,
        )

    with ExitStack() as folder:  # until the journal is gone or closed, which is after the rig is given back
        try:
            with controller.lease(holder or alone("ambit campaign")), stopped_by(controller, cancelled):
                # whoever holds the rig writes here, and nobody else, not even one who holds another rig
                folder.enter_context(sole_use(out_dir, ANOTHER, ELSEWHERE, LOCK))
                if not resume or too_old(out_dir / JOURNAL, recent_s):
                    put_aside(out_dir / JOURNAL)
                opened = journal.Journal(out_dir / JOURNAL, header, anew)
                try:
                    speed = speed_of(opened.header, speed, anew)
                    profile = profile_of(opened.header["profile"])  # to the last digit of whoever began it
                except JournalError:
                    opened.close()
                    raise
                log = opened
                with _quiet_on_failure(controller):
                    make_ready(controller)
                    measure = Patient(controller, cancelled or (lambda: False))
                    recorder = Recorder(
                        measure,
                        log.found,
                        log.append,
                        capabilities.sample_rate_hz,
                        capabilities.harmonics,
                        lambda: _speed_now(controller),
                        anew,
                    )
                    _run(recorder, limits, profile, capabilities.raw_records, meter, done, extra, datasheet, speed)
                    extra |= _changed_speed(controller, speed)
            result = assembled()
            make_way(out_dir / EXPERIMENT, result)
            file.write(out_dir / EXPERIMENT, result)
        except BaseException as error:
            if log is None and not isinstance(error, KeyboardInterrupt | CancelledError):
                raise  # nothing was begun
            extra[INCOMPLETE] = str(error) or "stopped from the keyboard"
            kept = _keep(out_dir / EXPERIMENT, assembled, 0 if log is None else log.count)
            if log is not None:
                log.close()
            if isinstance(error, KeyboardInterrupt | CancelledError):
                kind = StoppedElsewhereError if isinstance(error, StoppedElsewhereError) else CancelledError
                raise kind(
                    f"the campaign was stopped and the excitation is off; {kept}: run it again to go on where it "
                    "stopped"
                ) from None
            raise
        log.close()
        (out_dir / JOURNAL).unlink(missing_ok=True)
    return result


def in_use(out_dir: Path) -> bool:
    """Whether a campaign is at work in a folder, be it one that hangs."""
    try:
        with sole_use(out_dir, ANOTHER, ELSEWHERE, LOCK):
            return False
    except InUseError:
        return True


def _speed_now(controller: Controller) -> float | None:
    """At which the rotor turns; None where the controller tells none that can be: what is measured next tells that."""
    try:
        speed_rad_s = float(controller.status().speed_rad_s)
        return None if impossible(speed_rad_s) else speed_rad_s
    except ControllerError:
        return None


def _changed_speed(controller: Controller, speed_rad_s: float) -> _Extra:
    """What the file says of a rotor that turns otherwise than when the campaign began."""
    now = _speed_now(controller)
    return (
        {} if now is None or same(speed_rad_s, now) else {SPEED_CHANGED: f"from {speed_rad_s:.4g} to {now:.4g} rad/s"}
    )


@contextmanager
def _quiet_on_failure(controller: Controller) -> Iterator[None]:
    """Stop the rig when what is done under its lease fails: once that is given back, another host may excite it."""
    try:
        yield
    except LeaseError:
        raise  # what another host excites is not ours to stop
    except BaseException:
        with suppress(Exception):  # the first error is the one to tell
            controller.stop()
        raise


class _EndOfJournal(Exception):
    """The way out of a replay: nothing more was measured."""


def recover(out_dir: Path) -> Experiment:
    """What the journal of an interrupted campaign holds, without a controller.

    Raises
    ------
    JournalError
        There is no journal in ``out_dir``, or it cannot be read.
    """
    header, entries = journal.read(out_dir / JOURNAL)

    def measure(_: Request | PeriodicRequest) -> Trip:
        raise _EndOfJournal

    try:
        limits, profile = Limits(**header["limits"]), profile_of(header["profile"])
        harmonics, about = tuple(header["harmonics"]), header["about"]
        datasheet = parse(about["datasheet"]) if "datasheet" in about else None
    except (KeyError, TypeError) as error:
        raise JournalError(f"{out_dir / JOURNAL} was written by another version: {error}; resume with that") from error
    recorder = Recorder(measure, entries, lambda _: None, limits.sample_rate_hz, harmonics, anew=OLDER)
    done: _Done = {}
    extra: _Extra = {}
    with suppress(_EndOfJournal, CampaignError):
        _run(
            recorder,
            limits,
            profile,
            header["raw_records"],
            Meter(None),
            done,
            extra,
            datasheet,
            about["speed_rad_s"],
        )
    attributes = {"controller": header["controller"], RIG_SECONDS: f"{recorder.rig_seconds:.3f}"}
    attributes[INCOMPLETE] = "the campaign was interrupted"
    return experiment(
        header["rig"],
        tuple(header["axes"]),
        done,
        harmonics,
        limits.sample_rate_hz,
        about["speed_rad_s"],
        attributes | extra,
    )


def recover_into_file(out_dir: Path) -> tuple[Path, Experiment]:
    """``out_dir/experiment.h5`` of what the journal there holds, which stays, and the experiment.

    A file that holds all of it, and perhaps more, is left as it is; one of another campaign is put aside. A campaign
    that ended has no journal any more, and its file is what there is.

    Raises
    ------
    JournalError
        As of `recover`.
    CampaignError
        No point was measured yet.
    ExperimentFileError
        The file of a campaign that ended cannot be read.
    """
    path = out_dir / EXPERIMENT
    if path.exists() and not (out_dir / JOURNAL).exists():
        return path, file.read(path)
    found = recover(out_dir)
    if not _write(path, found):
        raise CampaignError(f"{out_dir / JOURNAL} holds no excited point yet; run the campaign again")
    return path, found


def has_all(out_dir: Path) -> bool:
    """Whether the file of a campaign that did not end has all that its journal has, by the time of the last point.

    Told at once, where to replay a journal may take many seconds. Both are of one campaign.

    Raises
    ------
    ExperimentFileError, JournalError
        One of them cannot be read.
    """
    if not (out_dir / EXPERIMENT).exists():
        return False
    told_s = float(file.read(out_dir / EXPERIMENT).attributes.get(RIG_SECONDS, "-inf"))
    return all(entry["time_s"] <= told_s + 1e-3 for entry in journal.read(out_dir / JOURNAL)[1][-1:])


def _run(
    recorder: Recorder,
    limits: Limits,
    profile: Profile | MultisineProfile,
    raw_records: bool,
    meter: Meter,
    done: _Done,
    extra: _Extra,
    datasheet: Datasheet | None,
    speed_rad_s: float,
) -> None:
    """All phases of the excitation that the profile is for."""
    if isinstance(profile, MultisineProfile):
        from service.campaign.multisine.phases import MultisinePhases  # they identify; stepped sines never do

        MultisinePhases(recorder, limits, profile, meter, done, extra, datasheet, speed_rad_s).run(raw_records)
    else:
        phases.run(recorder, limits, profile, raw_records, meter, done)


def _keep(path: Path, assembled: Callable[[], Experiment], measured: int) -> str:
    """Write what there is of an unfinished campaign, and tell what is kept. Never hides the first error.

    ``measured`` entries are in the journal, whether a file can be made of them or not.
    """
    if not measured:
        return "nothing was measured yet"
    try:
        partial = assembled()
        _write(path, partial)
    except Exception as error:  # the journal has all of it
        return (
            f"{measured} measurements are kept in the journal, {path.with_name(JOURNAL)}, and no {path.name} could be "
            f"made of them ({str(error) or type(error).__name__})"
        )
    return f"{sum(s.n_points for s in partial.sweeps)} points are kept in {path.parent}"


def _write(path: Path, partial: Experiment) -> bool:
    """Write an experiment that did not end, unless its file holds all of it; whether there is a point in it."""
    if not any(s.kind != "noise" for s in partial.sweeps):
        return False
    if not holds_all(path, partial):
        make_way(path, partial)
        file.write(path, partial)
    return True
