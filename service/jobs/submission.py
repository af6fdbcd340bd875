"""How a job comes to the engine: a row first, then the engine; what was lost in between is handed over later."""

from __future__ import annotations

import logging

from service.jobs.engine import Dispatcher
from service.storage import jobs
from service.storage.database import Database
from service.storage.tables import JobRow

log = logging.getLogger(__name__)


def hand_over(database: Database, dispatcher: Dispatcher, job: JobRow) -> bool:
    """Tell the engine of a job whose row is committed; False when it could not be told now."""
    try:
        dispatcher.dispatch(job)
        with database.write() as session:
            jobs.dispatched(session, job.id, job.run)
    except Exception as error:  # the row is kept, and a worker hands it over
        log.warning("job %s waits for the job engine: %s", job.id, str(error).splitlines()[0])
        return False
    return True


def hand_over_all(database: Database, dispatcher: Dispatcher) -> int:
    """Tell the engine of every job that it was not told of; how many there were."""
    with database.read() as session:
        waiting = jobs.undispatched(session)
    return sum(hand_over(database, dispatcher, job) for job in waiting)
