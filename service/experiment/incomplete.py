"""Whether a file holds an experiment that ended before it was complete, as by a trip, or whose rotor changed speed."""

from __future__ import annotations

from service.experiment.data import Experiment

INCOMPLETE = "incomplete"
"""Attribute of such a file: why the campaign ended."""
SPEED_CHANGED = "speed_changed"
"""Attribute of a file whose rotor turned otherwise when the campaign had ended: from which speed to which."""


def incomplete(experiment: Experiment) -> list[str]:
    """That the experiment is not complete, and why, in a sentence; that its rotor changed speed, in another one."""
    why = experiment.attributes.get(INCOMPLETE)
    ended = (
        []
        if why is None
        else [f"the experiment is not complete, and what is read off it stands on what was measured until then: {why}"]
    )
    return [*ended, *changed_speed(experiment)]


def changed_speed(experiment: Experiment) -> list[str]:
    """That the rotor's speed changed while the experiment was measured, in a sentence."""
    how = experiment.attributes.get(SPEED_CHANGED)
    if how is None:
        return []
    return [
        f"the rotor's speed changed {how} while it was measured, and every point is taken for one at the first: what "
        "goes by the speed, as gyroscopic coupling and runout, is wrong by that; measure at one speed"
    ]
