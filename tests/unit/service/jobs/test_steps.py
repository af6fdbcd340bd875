"""A step of a job tells in the log which attempt at the job it belongs to."""

import logging

from service.config import Settings
from service.jobs import context, steps
from service.storage import jobs, rigs
from tests.support.databases import migrated
from tests.support.service import reference_sheet


def test_the_second_step_is_no_second_attempt_and_a_retry_is(tmp_path, monkeypatch, caplog):
    with migrated("sqlite", tmp_path) as database:
        settings = Settings(home=tmp_path)
        worker = context.Context(settings, database, None, None, None)
        monkeypatch.setattr(steps, "context", lambda: worker)
        with database.write() as session:
            rig = rigs.create(session, "bench", reference_sheet(), "", "", "me")
            job = jobs.submit(session, "experiment", rig.id, 1, "me").id

        def told(run):
            caplog.clear()
            with caplog.at_level(logging.INFO):
                steps.guarded(lambda *_: {}, job, run)
            return caplog.text

        assert "attempt 1" in told(1)
        assert "attempt 1" in told(1)
        with database.write() as session:
            jobs.finish(session, job, 1, jobs.FAILED, {})
            jobs.retry(session, job, "me", "local")
        assert "attempt 2" in told(2)
