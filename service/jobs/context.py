"""What a worker's steps work with; set once, when the worker starts."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path

from service.config import Settings
from service.jobs.calculator import Calculator
from service.jobs.engine import Dispatcher
from service.private import private_folder
from service.storage.blobs import Blobs
from service.storage.database import Database


@dataclass(frozen=True)
class Context:
    """The worker."""

    settings: Settings
    database: Database
    blobs: Blobs
    calculator: Calculator
    dispatcher: Dispatcher
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set when the worker shall end: rigs are stopped, jobs are left for later."""

    def folder(self, job_id: str) -> Path:
        """Folder of a job's work in progress."""
        return private_folder(self.settings.work / job_id)


_context: Context | None = None


def use(context: Context) -> None:
    """Set the worker's context."""
    global _context
    _context = context


def context() -> Context:
    """The worker's context."""
    assert _context is not None, "a step runs in a worker only"
    return _context
