"""Experiments of one rig, measured one after another at different speeds, as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.experiment.errors import ExperimentFileError


def merged(experiments: Sequence[Experiment], names: Sequence[str]) -> Experiment:
    """All sweeps of all experiments in order; rig time adds up where all tell it, other attributes are the first's.

    Times of points go on from one experiment to the next, as if one campaign had measured them all.

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
    attributes.pop("rig_seconds", None)
    spent = [e.rig_seconds for e in experiments]
    known = [s for s in spent if s is not None]
    if len(known) == len(spent):
        attributes["rig_seconds"] = f"{sum(known):g}"
    return Experiment(first.rig, first.axes, tuple(_one_after_another(experiments)), attributes)


def _one_after_another(experiments: Sequence[Experiment]) -> list[Sweep]:
    """All sweeps, each experiment beginning when the one before it had measured its last point."""
    sweeps: list[Sweep] = []
    begin = 0.0
    for e in experiments:
        sweeps += [s if s.time_s is None else replace(s, time_s=begin + s.time_s) for s in e.sweeps]
        begin = max((float(np.max(s.time_s)) for s in sweeps if s.time_s is not None), default=begin)
    return sweeps
