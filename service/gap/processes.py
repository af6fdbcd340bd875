"""The processes that a diagnosis fits with: what they load, in advance."""

from __future__ import annotations

from service.pool import prepare

LOADED = ("service.gap.fitting.candidates", "service.gap.next_experiment")


def load() -> None:
    """Begin to load what they work with; the sooner the better, as it takes as long as a command does to load it."""
    prepare(*LOADED)
