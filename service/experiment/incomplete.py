"""Whether a file holds an experiment that ended before it was complete, as by a trip."""

from __future__ import annotations

from service.experiment.data import Experiment

INCOMPLETE = "incomplete"
"""Attribute of such a file: why the campaign ended."""


def incomplete(experiment: Experiment) -> list[str]:
    """That the experiment is not complete, and why, in a sentence; nothing where it is."""
    why = experiment.attributes.get(INCOMPLETE)
    if why is None:
        return []
    return [f"the experiment is not complete, and what is read off it stands on what was measured until then: {why}"]
