"""A running job's line to its row: progress out, cancellation in, whatever the database does meanwhile."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from service.jobs.context import Context
from service.jobs.outage import Outage
from service.storage import jobs

POLL_S = 0.15
"""Together with the campaign's own watch, a cancelled tone ends well within a second."""
UNHURRIED_POLL_S = 0.75
"""Of a job that moves nothing: many of them at a time leave the database alone."""
log = logging.getLogger(__name__)


@dataclass
class _Shipped:
    """Of one journal, how much of it is in the database."""

    size: int


class Control:
    """Writes progress and asks for cancellation, again and again, from a thread of its own.

    Parameters
    ----------
    attempt
        Of the claim: when another worker has begun since, this one is superseded, and shall end.
    journal
        File whose growth is kept in the database too, so that another machine can go on.
    period_s
        Time from one turn to the next.
    """

    def __init__(
        self, context: Context, job_id: str, attempt: int, journal: Path | None = None, period_s: float = POLL_S
    ) -> None:
        self._context = context
        self._job_id = job_id
        self._attempt = attempt
        self._journal = journal
        self._period_s = period_s
        self._shipped: _Shipped | None = None
        self._pending: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._made: dict[str, str] = {}
        self._heard = time.monotonic()
        self._outage = Outage(log, f"job {job_id}")
        self._unread = Outage(log, f"job {job_id}", "its journal cannot be read", "its journal is read again")
        self._defect = ""
        self.cancel_requested = False
        self.superseded = False
        self._thread = threading.Thread(target=self._watch, name=f"control-{job_id}", daemon=True)

    def __enter__(self) -> Control:
        self._turn()
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        self._turn()

    @property
    def stopping(self) -> bool:
        """Whether the worker ends."""
        return self._context.stopping.is_set()

    def stopped(self) -> bool:
        """Whether the job shall not go on, for whatever reason."""
        return self.cancel_requested or self.superseded or self.stopping

    def unheard_s(self) -> float:
        """So long no cancellation could be heard: the database does not answer."""
        return time.monotonic() - self._heard

    def report(self, **values: Any) -> None:
        """Progress, written soon: columns of the job's row."""
        with self._lock:
            self._pending |= values

    def made(self, **ids: str) -> None:
        """Note what the job has made, whatever comes of it."""
        self._made |= ids

    @property
    def result(self) -> dict[str, str]:
        """What the job has made so far."""
        return dict(self._made)

    def begin_journal(self, shipped: int) -> None:
        """The journal's file is in place, and so much of it is in the database; what it has more is kept from now on.

        Not earlier: the file may be an older one than what another machine has put into the database. Once more where
        another journal begins in its place.
        """
        self._shipped = _Shipped(shipped)

    def _watch(self) -> None:
        while not self._over.wait(self._period_s):
            self._turn()

    def _turn(self) -> None:
        with self._lock:
            values, self._pending = self._pending, {}
        try:
            self._exchange(values)
        except SQLAlchemyError as error:  # the database is away: the job goes on, and tells later
            self._outage.away(error)
            with self._lock:
                self._pending = values | self._pending
        except Exception as error:  # costs this turn and its values, which may be why; the next one hears of the job
            if (why := repr(error)) != self._defect:
                log.exception("job %s: a turn of its control met a defect", self._job_id)
                self._defect = why

    def _exchange(self, values: dict[str, Any]) -> None:
        shipped = self._shipped
        content = b"" if shipped is None else self._grown(shipped.size)
        if values or content:
            with self._context.database.write() as session:
                mine, cancelled = jobs.note(session, self._job_id, self._attempt, **values)
                if mine and content and shipped is not None:
                    jobs.add_journal(session, self._job_id, self._attempt, shipped.size, content)
        else:
            with self._context.database.read() as session:
                mine, cancelled = jobs.note(session, self._job_id, self._attempt)
        self._heard = time.monotonic()
        self._outage.over()
        if shipped is not None:
            shipped.size += len(content)
        self.superseded = self.superseded or not mine
        self.cancel_requested = self.cancel_requested or (mine and cancelled)

    def _grown(self, shipped: int) -> bytes:
        if self._journal is None:
            return b""
        try:
            with self._journal.open("rb") as file:
                file.seek(shipped)
                content = file.read()
        except FileNotFoundError:
            return b""
        except OSError as error:  # what it has more is kept once it can be read; a cancellation is heard meanwhile
            self._unread.away(error)
            return b""
        self._unread.over()
        return content
