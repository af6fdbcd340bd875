"""The worker processes of a diagnosis: modules that they load in advance."""

from __future__ import annotations

from service.pool import prepare

LOADED = ("service.gap.fitting.candidates", "service.gap.loop")


def load() -> None:
    """Start to load the modules of the worker processes; early, as that takes as long as starting a command."""
    prepare(*LOADED)
