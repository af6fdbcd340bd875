"""The client: one object a service, one attribute a resource."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

from service.client.errors import ConflictingError, MissingError
from service.client.health import HealthChecks, Schedules
from service.client.jobs import Jobs
from service.client.shapes import Experiment, Gap, Job, Model, Rig
from service.client.transport import Transport
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

    def list(self) -> Iterator[Rig]:
        """Rigs, newest first."""
        return self._transport.pages("/rigs", Rig.model_validate)

    def named(self, name: str) -> Rig:
        """The rig of that name or id.

        Raises
        ------
        MissingError
            There is none.
        """
        if name.startswith("rig_"):
            return self.get(name)
        for rig in self.list():
            if rig.name == name:
                return rig
        raise MissingError(404, f"the service knows no rig {name!r}; give rig.toml in its place to make one", [], "")

    def change(self, rig: Rig, datasheet: str, controller_url: str, note: str = "") -> Rig:
        """Give a rig a new datasheet or controller, if nobody else has changed it since ``rig`` was read."""
        seen = self._transport.send("GET", f"/rigs/{rig.id}")
        if seen.json()["version"] != rig.version:
            raise ConflictingError(412, f"the rig {rig.name!r} was changed by someone else; read it again", [], "")
        body = {"datasheet": datasheet, "controller_url": controller_url, "note": note}
        headers = {"If-Match": seen.headers["etag"]}
        return Rig.model_validate(self._transport.send("PUT", f"/rigs/{rig.id}", json=body, headers=headers).json())

    def status(self, rig_id: str) -> dict[str, Any]:
        """What the controller says now: state, trip, displacements, who holds it."""
        return dict(self._transport.get(f"/rigs/{rig_id}/status"))

    def stop(self, rig_id: str) -> None:
        """Ramp the rig's excitation to zero at once, whoever makes it."""
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

    def list(self, rig: str | None = None) -> Iterator[Experiment]:
        """Experiments, newest first."""
        return self._transport.pages("/experiments", Experiment.model_validate, rig=rig)

    def save(self, experiment_id: str, path: Path) -> Path:
        """The experiment's file."""
        return self._transport.save(f"/experiments/{experiment_id}/file", path)


class Models:
    """Models of a service."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def get(self, model_id: str) -> Model:
        """A model in short."""
        return Model.model_validate(self._transport.get(f"/models/{model_id}"))

    def list(self, rig: str | None = None) -> Iterator[Model]:
        """Models, newest first."""
        return self._transport.pages("/models", Model.model_validate, rig=rig)

    def result(self, model_id: str) -> dict[str, Any]:
        """result.json, whole."""
        return dict(self._transport.get(f"/models/{model_id}/result.json"))

    def frequency_response(self, model_id: str) -> dict[str, Any]:
        """Measured and modelled frequency responses."""
        return dict(self._transport.get(f"/models/{model_id}/frequency-response"))

    def state_space(self, model_id: str) -> dict[str, Any]:
        """A, B, C, D by plane."""
        return dict(self._transport.get(f"/models/{model_id}/state-space"))

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

    def list(self, rig: str | None = None) -> Iterator[Gap]:
        """Diagnoses, newest first."""
        return self._transport.pages("/gaps", Gap.model_validate, rig=rig)

    def document(self, gap_id: str) -> dict[str, Any]:
        """gap.json, whole."""
        return dict(self._transport.get(f"/gaps/{gap_id}/gap.json"))

    def save(self, gap_id: str, folder: Path) -> dict[str, Path]:
        """gap.json and gap.html in a folder."""
        return {
            "gap": self._transport.save(f"/gaps/{gap_id}/gap.json", folder / "gap.json"),
            "gap_report": self._transport.save(f"/gaps/{gap_id}/report.html", folder / "gap.html"),
        }


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
    """

    def __init__(
        self,
        url: str | None = None,
        key: str | None = None,
        ca: Path | str | None = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
    ) -> None:
        self._transport = Transport(
            url or os.environ.get("AMBIT_URL") or DEFAULT_URL,
            os.environ.get("AMBIT_KEY") if key is None else key,
            os.environ.get("AMBIT_CA") if ca is None else ca,
            timeout_s,
            patience_s,
        )
        self.rigs = Rigs(self._transport)
        self.experiments = Experiments(self._transport)
        self.jobs = Jobs(self._transport)
        self.models = Models(self._transport)
        self.gaps = Gaps(self._transport)
        self.health = HealthChecks(self._transport)
        self.schedules = Schedules(self._transport)

    @property
    def url(self) -> str:
        """Address of the service."""
        return self._transport.url

    def address(self, path: str) -> str:
        """URL of something of the API, to open in a browser."""
        return f"{self.url}/api/v1{path}"

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
