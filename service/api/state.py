"""What the API's routes work with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from service.config import Settings
from service.jobs.engine import Dispatcher
from service.storage.blobs import Blobs
from service.storage.database import Database


@dataclass(frozen=True)
class Services:
    """Settings, tables, store and the way to the job engine."""

    settings: Settings
    database: Database
    blobs: Blobs
    dispatcher: Dispatcher


async def services(request: Request) -> Services:
    """Services of the application that a request came to; nothing waits here, so that it needs no thread."""
    found: Services = request.app.state.services
    return found


Api = Annotated[Services, Depends(services)]
