"""The client: one object a service, one attribute a resource."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from unicodedata import normalize
from uuid import uuid4

from service.api.identifiers import is_id
from service.client.errors import ConflictingError, MissingError
from service.client.health import HealthChecks, Schedules
from service.client.jobs import Jobs
from service.client.shapes import (
    Acknowledged,
    AuditLine,
    Experiment,
    Gap,
    Job,
    Model,
    Modes,
    PlaneStateSpace,
    Rig,
    RigVersion,
    Status,
    Stiffness,
)
from service.client.transport import Transport, Waiting, quietly
from service.errors import OutputError

DEFAULT_URL = "http://127.0.0.1:8311"
TYPES = {".mat": "application/x-matlab-data"}
HDF5 = "application/x-hdf5"


class Rigs:
    """Rigs of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(self, datasheet: str, controller_url: str = "", name: str | None = None, note: str = "") -> Rig:
        """Make a rig known by its datasheet (the text of rig.toml)."""
        body = {"datasheet": datasheet, "controller_url": controller_url, "name": name, "note": note}
        return Rig.model_validate(self._transport.post("/rigs", body))

    def get(self, rig_id: str, version: int | None = None) -> Rig:
        """A rig, as it is or as it was."""
        return Rig.model_validate(self._transport.get(f"/rigs/{rig_id}", version=version))

    def list(self, retired: bool = False) -> Iterator[Rig]:
        """Rigs, newest first; with ``retired`` those too that were retired."""
        return self._transport.pages("/rigs", Rig.model_validate, retired=retired or None)

    def named(self, name: str, retired: bool = False) -> Rig:
        """The rig of that name or id; by its name a retired one, too, with ``retired``: its history stays.

        Raises
        ------
        MissingError
            There is none.
        ConflictingError
            The one of that name was retired.
        """
        if is_id("rig", name):
            return self.get(name)
        for rig in self.list(retired=True):
            if normalize("NFC", rig.name) != normalize("NFC", name):
                continue
            if rig.retired_at is not None and not retired:
                raise ConflictingError(
                    409,
                    f"the rig {name!r} ({rig.id}) was retired at {rig.retired_at:%Y-%m-%d %H:%M} UTC; ambit jobs --rig "
                    "tells its jobs, and a new rig takes another name",
                    [],
                    "",
                )
            return rig
        raise MissingError(
            404,
            f"the service knows no rig {name!r}; ambit rigs lists them, and ambit submit with rig.toml makes one",
            [],
            "",
        )

    def change(self, rig: Rig, datasheet: str, controller_url: str, note: str = "") -> Rig:
        """Give a rig a new datasheet or controller, if nobody else has changed it since ``rig`` was read."""
        body = {"datasheet": datasheet, "controller_url": controller_url, "note": note}
        return self._changed(rig, f"/rigs/{rig.id}", body, body)

    def choose_baseline(self, rig: Rig, model_id: str | None) -> Rig:
        """Choose the model that health checks compare with, None for the newest; as `change`."""
        return self._changed(rig, f"/rigs/{rig.id}/baseline", {"model": model_id}, {"baseline_model": model_id})

    def _changed(self, rig: Rig, path: str, body: dict[str, Any], fields: dict[str, Any]) -> Rig:
        def made(found: dict[str, Any]) -> bool:
            return all(found[name] == value for name, value in fields.items())

        of = f"/rigs/{rig.id}"
        seen = self._transport.send("GET", of)
        if seen.json()["version"] != rig.version:
            raise ConflictingError(412, f"the rig {rig.name!r} was changed by someone else; read it again", [], "")
        return Rig.model_validate(self._transport.put(path, body, of, seen.headers["etag"], made))

    def versions(self, rig_id: str) -> Iterator[RigVersion]:
        """Every version of a rig, newest first."""
        return self._transport.pages(f"/rigs/{rig_id}/versions", RigVersion.model_validate)

    def retire(self, rig_id: str) -> None:
        """Let a rig take no more jobs; its history stays."""
        self._transport.send("DELETE", f"/rigs/{rig_id}")

    def stiffness(self, rig_id: str) -> Iterator[Stiffness]:
        """ki and ks of a rig's bearings, newest model first."""
        return self._transport.pages(f"/rigs/{rig_id}/stiffness", Stiffness.model_validate)

    def modes(self, rig_id: str) -> Iterator[Modes]:
        """Natural frequencies and damping ratios of a rig's rotor, newest model first."""
        return self._transport.pages(f"/rigs/{rig_id}/modes", Modes.model_validate)

    def status(self, rig_id: str) -> Status:
        """What the controller says now: state, trip, displacements, who holds it."""
        return Status.model_validate(self._transport.get(f"/rigs/{rig_id}/status"))

    def acknowledge(self, rig_id: str) -> Acknowledged:
        """Clear the latched trip of the rig's controller, once its cause is found; nothing moves."""
        return Acknowledged.model_validate(self._transport.send("POST", f"/rigs/{rig_id}/acknowledge").json())

    def stop(self, rig_id: str) -> None:
        """Ramp the rig's excitation to zero at once, whoever makes it; no job that there is moves the rotor again."""
        self._transport.send("POST", f"/rigs/{rig_id}/stop")


