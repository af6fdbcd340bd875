"""The automated experiment: runs the plan on a controller. The only module of this package that moves a rotor."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from typing import Any, TypeVar

from drivers.controller import (
    Capabilities,
    Controller,
    PeriodicController,
    PointResult,
    State,
    Tone,
    TripCause,
    Waveform,
    WaveformResult,
)
from drivers.errors import BusError, CancelledError, ControllerError, LeaseError, TripError
from service.experiment import file, journal, multisine_plan, phases
from service.experiment.aims import Limits, Profile
from service.experiment.data import Experiment
from service.experiment.errors import CampaignError, ExperimentFileError, JournalError
from service.experiment.multisine_phases import MultisinePhases
from service.experiment.multisine_plan import MultisineProfile, PeriodicRequest
from service.experiment.plan import Request
from service.experiment.points import Point, experiment
from service.experiment.predecessor import holds_all, make_way, put_aside
from service.experiment.progress import Meter, ProgressCallback
from service.experiment.recorder import Recorder, Trip
from sim.datasheet import Datasheet
from sim.rig_file import parse, to_toml

T = TypeVar("T")

EXPERIMENT = "experiment.h5"
JOURNAL = "experiment.journal"
_Done = dict[str, list[Point]]
_Extra = dict[str, str]
WATCH_S = 0.1
BUS_TRIES = 6
"""With a pause that doubles from 0.1 s, a bus has three seconds to come back."""
FIRST_PAUSE_S = 0.1


def run_campaign(
    controller: Controller,
    datasheet: Datasheet,
    out_dir: Path,
    progress: ProgressCallback | None = None,
    cancelled: Callable[[], bool] | None = None,
    resume: bool = True,
    profile: Profile | MultisineProfile | None = None,
    holder: str = "",
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
        Called after every point.
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

    Returns
    -------
    experiment
        Sweeps "main", "validation", "amplifier", "noise", "preliminary"; the last not with multisines.

    Raises
    ------
    ExperimentFileError
        ``out_dir`` cannot be written; nothing has moved.
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
    prepare_folder(out_dir, resume)
    speed = float(controller.status().speed_rad_s)
    about = {"speed_rad_s": speed, "datasheet": to_toml(datasheet)}
    header = fingerprint(capabilities, datasheet, limits, profile) | {"about": about}
    log = journal.Journal(out_dir / JOURNAL, header)
    meter = Meter(progress)
    done: _Done = {}
    extra: _Extra = {}

    def assembled() -> Experiment:
        attributes = {"controller": capabilities.identity, "rig_seconds": f"{meter.rig_seconds:.3f}"}
        return experiment(
            datasheet.name,
            capabilities.axes,
            done,
            capabilities.harmonics,
            capabilities.sample_rate_hz,
            speed,
            attributes | extra,
        )

    try:
        with controller.lease(holder or alone("ambit campaign")), _stopped_by(controller, cancelled):
            _make_ready(controller)
            measure = _Patient(controller, cancelled or (lambda: False))
            recorder = Recorder(measure, log.found, log.append, capabilities.sample_rate_hz, capabilities.harmonics)
            _run(recorder, limits, profile, capabilities.raw_records, meter, done, extra, datasheet, speed)
        result = assembled()
        make_way(out_dir / EXPERIMENT, result)
        file.write(out_dir / EXPERIMENT, result)
    except BaseException as error:
        if not isinstance(error, LeaseError):  # what another host excites is not ours to stop
            with suppress(Exception):  # the first error is the one to tell
                controller.stop()
        kept = _keep(out_dir / EXPERIMENT, assembled)
        log.close()
        if isinstance(error, KeyboardInterrupt | CancelledError):
            raise CancelledError(
                f"the campaign was stopped and the excitation is off; {kept} points are kept in {out_dir}: "
                "run it again to go on where it stopped"
            ) from None
        raise
    log.close()
    (out_dir / JOURNAL).unlink(missing_ok=True)
    return result


def alone(name: str) -> str:
    """A holder's name of its own for each call: devices tell hosts by their names."""
    return f"{name} {token_hex(3)}"


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
        limits, profile = Limits(**header["limits"]), _profile(header["profile"])
        harmonics, about = tuple(header["harmonics"]), header["about"]
        datasheet = parse(about["datasheet"]) if "datasheet" in about else None
    except (KeyError, TypeError) as error:
        raise JournalError(f"{out_dir / JOURNAL} was written by another version: {error}; resume with that") from error
    recorder = Recorder(measure, entries, lambda _: None, limits.sample_rate_hz, harmonics)
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
    attributes = {"controller": header["controller"], "rig_seconds": f"{recorder.rig_seconds:.3f}"}
    return experiment(
        header["rig"],
        tuple(header["axes"]),
        done,
        harmonics,
        limits.sample_rate_hz,
        about["speed_rad_s"],
        attributes | extra,
    )


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
        MultisinePhases(recorder, limits, profile, meter, done, extra, datasheet, speed_rad_s).run(raw_records)
    else:
        phases.run(recorder, limits, profile, raw_records, meter, done)


def _profile(document: dict[str, Any]) -> Profile | MultisineProfile:
    """The profile that a journal keeps; TypeError when another version wrote it."""
    if "multisine" in document:
        return MultisineProfile(**document["multisine"])
    return Profile(**document)


