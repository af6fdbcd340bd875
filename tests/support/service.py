"""The service as processes of its own: API and workers that can be killed for real, and rigs on Modbus for them."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from tests.support.processes import ENVIRONMENT, ROOT, read_events

AMBIT = [str(Path(sys.executable).with_name("ambit"))]
QUICK = {
    "accuracy": 0.01,
    "points": 12,
    "validation_points": 4,
    "amplifier_points": 5,
    "coarse_points": 8,
    "blocks": 4,
    "rig_seconds": 30,
    "peak_points": 2,
}
"""A plan that a simulated rig does in a few seconds."""
SLOW = {**QUICK, "points": 30, "rig_seconds": 55}
"""A plan that leaves time to interrupt it."""
ENDED = ("done", "failed", "cancelled")


class Running:
    """A command that runs; its stdout is read line by line, its stderr is kept in a file."""

    def __init__(self, log: Path, *arguments: object, environment: dict[str, str] | None = None) -> None:
        self.arguments = [*AMBIT, *map(str, arguments)]
        self.log = log
        self._environment = {
            **ENVIRONMENT,
            "AMBIT_LOG_FORMAT": "json",
            **(environment or {}),
        }
        self.start()

    def start(self) -> None:
        """Start it, again after it was killed; returns when it has said its first line."""
        self._close_pipe()
        with self.log.open("ab") as errors:
            self.process = subprocess.Popen(
                self.arguments, stdout=subprocess.PIPE, stderr=errors, text=True, env=self._environment, cwd=ROOT
            )
        assert self.process.stdout is not None
        self.said = self.process.stdout.readline().strip()
        if not self.said:
            self.end()
            raise RuntimeError(f"{self.arguments} said nothing: {self.log.read_text()[-2000:]}")

    def kill(self) -> None:
        """kill -9, and wait for the end."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(20)

    def interrupt(self) -> int:
        """SIGTERM; the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(30)

    def end(self) -> None:
        """End it in good order if it still runs, else by force, and reap."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._close_pipe()

    def _close_pipe(self) -> None:
        process = getattr(self, "process", None)
        if process is not None and process.stdout is not None:
            process.stdout.close()


@dataclass
class Rig:
    """A simulated rig as a device process."""

    device: Running
    url: str
    events_file: Path

    def events(self) -> list[dict[str, Any]]:
        """What happened at the device."""
        return read_events(self.events_file)

    def status(self) -> Any:
        """Status of the controller, asked directly."""
        from drivers.url import connect

        controller = connect(self.url)
        try:
            return controller.status()
        finally:
            controller.close()


@dataclass
class Service:
    """An API, and its client."""

    home: Path
    environment: dict[str, str] = field(default_factory=dict)
    flags: tuple[str, ...] = ()
    workers: dict[str, Running] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.home.mkdir(parents=True, exist_ok=True)
        self.api = Running(
            self.home / "api.log",
            "serve",
            "--home",
            self.home,
            *(self.flags if "--port" in self.flags else ("--port", 0, *self.flags)),
            environment=self.environment,
        )
        self.client = httpx.Client(base_url=self.api.said, timeout=30)

    def worker(self, name: str) -> Running:
        """A worker beside."""
        log = self.home / f"{name}.log"
        words = ("worker", "--home", self.home, "--name", name)
        started = Running(log, *words, environment=self.environment)
        self.workers[name] = started
        return started

    def end(self) -> None:
        """End everything."""
        self.client.close()
        for worker in self.workers.values():
            worker.end()
        self.api.end()

    # ---- shorthand

    def get(self, path: str, **more: Any) -> Any:
        """Body of a GET that must succeed."""
        answer = self.client.get(f"/api/v1{path}", **more)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: Any = None, **more: Any) -> Any:
        """Body of a POST that must succeed."""
        answer = self.client.post(f"/api/v1{path}", json=body, **more)
        assert answer.status_code in (201, 202), answer.text
        return answer.json()

    def add_rig(self, datasheet: str, url: str = "", name: str | None = None) -> str:
        """Id of a new rig."""
        return str(self.post("/rigs", {"datasheet": datasheet, "controller_url": url, "name": name})["id"])

    def upload(self, rig: str, path: Path) -> str:
        """Id of an uploaded experiment."""
        answer = self.client.post(
            f"/api/v1/rigs/{rig}/experiments",
            content=path.read_bytes(),
            params={"filename": path.name},
            headers={"content-type": "application/x-hdf5"},
        )
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    def submit(self, kind: str, rig: str, **more: Any) -> str:
        """Id of a new job."""
        return str(self.post("/jobs", {"kind": kind, "rig": rig, **more})["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        """A job now."""
        return dict(self.get(f"/jobs/{job_id}"))

    def wait(self, job_id: str, until: Callable[[dict[str, Any]], bool] | None = None, s: float = 60) -> dict[str, Any]:
        """A job when it has ended, or as soon as something is true of it."""
        deadline = time.monotonic() + s
        while True:
            try:
                job = self.job(job_id)
            except httpx.TransportError:  # the API is being killed
                job = {"state": "unknown", "progress": {"point": 0, "phase": ""}}
            if (until or (lambda j: j["state"] in ENDED))(job):
                return job
            if until is not None and job["state"] in ENDED:
                raise AssertionError(f"the job ended first: {job}")
            if time.monotonic() > deadline:
                raise AssertionError(f"the job is still {job}: {self.logs()[-3000:]}")
            time.sleep(0.1)  # answering takes from what is waited for

    def done(self, job_id: str, s: float = 60) -> dict[str, Any]:
        """A job that must end well."""
        job = self.wait(job_id, s=s)
        assert job["state"] == "done", (job, self.logs()[-3000:])
        return job

    def logs(self) -> str:
        """What API and workers said."""
        return "".join(path.read_text() for path in sorted(self.home.glob("*.log")))


def rig_device(folder: Path, name: str = "rig", *options: str) -> Rig:
    """A simulated rig on Modbus TCP."""
    folder.mkdir(parents=True, exist_ok=True)
    events = folder / f"{name}.events.jsonl"
    events.touch()
    arguments = ("rig", "serve", "--protocol", "modbus", "--events", events, *options)
    device = Running(folder / f"{name}.device.log", *arguments)
    return Rig(device, device.said, events)


def free_port() -> int:
    """A port that is free now."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def reference_sheet() -> str:
    """Datasheet of the reference rig."""
    from sim.reference import reference_datasheet
    from sim.rig_file import to_toml

    return to_toml(reference_datasheet())


@contextmanager
def service(home: Path, database: str = "sqlite", *flags: str, **settings: object) -> Iterator[Service]:
    """A service on SQLite or PostgreSQL, ended at the end."""
    with ExitStack() as stack:
        environment = {f"AMBIT_{k.upper()}": str(v) for k, v in settings.items()}
        if database == "postgresql":
            from tests.support.postgres import empty_database

            environment["AMBIT_DATABASE_URL"] = stack.enter_context(empty_database())
        found = Service(home, environment, flags)
        stack.callback(found.end)
        yield found
