"""A health check that was interrupted goes on with points of its recent past, not with older ones."""

import threading
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from sqlalchemy import select

from drivers.errors import CancelledError, StoppedElsewhereError
from service import bootstrap, checkup
from service.campaign.journal import entries, line
from service.campaign.run import recover
from service.config import Settings
from service.errors import JobError
from service.experiment import file
from service.health import budget
from service.jobs import campaigns, checks
from service.jobs.control import Control
from service.storage import jobs, results, rigs
from service.storage.blobs import Blobs
from service.storage.ids import derived_id
from service.storage.tables import ExperimentRow, JournalPart
from tests.support.campaigns import SHEET, SMALL, Faulty, assert_same, interrupted_at
from tests.support.databases import migrated
from tests.support.service import reference_sheet

TINY = replace(SMALL, points=16, validation_points=2, amplifier_points=2)
OLD = timedelta(weeks=3)


def begun(content, at):
    """A journal as if its campaign had begun then; one of a version that kept no time with None."""
    header = entries(content)[0][0]
    del header["about"]["began_at"]
    header["about"] |= {} if at is None else {"began_at": at.isoformat()}
    return line(header) + content[content.index(b"\n") + 1 :]


def check(folder, n, error=KeyboardInterrupt):
    """A check by command that is interrupted at its n-th measurement."""
    with pytest.raises(CancelledError):
        checkup.measure_check(Faulty(interrupted_at(n, error())), SHEET, SimpleNamespace(profile=TINY), folder)


@pytest.mark.parametrize(
    ("ago", "goes_on"),
    [
        (timedelta(minutes=20), True),
        (timedelta(seconds=-5), True),  # of a machine whose clock is ahead
        (OLD, False),
        (-OLD, False),
        (None, False),
    ],
)
def test_a_check_by_command_goes_on_with_recent_points_and_puts_older_ones_aside(tmp_path, ago, goes_on):
    path = tmp_path / "experiment.journal"
    check(tmp_path, 40)
    before = begun(path.read_bytes(), None if ago is None else datetime.now(UTC) - ago)
    path.write_bytes(before)
    check(tmp_path, 2)
    aside = tmp_path / "experiment.previous-1.journal"
    if goes_on:
        assert path.read_bytes().startswith(before)
        assert not aside.exists()
    else:
        assert len(entries(path.read_bytes())[0]) == 2  # the header, and the one measurement of today
        assert aside.read_bytes() == before


def test_the_longest_check_goes_on_after_a_restart():
    assert budget.RECENT_S > budget.LARGEST_S


class TestAJob:
    @pytest.fixture
    def check(self, tmp_path, monkeypatch):
        """Run the job's check on a machine until its rig is stopped at the n-th measurement."""
        monkeypatch.setattr(campaigns, "STOP_NOTED_S", 0.0)
        monkeypatch.setattr(checks, "_baseline", lambda *_: (None, "result.json"))
        with migrated("sqlite", tmp_path) as database:
            with database.write() as session:
                rig = rigs.create(session, "bench", reference_sheet(), "simulated://", "", "me").id
                job_id = jobs.submit(session, "health", rig, 1, "me").id

            blobs = Blobs(str(tmp_path / "blobs"))

            def check(machine, n, run):
                folder = tmp_path / machine
                folder.mkdir()
                worker = SimpleNamespace(
                    database=database,
                    blobs=blobs,
                    settings=Settings(home=tmp_path),
                    stopping=threading.Event(),
                    folder=lambda _: folder,
                    calculator=SimpleNamespace(run=lambda *_: asdict(TINY)),  # the plan
                )
                rig = Faulty(interrupted_at(n, StoppedElsewhereError("stopped")))
                rig.close = lambda: None
                monkeypatch.setattr(bootstrap, "connect", lambda _: rig)
                with database.write() as session:
                    job = jobs.claim(session, job_id, run, machine)
                path = folder / "experiment.journal"
                # the database hears of the journal at the end alone, as where the job is stopped at once
                with Control(worker, job_id, job.attempt, path, period_s=60.0) as control:
                    with pytest.raises(JobError):
                        checks.measure(worker, job, control)
                    campaigns.keep(worker, job, control)
                with database.write() as session:
                    jobs.finish(session, job_id, run, jobs.FAILED, control.result)
                    jobs.retry(session, job_id, "me", "local")
                return folder

            yield SimpleNamespace(run=check, database=database, blobs=blobs, job=job_id)

    def test_begins_anew_on_another_machine_and_keeps_the_older_points_apart(self, check):
        first = check.run("one", 40, run=1)
        at = datetime.now(UTC) - OLD
        old = begun((first / "experiment.journal").read_bytes(), at)
        measured = recover(first)
        with check.database.write() as session:
            jobs.drop_journal(session, check.job)
            session.add(JournalPart(job_id=check.job, offset=0, content=old))
        second = check.run("two", 2, run=2)
        assert (second / "experiment.previous-1.journal").read_bytes() == old
        with check.database.read() as session:
            kept = jobs.journal(session, check.job)
            rows = {row.job_id: row for row in session.scalars(select(ExperimentRow))}
            assert results.made_by(session, check.job) == {"experiment": derived_id("exp", check.job)}
        assert kept == (second / "experiment.journal").read_bytes()
        assert len(entries(kept)[0]) == 2
        assert rows[None].created_at == at
        assert (rows[None].purpose, rows[None].complete) == ("health", False)
        check.blobs.fetch(rows[None].file_sha256, second / "apart.h5")
        assert_same(file.read(second / "apart.h5"), measured)
