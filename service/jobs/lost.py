"""Workflows that die because the engine cannot write down what a step has found, or that the workflow has ended.

Its database is full, or damaged. The engine tells nobody, and counts such a workflow as one under way until its worker
is started again: the job would run for ever, and no other one could have its rig.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.jobs.context import Context
from service.jobs.engine import queue_of, waits_for_thread
from service.storage import jobs
from service.storage.tables import JobRow

log = logging.getLogger(__name__)

_running: Counter[str] = Counter()
_lock = threading.Lock()


@contextmanager
def running(workflow_id: str) -> Iterator[None]:
    """While a workflow runs in this process."""
    with _lock:
        _running[workflow_id] += 1
    try:
        yield
    finally:
        with _lock:
            _running[workflow_id] -= 1
            if not _running[workflow_id]:
                del _running[workflow_id]


class Watch:
    """Finds the workflows that the engine believes to run here and that do not, and settles what becomes of them."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._missed: set[str] = set()

    def settle(self) -> None:
        """Let the engine forget those whose job has ended, and begin the others once more, by the queue they are of.

        One that is missed twice is lost; once, it may just be on its way from the queue to its thread. While something
        waits for a thread, none is: it could be that one, and would run twice.

        Raises
        ------
        SQLAlchemyError
            A database does not answer; try again later.
        """
        from dbos import DBOS

        believed = DBOS.list_workflows(
            status="PENDING", executor_id=self._context.settings.worker, load_input=False, load_output=False
        )
        with _lock:
            missed = {found.workflow_id: found.name for found in believed if found.workflow_id not in _running}
        if waits_for_thread():
            self._missed = set()
            return
        for workflow_id in sorted(missed.keys() & self._missed):
            if self._ended(workflow_id):
                DBOS.cancel_workflow(workflow_id)
            else:
                log.warning("%s has died, and begins again where it was", workflow_id)
                # the engine would take it to a queue of its own, without limits: two jobs could have one rig
                DBOS.resume_workflow(workflow_id, queue_name=queue_of(missed[workflow_id]))
        self._missed = set(missed)

    def _ended(self, workflow_id: str) -> bool:
        """Whether a job's run is over: it has ended, or was tried again since; a message has none and is sent again."""
        job_id, _, run = workflow_id.partition(".")
        with self._context.database.read() as session:
            job = session.get(JobRow, job_id)
            return job is not None and (job.state in jobs.ENDED or str(job.run) != run)
