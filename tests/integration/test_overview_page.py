"""The overview of a service with a long history: no rig, job or change is lost behind what is newer."""

import json
from dataclasses import dataclass

import httpx
import pytest

from service.config import Settings
from service.storage import jobs, rigs
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow, HealthRow, ModelRow
from sim.rig_file import to_toml
from tests.support.browser import BROWSER
from tests.support.commissioned import SHEET
from tests.support.service import free_port
from tests.support.serving import Serving, serving
from tests.support.tab import tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


@dataclass(frozen=True)
class Plant:
    """A service with a rig that was checked once, with an alarm, before another one was checked 201 times."""

    service: Serving
    rare: str
    busy: str
    oldest_job: str
    running: str
    """A job older than those that the overview lists."""
    stopped: str
    """A job that was cancelled with a reason."""
    new: str
    """A rig that was never checked."""
    made: dict[str, tuple[str, str]]
    """Experiment and model of a rig."""


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    with serving(Settings(home=tmp_path_factory.mktemp("overview") / "home", port=0)) as service:
        with service.services.database.write() as session:
            names = ("rare", "busy", "new")
            rare, busy, new = (rigs.create(session, name, to_toml(SHEET), "", "", "x").id for name in names)
            made = {rig: _model(session, rig) for rig in (rare, busy)}
            _check(session, rare, made[rare], alarm=True)
            for _ in range(201):
                _check(session, busy, made[busy], alarm=False)
            oldest, running = (jobs.submit(session, "gap", busy, 1, "x") for _ in range(2))
            oldest.state, running.state = jobs.FAILED, jobs.RUNNING
            oldest.error_title = "too few points"
            for _ in range(119):
                jobs.submit(session, "identification", busy, 1, "x").state = jobs.CANCELLED
            stopped = jobs.submit(session, "experiment", busy, 1, "x")
            jobs.claim(session, stopped.id, 1, "w1")
            jobs.cancel_moving(session, busy, "the rig was stopped by hand")
            jobs.finish(session, stopped.id, 1, jobs.CANCELLED, {})
            found = Plant(service, rare, busy, oldest.id, running.id, stopped.id, new, made)
        yield found


def _model(session, rig: str) -> tuple[str, str]:
    common = {"rig_id": rig, "rig_version": 1, "created_at": now(), "created_by": "x", "summary": {}}
    experiment, model = new_id("exp"), new_id("mod")
    session.add(
        ExperimentRow(
            id=experiment, source="measured", complete=True, file_sha256="0" * 64, file_bytes=1, file_name="e.h5",
            media_type="application/x-hdf5", **common,
        )
    )  # fmt: skip
    session.flush()
    blobs = dict.fromkeys(("result_sha256", "report_sha256", "plots_sha256"), "0" * 64)
    session.add(ModelRow(id=model, experiment_id=experiment, **blobs, **common))
    session.flush()
    return experiment, model


def _check(session, rig: str, made: tuple[str, str], alarm: bool) -> str:
    row = HealthRow(
        id=new_id("hc"), rig_id=rig, rig_version=1, experiment_id=made[0], model_id=made[1], alarm=alarm,
        document={
            "zone": "B", "drifted": ["x.kiA", "y.unexplained"] if alarm else [], "sentence": "",
            "parameters": {"x.kiA": {"description": "force-current factor of bearing xA", "change_percent": -3.04}},
        },
        report_sha256="0" * 64, created_at=now(),
    )  # fmt: skip
    session.add(row)
    return row.id


def test_the_newest_check_of_each_rig_is_asked_for_however_often_another_one_is_checked(plant):
    with httpx.Client(base_url=f"{plant.service.url}/api/v1") as api:

        def checks(**asked) -> dict:
            return api.get("/health-checks", params=asked).json()

        of_each = [checks(rig=rig, limit=1)["items"][0] for rig in (plant.busy, plant.rare)]
        assert checks(newest=True) == {"items": of_each, "next": None}
        assert checks(newest=True, alarm=True)["items"] == of_each[1:]
        first = checks(newest=True, limit=1)
        assert first["items"] + checks(newest=True, after=first["next"])["items"] == of_each