def checked_limits(capabilities: Capabilities, datasheet: Datasheet) -> Limits:
    """Limits of controller and datasheet together.

    Raises
    ------
    CampaignError
        They describe different rigs.
    """
    c = capabilities
    if tuple(c.axes) != datasheet.axes:
        raise CampaignError(
            f"the controller has axes {', '.join(c.axes)}, the datasheet {datasheet.name} has "
            f"{', '.join(datasheet.axes)}; give the datasheet of this rig"
        )
    if abs(c.sample_rate_hz * datasheet.sample_time_s - 1) > 1e-6:
        raise CampaignError(
            f"the controller samples at {c.sample_rate_hz:g} Hz, the datasheet {datasheet.name} says "
            f"{datasheet.sample_rate_hz:g} Hz; correct controller.sample_time_s"
        )
    return Limits.of(
        datasheet,
        c.sample_rate_hz,
        c.max_frequency_hz,
        c.max_samples,
        c.max_amplitude_a,
        c.displacement_limit_m,
        c.current_limit_a,
    )


def prepare_folder(out_dir: Path, resume: bool) -> None:
    """Make the folder, prove that it can be written, and put an old journal aside unless it shall be resumed.

    Raises
    ------
    ExperimentFileError
        It cannot be written.
    """
    probe = out_dir / f".write-test.{os.getpid()}"
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"x")
        probe.unlink()
    except OSError as error:
        raise ExperimentFileError(
            f"cannot write to {out_dir}: {error.strerror or error}; nothing has moved: choose another folder"
        ) from error
    if not resume:
        put_aside(out_dir / JOURNAL)


def fingerprint(
    capabilities: Capabilities, datasheet: Datasheet, limits: Limits, profile: Profile | MultisineProfile
) -> journal.Entry:
    """What must be the same for a journal to be continued."""
    return {
        "rig": datasheet.name,
        "controller": capabilities.identity,
        "axes": list(capabilities.axes),
        "harmonics": list(capabilities.harmonics),
        "raw_records": capabilities.raw_records,
        "limits": asdict(limits),
        "datasheet_sha256": sha256(to_toml(datasheet).encode()).hexdigest(),
        "profile": multisine_plan.documented(profile) if isinstance(profile, MultisineProfile) else asdict(profile),
    }


class _Patient:
    """Plays tones on a leased controller, and gives a failing bus time to come back."""

    def __init__(self, controller: Controller, cancelled: Callable[[], bool]) -> None:
        self._controller = controller
        self._cancelled = cancelled

    def __call__(self, request: Request | PeriodicRequest) -> PointResult | WaveformResult | Trip:
        """One tone or waveform, or how it tripped; the trip is acknowledged."""
        play = self._player(request)
        for attempt in range(BUS_TRIES):
            if self._cancelled():
                raise CancelledError("the campaign was cancelled; the excitation is off")
            try:
                return self._through(play)
            except TripError as trip:
                self._through(self._controller.acknowledge)
                if trip.cause != "host":
                    return Trip(trip.cause, str(trip))
                # a watchdog that tripped says something of the bus, not of the tone
                if attempt == BUS_TRIES - 1:
                    raise
        raise AssertionError("the last attempt returns or raises")

    def _player(self, request: Request | PeriodicRequest) -> Callable[[], PointResult | WaveformResult]:
        """What plays the request."""
        if isinstance(request, Request):
            tone = Tone(**asdict(request))
            return lambda: self._controller.measure(tone)
        waveform = Waveform(request.waveform_a, request.periods, request.settle_samples)
        controller = self._controller
        if not isinstance(controller, PeriodicController):
            raise CampaignError("the controller plays no periodic waveforms although its capabilities promise them")
        return lambda: controller.measure_periodic(waveform)

    def _through(self, call: Callable[[], T]) -> T:
        """Result of a call over the bus, tried again while the bus fails."""
        pause = FIRST_PAUSE_S
        for _ in range(BUS_TRIES - 1):
            try:
                return call()
            except BusError:
                time.sleep(pause)
                pause *= 2
        return call()


def _make_ready(controller: Controller) -> None:
    """Refuse a rig that is off or tripped; the trip of a host that went away, as a killed run does, is acknowledged."""
    status = controller.status()
    if status.state == State.TRIPPED:
        if status.trip != TripCause.HOST:
            raise CampaignError(
                f"the controller is tripped ({status.trip_message}); find the cause and acknowledge it first"
            )
        controller.acknowledge()
    if status.state == State.OFF:
        raise CampaignError("the rotor does not levitate: the controller is off; switch it on first")


@contextmanager
def _stopped_by(controller: Controller, cancelled: Callable[[], bool] | None) -> Iterator[None]:
    """Watch ``cancelled`` from another thread and, once it is true, say stop until the campaign has ended.

    Said once, it might come just before the next tone begins, or be lost on the bus.
    """
    if cancelled is None:
        yield
        return
    over = threading.Event()

    def watch() -> None:
        while not over.wait(WATCH_S):
            if cancelled():
                with suppress(ControllerError):
                    controller.stop()

    thread = threading.Thread(target=watch, name="campaign-watch", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _keep(path: Path, assembled: Callable[[], Experiment]) -> int:
    """Write what there is of an unfinished campaign; the number of points kept. Never hides the first error."""
    partial = assembled()
    count = sum(s.n_points for s in partial.sweeps)
    if any(s.kind != "noise" for s in partial.sweeps) and not holds_all(path, partial):
        with suppress(ExperimentFileError, OSError):
            make_way(path, partial)
            file.write(path, partial)
    return count
