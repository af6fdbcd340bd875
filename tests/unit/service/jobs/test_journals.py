"""A campaign's journal in the database, from which another machine goes on."""

import logging
import threading
from types import SimpleNamespace

import pytest

from service.campaign.journal import Journal, entries, line
from service.experiment.errors import JournalError
from service.jobs import campaigns
from service.jobs.control import Control
from service.storage import jobs, rigs
from tests.support.databases import BOTH, migrated
from tests.support.service import reference_sheet


@pytest.fixture(params=BOTH)
def worker(request, tmp_path):
    with migrated(request.param, tmp_path) as database:
        yield SimpleNamespace(database=database, stopping=threading.Event())


@pytest.fixture
def submitted(worker):
    with worker.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        return jobs.submit(session, "experiment", rig, 1, "me")


def kept(worker, job):
    with worker.database.read() as session:
        return jobs.journal(session, job.id)


def of(*points):
    """Lines of a journal."""
    return b"".join(line({"point": point}) for point in points)


def works(worker, job, path, *measured):
    """A machine with a journal of its own at ``path`` takes the job and measures some more."""
    with worker.database.write() as session:
        attempt = jobs.claim(session, job.id, 1, "w1").attempt
    with Control(worker, job.id, attempt, path, period_s=60.0) as control:
        campaigns._restore_journal(worker, job, path, control, control.stopped)
        for piece in measured:
            with path.open("ab") as file:
                file.write(piece)
            control._turn()


def goes_on(worker, job, path, header, *points):
    """Another machine takes the job and measures some more, as a campaign does."""
    with worker.database.write() as session:
        attempt = jobs.claim(session, job.id, 1, "w2").attempt
    with Control(worker, job.id, attempt, path, period_s=60.0) as control:
        campaigns._restore_journal(worker, job, path, control, control.stopped)
        control._turn()  # one that comes before the campaign has the rig
        journal = Journal(path, header)
        for point in points:
            journal.append({"point": point})
            control._turn()
        journal.close()


def test_a_takeover_has_every_point_though_two_machines_went_different_ways(worker, submitted, tmp_path):
    works(worker, submitted, tmp_path / "one", of("1"), of("2 by one"), of("3 by one"))
    other = tmp_path / "two"
    other.write_bytes(of("1", "2 by two", "3 by two", "4 by two"))  # measured while the database was away
    works(worker, submitted, other, of("5 by two"))
    assert kept(worker, submitted) == other.read_bytes()


def test_an_older_journal_takes_nothing_from_the_database(worker, submitted, tmp_path):
    works(worker, submitted, tmp_path / "one", of("1"), of("2 by one"), of("3 by one"))
    older = tmp_path / "two"
    older.write_bytes(of("1", "2 by two"))
    works(worker, submitted, older, of("4 by two"))
    assert kept(worker, submitted) == older.read_bytes() == of("1", "2 by one", "3 by one", "4 by two")


def test_a_point_that_was_cut_short_on_its_way_takes_no_later_one_along(worker, submitted, tmp_path, caplog):
    """The machine died in the middle of a line, which is measured again elsewhere: other figures, another length."""
    header = {"rig": "r"}
    one, two = tmp_path / "one", tmp_path / "two"
    Journal(one, header).close()
    whole = one.read_bytes() + of("1")
    works(worker, submitted, one, of("1"), of("2 by one, and cut short")[:-9])
    with caplog.at_level(logging.WARNING):
        goes_on(worker, submitted, two, header, "2", "3")
    assert kept(worker, submitted) == two.read_bytes() == whole + of("2", "3")
    assert "cut short" in caplog.text


@pytest.mark.parametrize("points", [[], ["1"]])
def test_a_point_that_was_cut_short_on_this_machine_takes_no_later_one_along(worker, submitted, tmp_path, points):
    """Its disk was full in the middle of a line, or of the header, and the same machine goes on."""
    path = tmp_path / "one"
    Journal(path, {"rig": "r"}).close()
    whole = path.read_bytes() + of(*points)
    path.write_bytes(whole + of("2, and cut short")[:-9] if points else whole[:-9])
    goes_on(worker, submitted, path, {"rig": "r", "about": {"speed_rad_s": 1.0}}, "2", "3")
    found = kept(worker, submitted)
    assert found == path.read_bytes()
    assert [entry["point"] for entry in entries(found)[0][1:]] == [*points, "2", "3"]


def test_a_file_that_is_no_journal_is_left_as_it_is(worker, submitted, tmp_path):
    path = tmp_path / "one"
    path.write_bytes(b"of another program\n")
    with pytest.raises(JournalError, match="not a campaign journal"):
        goes_on(worker, submitted, path, {"rig": "r"})
    assert path.read_bytes() == b"of another program\n"
