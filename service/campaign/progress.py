"""How far a campaign is: figures for a bar, a page or a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

PHASE_WORDS = {
    "noise": "noise",
    "preliminary": "coarse sweep",
    "main": "main sweep",
    "peaks": "peaks",
    "validation": "unseen sweep",
    "amplifier": "amplifier sweep",
    "done": "done",
}
"""What a person is told of a phase: in a log, on a bar and the page, and of its sweep in a report."""


WORTH_TELLING_S = 10.0
"""A wait for a record that is longer than this is told."""


@dataclass(frozen=True)
class Progress:
    """One report, after every finished point, and before one that takes long to come."""

    phase: str
    """"noise", "preliminary", "main", "peaks", "validation", "amplifier" or "done"."""
    done: int
    """Finished points of the whole campaign."""
    total: int
    """Points that the plan knows of; it grows when peaks are found."""
    points_per_s: float
    """Finished points per second of wall time, those of an earlier run left out."""
    seconds_left: float
    """Wall time to the end of the plan, estimated; 0 before the rate is known."""
    rig_seconds: float
    """Time that the rig has spent."""
    last: str
    """The last point in words."""
    wait_s: float = 0.0
    """Wall time until the next report, estimated, where a slow line brings a record first; 0 otherwise."""


ProgressCallback = Callable[[Progress], None]


class Meter:
    """Counts points and time, and reports.

    Parameters
    ----------
    record_wait_s
        (samples) -> how long one waits for a raw record of so many samples, s.
    """

    def __init__(
        self,
        callback: ProgressCallback | None,
        clock: Callable[[], float] = time.monotonic,
        record_wait_s: Callable[[int], float] = lambda samples: 0.0,
    ) -> None:
        self._callback = callback
        self._record_wait_s = record_wait_s
        self._clock = clock
        self._started = clock()
        self._replayed = 0
        self.done = 0
        self.total = 0
        self.rig_seconds = 0.0

    def finished(self, phase: str, last: str, replayed: bool, rig_seconds: float) -> None:
        """One more point is finished; ``replayed`` when an earlier run had measured it.

        ``rig_seconds`` is the time that the rig has spent by now.
        """
        self.rig_seconds = rig_seconds
        self.done += 1
        self.total = max(self.total, self.done)
        if replayed:
            self._replayed += 1
            self._started = self._clock()
        if self._callback is not None:
            self._callback(self.state(phase, last))

    def awaits_record(self, phase: str, samples: int) -> None:
        """A raw record of so many samples is asked for next: reported where one has to wait for it."""
        wait_s = self._record_wait_s(samples)
        if self._callback is not None and wait_s > WORTH_TELLING_S:
            self._callback(replace(self.state(phase, "a record is on its way"), wait_s=wait_s))

    def state(self, phase: str, last: str) -> Progress:
        """Where the campaign is."""
        elapsed, new = self._clock() - self._started, self.done - self._replayed
        rate = new / elapsed if new and elapsed > 0 else 0.0
        left = (self.total - self.done) / rate if rate else 0.0
        return Progress(phase, self.done, self.total, rate, left, self.rig_seconds, last)
