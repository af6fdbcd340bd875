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
    JobGoesOnError,
    KeyRefusedError,
    MissingError,
    RefusedError,
    UnreachableError,
)
from service.client.shapes import (
    Acknowledged,
    AuditLine,
    Delivery,
    Event,
    Experiment,
    Gap,
    HealthCheck,
    Job,
    Model,
    Modes,
    Page,
    PlaneStateSpace,
    Progress,
    Rig,
    RigVersion,
    Run,
    Schedule,
    StateSpace,
    Status,
    Stiffness,
    Trend,
)

__all__ = [
    "Acknowledged",
    "ApiError",
    "AuditLine",
    "Client",
    "ClientError",
    "ConflictingError",
    "Delivery",
    "Event",
    "Experiment",
    "Gap",
    "HealthCheck",
    "Job",
    "JobEndedError",
    "JobGoesOnError",
    "KeyRefusedError",
    "MissingError",
    "Model",
    "Modes",
    "Page",
    "PlaneStateSpace",
    "Progress",
    "RefusedError",
    "Rig",
    "RigVersion",
    "Run",
    "Schedule",
    "StateSpace",
    "Status",
    "Stiffness",
    "Trend",
    "UnreachableError",
]