@needs_browser
def test_the_overview_has_the_newest_check_of_every_rig(plant):
    with tab() as page:
        page.open(f"{plant.service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        row = "[...document.querySelectorAll('tr')].find((r) => r.innerText.startsWith('rare')).innerText"
        told = page.run(row)
        assert "force-current factor of bearing xA -3 %" in told
        assert "plane y has a change that no parameter explains" in told
        assert "x.kiA" not in told
        assert page.complaints == []


@needs_browser
def test_a_rig_whose_newest_check_failed_says_so_beside_what_was_known_before(plant):
    def made(rig: str, state: str, title: str = "") -> str:
        with plant.service.services.database.write() as session:
            job = jobs.submit(session, "health", rig, 1, "x")
            jobs.claim(session, job.id, 1, "w1")
            jobs.finish(session, job.id, 1, state, {}, title, "why it did")
            return job.id

    overtaken = made(plant.busy, jobs.FAILED, "rig stopped")
    with plant.service.services.database.write() as session:
        _check(session, plant.busy, plant.made[plant.busy], alarm=False)
    first, newest = (made(plant.rare, jobs.FAILED, title) for title in ("bus error", "controller tripped"))
    never = made(plant.new, jobs.FAILED, "budget too small")
    made(plant.rare, jobs.CANCELLED)
    with tab() as page:
        page.open(f"{plant.service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        cells = "[...document.querySelectorAll('section:first-of-type tr')].map((r) => r.innerText)"
        rows = {row.split()[0]: row for row in page.run(cells)}
        links = page.run("[...document.querySelectorAll('section:first-of-type a')].map((a) => a.getAttribute('href'))")
        assert page.complaints == []
    assert "force-current factor" in rows["rare"]
    assert "controller tripped" in rows["rare"]
    assert "bus error" not in rows["rare"]
    assert "zone B" in rows["busy"]
    assert "failed" not in rows["busy"]
    assert "not checked" in rows["new"]
    assert "budget too small" in rows["new"]
    assert {job for job in (overtaken, first, newest, never) if f"#/job/{job}" in links} == {newest, never}


def test_the_newest_job_of_each_rig_is_asked_for_among_those_of_a_kind_and_state(plant):
    """It is the one that ended last: a job that is tried again ends after those that were submitted later."""
    with plant.service.services.database.write() as session:
        rig = rigs.create(session, "tried again", to_toml(SHEET), "", "", "x").id
        tried, later = (jobs.submit(session, "health", rig, 1, "x").id for _ in range(2))
    for job, run in ((tried, 1), (later, 1), (tried, 2)):
        with plant.service.services.database.write() as session:
            if run > 1:
                jobs.retry(session, job, "x")
            jobs.claim(session, job, run, "w1")
            jobs.finish(session, job, run, jobs.FAILED, {}, "bus error", f"in run {run}")
    with httpx.Client(base_url=f"{plant.service.url}/api/v1") as api:
        asked = {"kind": "health", "state": "failed", "rig": rig, "newest": True}
        assert [job["id"] for job in api.get("/jobs", params=asked).json()["items"]] == [tried]
        asked = {"kind": "gap", "newest": True}
        assert [job["id"] for job in api.get("/jobs", params=asked).json()["items"]] == [plant.running]
        failed = api.get("/jobs", params=asked | {"state": "failed"}).json()["items"]
        assert [job["id"] for job in failed] == [plant.oldest_job]


@needs_browser
def test_every_job_is_reached_from_the_overview_and_one_that_runs_is_on_it(plant):
    with tab() as page:
        page.open(f"{plant.service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        assert page.run(f"!!document.querySelector('a[href=\"#/job/{plant.running}\"]')")
        assert not page.run(f"!!document.querySelector('a[href=\"#/job/{plant.oldest_job}\"]')")
        page.run("document.querySelector('a.more').click()")
        page.until("document.querySelectorAll('tbody tr').length === 100")
        page.run("document.querySelector('a.more').click()")
        page.until(f"document.querySelector('a[href=\"#/job/{plant.oldest_job}\"]')")
        assert not page.run("!!document.querySelector('a.more')")
        assert "too few points" in page.text()
        assert page.complaints == []


@needs_browser
def test_a_job_that_was_cancelled_says_why_in_the_list_and_on_its_page(plant):
    with tab() as page:
        page.open(f"{plant.service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        line = f"document.querySelector('a[href=\"#/job/{plant.stopped}\"]').closest('tr').innerText"
        assert page.run(line).split()[2:].count("cancelled") == 1
        assert "the rig was stopped by hand" in page.run(line)
        page.open(f"{plant.service.url}/#/job/{plant.stopped}")
        page.until("document.querySelector('main p.lead')")
        assert page.run("document.querySelector('main p.lead').innerText") == "cancelled the rig was stopped by hand"
        assert page.complaints == []


@needs_browser
def test_the_overview_shows_by_itself_what_changes_while_something_runs(plant):
    with tab() as page:
        page.open(f"{plant.service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        page.run("window.kept = true")
        with plant.service.services.database.write() as session:
            rigs.create(session, "bench 9", to_toml(SHEET), "", "", "x")
        page.until(f"document.body.innerText.includes({json.dumps('bench 9')})", 20)
        assert page.run("window.kept")
        assert page.complaints == []


@needs_browser
@pytest.mark.parametrize("place", ["#/", "#/jobs"])
def test_a_page_that_was_open_while_the_service_restarted_shows_again_what_changes(tmp_path, place):
    settings = Settings(home=tmp_path / "home", port=free_port())
    with tab() as page:
        with serving(settings) as service:
            with service.services.database.write() as session:
                rig = rigs.create(session, "bench 7", to_toml(SHEET), "", "", "x").id
                jobs.submit(session, "gap", rig, 1, "x")
            page.open(f"{service.url}/{place}")
            page.until("document.body.innerText.includes('bench 7')")
            page.run("window.kept = true")
        page.until("!document.getElementById('problem').hidden")
        told = page.run("document.getElementById('problem').innerText")
        assert "service does not answer" in told, "not in the browser's words, which differ from one to the next"
        assert "bench 7" in page.text(), "what was known before is still to be read"
        with serving(settings) as service:
            with service.services.database.write() as session:
                jobs.submit(session, "identification", rig, 1, "x")
            page.until("document.body.innerText.includes('identification')")
            assert page.run("document.getElementById('problem').hidden")
            assert page.run("window.kept")
