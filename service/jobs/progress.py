"""How far a job is: every step has a share of its percent, and the time left follows from the pace of the step."""

from __future__ import annotations

import time
from collections.abc import Callable

from service.jobs.control import Control

Share = tuple[float, float]
"""From which percent of the job a step goes to which."""
WHOLE: Share = (0.0, 100.0)
MEASURING: Share = (0.0, 80.0)
"""Of an experiment that is identified, too. How long an identification takes is not known before it is under way."""
IDENTIFYING: Share = (80.0, 100.0)
PLANNING_CHECK: Share = (0.0, 5.0)
MEASURING_CHECK: Share = (5.0, 90.0)
COMPARING_CHECK: Share = (90.0, 100.0)
_LARGEST = 99.0
"""A job is at 100 % when its row says that it is done, and not before."""


class Part:
    """A step's part of a job's progress: it never falls, and moves with every point however many are added.

    Parameters
    ----------
    control
        Told percent, points and time left of the whole job.
    share
        Of this step.
    clock
        Seconds; a test has its own.
    """

    def __init__(self, control: Control, share: Share = WHOLE, clock: Callable[[], float] = time.monotonic) -> None:
        self._control = control
        self._begin, self._end = share
        self._clock = clock
        self._done = 0
        self._fraction = 0.0
        self._first: tuple[float, float] | None = None

    def tell(self, phase: str, percent: float) -> None:
        """So much of this step is done, percent."""
        self._fraction = max(self._fraction, min(percent / 100.0, 1.0))
        self._report(self._left_s(), phase=phase)

    def points(self, phase: str, done: int, total: int, left_s: float | None) -> None:
        """So many points of a plan, which may grow, are done; ``left_s`` to its end, None while nobody knows.

        Every new point takes its share of what is left: more points make the rest slower, and never stop it.
        """
        if done > self._done:
            self._fraction += (1.0 - self._fraction) * (done - self._done) / (max(total, done) - self._done)
            self._done = done
        own = self._left_s()
        self._report(own if left_s is None else left_s, phase=phase, point=done, points=total)

    def _left_s(self) -> float | None:
        """To the end of this step at its pace so far; None before there is one."""
        at = self._clock()
        if self._first is None:
            self._first = at, self._fraction
        began, fraction = self._first
        moved = self._fraction - fraction
        return (at - began) * (1.0 - self._fraction) / moved if moved > 0 else None

    def _report(self, left_s: float | None, **values: str | int) -> None:
        if left_s is not None and self._first is not None:
            # what comes after this step is taken to be as slow as its share of the percent says
            whole_s = self._clock() - self._first[0] + left_s
            left_s += whole_s * (100.0 - self._end) / (self._end - self._begin)
        percent = self._begin + self._fraction * (self._end - self._begin)
        self._control.report(percent=min(percent, _LARGEST), time_left_s=left_s, **values)