class Experiments:
    """Experiments of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def upload(self, rig_id: str, path: Path) -> Experiment:
        """Upload an experiment file, HDF5 or MATLAB.

        Raises
        ------
        RefusedError
            The service does not take it; says why.
        """
        try:
            content = path.read_bytes()
        except OSError as error:
            raise OutputError(f"cannot read {path}: {error.strerror or error}; give an experiment file") from error
        headers = {"Content-Type": TYPES.get(path.suffix.lower(), HDF5), "Idempotency-Key": str(uuid4())}
        response = self._transport.send(
            "POST", f"/rigs/{rig_id}/experiments", content=content, params={"filename": path.name}, headers=headers
        )
        return Experiment.model_validate(response.json())

    def get(self, experiment_id: str) -> Experiment:
        """An experiment."""
        return Experiment.model_validate(self._transport.get(f"/experiments/{experiment_id}"))

    def list(
        self, rig: str | None = None, purpose: str | None = None, complete: bool | None = None
    ) -> Iterator[Experiment]:
        """Experiments, newest first; of one ``purpose`` ("commissioning" or "health"), or only whole ones."""
        return self._transport.pages(
            "/experiments", Experiment.model_validate, rig=rig, purpose=purpose, complete=complete
        )

    def save(self, experiment_id: str, path: Path) -> Path:
        """The experiment's file."""
        return self._transport.save(f"/experiments/{experiment_id}/file", path)

    def export_responses(
        self, experiment_id: str, to: Path, plane: str = "x", path: str = "u->y", format: str = "uff"
    ) -> Path:
        """A plane's measured frequency response as a file: json, csv, mat or uff (UFF-58)."""
        query = {"plane": plane, "path": path, "format": format}
        return self._transport.save(f"/experiments/{experiment_id}/export/responses", to, query)


class Models:
    """Models of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def get(self, model_id: str) -> Model:
        """A model in short."""
        return Model.model_validate(self._transport.get(f"/models/{model_id}"))

    def list(self, rig: str | None = None, newest: bool | None = None) -> Iterator[Model]:
        """Models, newest first; with ``newest`` only the last one of each rig."""
        return self._transport.pages("/models", Model.model_validate, rig=rig, newest=newest)

    def result(self, model_id: str) -> dict[str, Any]:
        """result.json, whole."""
        return dict(self._transport.get(f"/models/{model_id}/result.json"))

    def frequency_response(self, model_id: str) -> dict[str, Any]:
        """Measured and modelled frequency responses."""
        return dict(self._transport.get(f"/models/{model_id}/frequency-response"))

    def nyquist(self, model_id: str) -> dict[str, Any]:
        """The loop of each axis with the others closed, by plane."""
        return dict(self._transport.get(f"/models/{model_id}/nyquist"))

    def step(self, model_id: str) -> dict[str, Any]:
        """Displacement of the closed loop after 1 A more on r, by plane."""
        return dict(self._transport.get(f"/models/{model_id}/step"))

    def curves(self, model_id: str) -> dict[str, Any]:
        """All curves, whole: amb-model-curves."""
        return dict(self._transport.get(f"/models/{model_id}/curves.json"))

    def state_space(self, model_id: str) -> dict[str, PlaneStateSpace]:
        """A, B, C, D by plane."""
        planes = self._transport.get(f"/models/{model_id}/state-space")
        return {name: PlaneStateSpace.model_validate(plane) for name, plane in planes.items()}

    def export_state_space(
        self, model_id: str, to: Path, plane: str = "x", part: str = "plant", format: str = "mat"
    ) -> Path:
        """A plane's state space as a file: json, csv or mat, continuous time, with names and units of its signals."""
        query = {"plane": plane, "part": part, "format": format}
        return self._transport.save(f"/models/{model_id}/export/state-space", to, query)

    def save(self, model_id: str, folder: Path) -> dict[str, Path]:
        """result.json and report.html in a folder."""
        names = {"result": "result.json", "report": "report.html"}
        return {k: self._transport.save(f"/models/{model_id}/{name}", folder / name) for k, name in names.items()}


