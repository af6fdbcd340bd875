"""Jobs: submit, watch, wait, cancel, try again."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from typing import Any

import httpx

from service.client.errors import ApiError, JobEndedError, JobGoesOnError, MissingError, UnreachableError
from service.client.shapes import Event, Job, Kind
from service.client.transport import Transport

SILENCE_S = 60.0
"""The service sends a sign of life every 15 s; a connection that is silent for so long is dead."""


class Jobs:
    """Jobs of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def submit(
        self,
        kind: Kind,
        rig: str,
        experiment: str | None = None,
        options: dict[str, Any] | None = None,
        priority: int = 5,
    ) -> Job:
        """Submit a job.

        Parameters
        ----------
        kind
            experiment and health move the rotor; identification and gap work on ``experiment``.
        rig
            Id.
        experiment
            Id.
        options
            As the service documents them for the kind.
        priority
            1 first, 9 last.

        Raises
        ------
        RefusedError, ConflictingError, MissingError
            The job cannot be done; says why.
        """
        body = {"kind": kind, "rig": rig, "experiment": experiment, "options": options or {}, "priority": priority}
        return Job.model_validate(self._transport.post("/jobs", body))

    def get(self, job_id: str) -> Job:
        """A job as it is now."""
        return Job.model_validate(self._transport.get(_path(job_id)))

    def list(
        self, state: str | None = None, kind: Kind | None = None, rig: str | None = None, newest: bool | None = None
    ) -> Iterator[Job]:
        """Jobs, newest first; with ``newest`` one of each rig, of that state and kind: which ended last."""
        return self._transport.pages("/jobs", Job.model_validate, state=state, kind=kind, rig=rig, newest=newest)

    def cancel(self, job_id: str) -> Job:
        """Cancel a job: an excitation ends within a second, and what was measured is kept."""
        return Job.model_validate(self._transport.post(_path(job_id) + "/cancel"))

    def retry(self, job_id: str) -> Job:
        """Try a job again that failed or was cancelled."""
        return Job.model_validate(self._transport.post(_path(job_id) + "/retry"))

    def events(self, job_id: str) -> Iterator[Event]:
        """Every change of a job until it has ended; a connection that breaks is taken up again.

        Raises
        ------
        UnreachableError
            The service is away for longer than the client's patience.
        """
        last, state = "", ""
        patience = self._transport.patience()
        while True:
            headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": last} if last else {})
            try:
                with self._transport.stream(_path(job_id) + "/events", headers, SILENCE_S) as response:
                    for event in _events(response):
                        again = event.id == last and event.job.state == state
                        last, state = event.id, event.job.state
                        patience.renew()
                        if not again:
                            yield event
                        if event.job.ended:
                            return
            except (UnreachableError, ApiError) as error:
                patience.wait(error)
            else:
                patience.pause()

    def watch(self, job_id: str) -> Iterator[Job]:
        """The job at every change, until it has ended."""
        return (event.job for event in self.events(job_id))

    def wait(self, job_id: str, timeout_s: float | None = None) -> Job:
        """The job once it is done.

        Raises
        ------
        JobEndedError
            It failed or was cancelled; says why.
        TimeoutError
            It goes on for longer; it is not cancelled.
        """
        began = time.monotonic()
        job = None
        for job in self.watch(job_id):
            if timeout_s is not None and not job.ended and time.monotonic() - began > timeout_s:
                raise TimeoutError(f"the job {job_id} is {job.state} after {timeout_s:g} s; it goes on")
        assert job is not None
        return must_be_done(job)


def must_be_done(job: Job) -> Job:
    """The job, if it is done.

    Raises
    ------
    JobEndedError
        It failed or was cancelled.
    JobGoesOnError
        It waits or runs.
    """
    if job.state == "done":
        return job
    if not job.ended:
        raise JobGoesOnError(f"the job {job.id} is still {job.state}; wait for it with: ambit watch {job.id}", job)
    told = (job.why_cancelled,) if job.error is None else (job.error.title, job.error.detail)
    why = "".join(f": {text}" for text in told if text)
    raise JobEndedError(f"the job {job.id} {'was cancelled' if job.state == 'cancelled' else job.state}{why}", job)


def _path(job_id: str) -> str:
    """Path of a job; what is no word, as an id that a script left empty, would be another address."""
    if not re.fullmatch(r"\w+", job_id, re.ASCII):
        raise MissingError(404, f"there is no job {job_id!r}; list them with ambit jobs", [], "")
    return f"/jobs/{job_id}"


def _events(response: httpx.Response) -> Iterator[Event]:
    """Server-sent events of a response."""
    fields: dict[str, str] = {}
    for line in response.iter_lines():
        if line:
            name, _, value = line.partition(":")
            value = value.removeprefix(" ")
            fields[name] = f"{fields[name]}\n{value}" if name == "data" and name in fields else value
            continue
        if "data" in fields:
            job = Job.model_validate(json.loads(fields["data"]))
            yield Event(kind=fields.get("event", "message"), id=fields.get("id", ""), job=job)
        fields = {}
