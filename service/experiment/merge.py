"""Experiments of one rig, measured one after another at different speeds, as one."""

from __future__ import annotations

from collections.abc import Sequence

from service.experiment.data import Experiment
from service.experiment.errors import ExperimentFileError


def merged(experiments: Sequence[Experiment], names: Sequence[str]) -> Experiment:
    """All sweeps of all experiments in order; rig time adds up, other attributes are those of the first.

    Parameters
    ----------
    names
        What a refusal calls each experiment.

    Raises
    ------
    ExperimentFileError
        Experiments of different rigs or axes, which no one model can hold.
    """
    first = experiments[0]
    for other, name in zip(experiments[1:], names[1:], strict=True):
        if other.rig != first.rig or other.axes != first.axes:
            raise ExperimentFileError(
                f"{name} is of rig {other.rig!r} with axes {', '.join(other.axes)}, and {names[0]} of rig "
                f"{first.rig!r} with axes {', '.join(first.axes)}; give experiments of one rig"
            )
    attributes = dict(first.attributes)
    spent = [e.attributes.get("rig_seconds") for e in experiments]
    if all(spent):
        attributes["rig_seconds"] = f"{sum(float(s) for s in spent if s):g}"
    return Experiment(first.rig, first.axes, tuple(s for e in experiments for s in e.sweeps), attributes)
