"""Rows of what jobs made: which is the newest, on both databases."""

from datetime import timedelta

import pytest

from service.storage import jobs, results, rigs
from service.storage.database import now
from service.storage.ids import derived_id
from service.storage.tables import ExperimentRow, GapRow, HealthRow, ModelRow
from tests.support.databases import BOTH, migrated
from tests.support.service import reference_sheet

BLOB = "0" * 64


@pytest.fixture(scope="module", params=BOTH)
def database(request, tmp_path_factory):
    with migrated(request.param, tmp_path_factory.mktemp(request.param)) as found:
        yield found


@pytest.fixture
def rig(database, request):
    with database.write() as session:
        return rigs.create(session, request.node.name[:60], reference_sheet(), "", "", "me").id


def experiment(session, job, at, purpose="commissioning"):
    row = ExperimentRow(
        id=derived_id("exp", job.id),
        rig_id=job.rig_id,
        rig_version=1,
        job_id=job.id,
        source="measured",
        purpose=purpose,
        complete=True,
        file_sha256=BLOB,
        file_bytes=1,
        media_type="application/x-hdf5",
        file_name="experiment.h5",
        summary={},
        created_at=at,
        created_by="me",
    )
    session.add(row)
    session.flush()
    return row


def model(session, job, at):
    row = ModelRow(
        id=derived_id("mod", job.id),
        rig_id=job.rig_id,
        rig_version=1,
        experiment_id=experiment(session, job, at).id,
        job_id=job.id,
        result_sha256=BLOB,
        report_sha256=BLOB,
        plots_sha256=BLOB,
        summary={"identified": True},
        created_at=at,
        created_by="me",
    )
    session.add(row)
    session.flush()
    return row


def gap(session, job, at):
    row = GapRow(
        id=derived_id("gap", job.id),
        rig_id=job.rig_id,
        rig_version=1,
        experiment_id=experiment(session, job, at).id,
        job_id=job.id,
        gap_sha256=BLOB,
        report_sha256=BLOB,
        summary={},
        created_at=at,
        created_by="me",
    )
    session.add(row)
    session.flush()
    return row


def check(session, job, of, at, alarm):
    row = HealthRow(
        id=derived_id("hc", job.id),
        rig_id=job.rig_id,
        rig_version=1,
        experiment_id=experiment(session, job, at, "health").id,
        model_id=of.id,
        job_id=job.id,
        document={},
        report_sha256=BLOB,
        alarm=alarm,
        created_at=at,
    )
    session.add(row)
    session.flush()
    return row


def test_the_newest_check_is_the_one_made_last_though_its_job_was_submitted_first(database, rig):
    """Monday's check failed, Tuesday's was fine, and Monday's was tried again on Wednesday, with an alarm."""
    monday = now()
    with database.write() as session:
        first, commissioning, second = (jobs.submit(session, "health", rig, 1, "me") for _ in range(3))
        baseline = model(session, commissioning, monday)
        check(session, second, baseline, monday + timedelta(days=1), alarm=False)
        check(session, first, baseline, monday + timedelta(days=2), alarm=True)
    with database.read() as session:
        (found,) = results.listed(session, HealthRow, rig, newest=True).items
        assert (found.job_id, found.alarm) == (first.id, True)
        # the newest of each rig is taken first: with one that alarms, no older check without alarm is the newest
        assert results.listed(session, HealthRow, rig, newest=True, alarm=False).items == []


def test_a_check_is_compared_with_the_model_that_was_made_last(database, rig):
    at = now()
    with database.write() as session:
        first, second = (jobs.submit(session, "identification", rig, 1, "me") for _ in range(2))
        model(session, second, at)
        last = model(session, first, at + timedelta(hours=1))
        assert results.baseline(session, rigs.get(session, rig)).id == last.id


def pages(session, table, rig, limit=1):
    """Ids of all rows, page by page."""
    found, after = [], None
    while True:
        page = results.listed(session, table, rig, after, limit)
        found += [row.id for row in page.items]
        if (after := page.next) is None:
            return found


@pytest.mark.parametrize(("table", "make"), [(ExperimentRow, experiment), (ModelRow, model), (GapRow, gap)])
def test_a_list_begins_with_what_was_made_last(database, rig, table, make):
    """Three jobs, and the first one is tried again after the others; two are made at the same time."""
    at = now()
    with database.write() as session:
        first, second, third = (jobs.submit(session, "experiment", rig, 1, "me") for _ in range(3))
        made = [make(session, job, at).id for job in (second, third)]
        wanted = [make(session, first, at + timedelta(microseconds=1)).id, *made[::-1]]
    with database.read() as session:
        assert [row.id for row in results.listed(session, table, rig).items] == wanted
        assert [pages(session, table, rig, limit) for limit in (1, 2, 3)] == [wanted] * 3
        assert [row.id for row in results.listed(session, table, rig, newest=True).items] == wanted[:1]


def test_a_page_begins_where_the_one_before_ended_though_its_last_row_was_made_anew(database, rig):
    at = now()
    with database.write() as session:
        submitted = [jobs.submit(session, "experiment", rig, 1, "me") for _ in range(4)]
        oldest, old, new, newest = (
            experiment(session, job, at + timedelta(hours=k)) for k, job in enumerate(submitted)
        )
        first = results.listed(session, ExperimentRow, rig, limit=2)
        assert [row.id for row in first.items] == [newest.id, new.id]
        new.created_at = at + timedelta(days=1)
    with database.read() as session:
        rest = results.listed(session, ExperimentRow, rig, first.next, limit=2)
        assert [row.id for row in rest.items] == [old.id, oldest.id]
        assert rest.next is None