class Gaps:
    """Diagnoses of the gap, of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def get(self, gap_id: str) -> Gap:
        """A diagnosis in short."""
        return Gap.model_validate(self._transport.get(f"/gaps/{gap_id}"))

    def list(self, rig: str | None = None, newest: bool | None = None) -> Iterator[Gap]:
        """Diagnoses, newest first; with ``newest`` only the last one of each rig."""
        return self._transport.pages("/gaps", Gap.model_validate, rig=rig, newest=newest)

    def document(self, gap_id: str) -> dict[str, Any]:
        """gap.json, whole."""
        return dict(self._transport.get(f"/gaps/{gap_id}/gap.json"))

    def save(self, gap_id: str, folder: Path) -> dict[str, Path]:
        """gap.json and gap.html in a folder."""
        return {
            "gap": self._transport.save(f"/gaps/{gap_id}/gap.json", folder / "gap.json"),
            "gap_report": self._transport.save(f"/gaps/{gap_id}/report.html", folder / "gap.html"),
        }


class AuditLog:
    """The audit log of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def list(
        self, rig: str | None = None, action: str | None = None, subject: str | None = None
    ) -> Iterator[AuditLine]:
        """Who did what, and who moved which rotor; newest first."""
        query = {"rig": rig, "action": action, "subject": subject}
        return self._transport.pages("/audit", AuditLine.model_validate, **query)


class Client:
    """A service.

    Parameters
    ----------
    url
        Its address; AMBIT_URL without it, and the default of ``ambit serve`` without that.
    key
        API key; AMBIT_KEY without it, "" for none. A service on this machine may have none.
    ca
        Certificate of the authority, PEM, where the system does not know it; AMBIT_CA without it.
    timeout_s
        For an answer to begin.
    patience_s
        How long a service that is away or busy is asked again.
    waiting
        Told why, as soon as a request is to be sent again.
    """

    def __init__(
        self,
        url: str | None = None,
        key: str | None = None,
        ca: Path | str | None = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
        waiting: Waiting = quietly,
    ) -> None:
        self._transport = Transport(
            url or os.environ.get("AMBIT_URL") or DEFAULT_URL,
            os.environ.get("AMBIT_KEY") if key is None else key,
            os.environ.get("AMBIT_CA") if ca is None else ca,
            timeout_s,
            patience_s,
            waiting,
        )
        self.rigs = Rigs(self._transport)
        self.experiments = Experiments(self._transport)
        self.jobs = Jobs(self._transport)
        self.models = Models(self._transport)
        self.gaps = Gaps(self._transport)
        self.health = HealthChecks(self._transport)
        self.schedules = Schedules(self._transport)
        self.audit = AuditLog(self._transport)

    @property
    def url(self) -> str:
        """Address of the service."""
        return self._transport.url

    def address(self, path: str) -> str:
        """URL of something of the API, to open in a browser."""
        return f"{self.url}/api/v1{path}"

    def report_address(self, job: Job) -> str:
        """URL of a job's report, to open in a browser.

        A browser shows no key by itself: where the service wants one it is the page of the job, which asks for it.
        """
        if self._transport.shows_key or "model" not in job.result:
            return f"{self.url}/#/job/{job.id}"
        return self.address(f"/models/{job.result['model']}/report.html")

    def save(self, job: Job, folder: Path) -> dict[str, Path]:
        """Every file that a job made, and the datasheet that it worked with.

        experiment.h5, rig.toml, result.json, report.html, gap.json, gap.html, health.json, health.html, as there are.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        from service.output import ready_folder, write_text

        ready_folder(folder)
        files: dict[str, Path] = {}
        rig = self.rigs.get(job.rig, job.rig_version or None)
        files["datasheet"] = write_text(folder / "rig.toml", rig.datasheet)
        experiment = job.result.get("experiment") or job.experiment
        if experiment:
            files["experiment"] = self.experiments.save(experiment, folder / "experiment.h5")
        if "model" in job.result:
            files |= self.models.save(job.result["model"], folder)
        if "gap" in job.result:
            files |= self.gaps.save(job.result["gap"], folder)
        if "health" in job.result:
            files |= self.health.save(job.result["health"], folder)
        return files

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def __enter__(self) -> Self:
        """Oneself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
