"""What does not answer, as a database, is told once, and not at every try: the log may be on the disk that is full."""

from __future__ import annotations

import logging
import re
import time


class Outage:
    """Tells once that the database does not answer, and once that it does again; again after another reason.

    Parameters
    ----------
    who
        Begins the lines: whose work it is that waits.
    away, back
        What is told of something else than the database.
    """

    def __init__(
        self,
        log: logging.Logger,
        who: str = "",
        away: str = "the database does not answer",
        back: str = "the database answers again",
    ) -> None:
        self._log = log
        self._who = f"{who}: " if who else ""
        self._away = away
        self._back = back
        self._why = ""

    def away(self, error: Exception) -> None:
        """It did not answer."""
        why = (str(error).splitlines() or [type(error).__name__])[0]
        if why != self._why:
            self._log.warning("%s%s: %s", self._who, self._away, why)
            self._why = why

    def over(self) -> None:
        """It answered."""
        if self._why:
            self._log.warning("%s%s", self._who, self._back)
            self._why = ""


class Repeats(logging.Filter):
    """Lets one of the warnings that are alike through in a minute: the job engine's, which has no `Outage`.

    Alike are those whose first lines differ in words with digits alone: ids of jobs, attempts, times.
    """

    EVERY_S = 60.0
    _COUNTED = re.compile(r"\w*\d[\w.:-]*")

    def __init__(self) -> None:
        super().__init__()
        self._told: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is told."""
        said = self._COUNTED.sub("", record.getMessage().partition("\n")[0])
        at = time.monotonic()
        if at - self._told.get(said, -self.EVERY_S) < self.EVERY_S:
            return False
        self._told = {key: told for key, told in self._told.items() if at - told < self.EVERY_S} | {said: at}
        return True
