"""A client of the service, synchronous and typed.

>>> from service.client import Client
>>> with Client("http://127.0.0.1:8311") as ambit:  # doctest: +SKIP
...     rig = ambit.rigs.create(Path("rig.toml").read_text(), "modbus://10.0.0.7:502")
...     job = ambit.jobs.submit("experiment", rig.id)
...     for seen in ambit.jobs.watch(job.id):
...         print(seen.progress.percent)
...     ambit.models.result(seen.result["model"])
"""

from service.client.client import Client
from service.client.errors import (
    ApiError,
    ClientError,
    ConflictingError,
    JobEndedError,
    KeyRefusedError,
    MissingError,
    RefusedError,
    UnreachableError,
)
from service.client.shapes import Event, Experiment, Gap, HealthCheck, Job, Model, Page, Progress, Rig, Run, Schedule

__all__ = [
    "ApiError",
    "Client",
    "ClientError",
    "ConflictingError",
    "Event",
    "Experiment",
    "Gap",
    "HealthCheck",
    "Job",
    "JobEndedError",
    "KeyRefusedError",
    "MissingError",
    "Model",
    "Page",
    "Progress",
    "RefusedError",
    "Rig",
    "Run",
    "Schedule",
    "UnreachableError",
]
