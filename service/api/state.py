"""What the API's routes work with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from service.api.kept import Kept
from service.config import Settings
from service.jobs.engine import Dispatcher
from service.storage.blobs import Blobs
from service.storage.database import Database
from service.storage.tables import ModelRow


@dataclass(frozen=True)
class KeptModel:
    """A model as it was read, and as it is sent."""

    row: ModelRow
    document: bytes
    tag: str


@dataclass(frozen=True)
class Services:
    """Settings, tables, store and the way to the job engine; what is asked for most."""

    settings: Settings
    database: Database
    blobs: Blobs
    dispatcher: Dispatcher
    models: Kept[KeptModel]


async def services(request: Request) -> Services:
    """Services of the application that a request came to; nothing waits here, so that it needs no thread."""
    found: Services = request.app.state.services
    return found


Api = Annotated[Services, Depends(services)]
