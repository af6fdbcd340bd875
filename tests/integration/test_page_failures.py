"""What the page says while the service is away, when its key has ended, and of a document that cannot be given."""

import pytest

from service.access.keys import id_of
from service.config import Settings
from service.storage import jobs, keys, rigs
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow
from sim.rig_file import to_toml
from tests.support.browser import BROWSER
from tests.support.commissioned import SHEET
from tests.support.service import free_port
from tests.support.serving import Serving, serving
from tests.support.tab import tab

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
NOBODY = "modbus://127.0.0.1:9?unit=1"
"""A controller that does not answer."""
PROBLEM = "document.getElementById('problem')"
LIVE = "document.getElementById('live').innerText"
AWAY = "service does not answer"


@pytest.fixture
def settings(tmp_path):
    """Of a service that comes back where it was."""
    return Settings(home=tmp_path / "home", port=free_port())


def add_rig(service: Serving, url: str = NOBODY) -> str:
    with service.services.database.write() as session:
        return rigs.create(session, "bench 7", to_toml(SHEET), url, "", "local").id


def add_running(service: Serving, rig: str) -> tuple[str, int]:
    """A job that runs, and its attempt."""
    with service.services.database.write() as session:
        job = jobs.submit(session, "experiment", rig, 1, "laptop").id
        attempt = jobs.claim(session, job, 1, "w1").attempt
        jobs.note(session, job, attempt, percent=42.0, phase="main")
    return job, attempt


def test_a_service_that_is_away_is_not_told_as_a_controller_that_does_not_answer(settings):
    with tab() as page:
        with serving(settings) as service:
            page.open(f"{service.url}/#/rig/{add_rig(service)}")
            page.until(f"{LIVE}.includes('controller does not answer')")
        page.until(f"{LIVE}.includes('{AWAY}')")
        assert "controller" not in page.run(LIVE)
        with serving(settings):
            page.until(f"{LIVE}.includes('controller does not answer')")


def test_a_rig_that_nobody_sees_live_is_not_told_as_a_controller_that_does_not_answer(settings):
    with serving(settings) as service, tab() as page:
        page.open(f"{service.url}/#/rig/{add_rig(service, 'simulated://')}")
        page.until(f"{LIVE}.includes('simulated inside each job')")
        assert "does not answer" not in page.run(LIVE)
        assert page.run(f"{PROBLEM}.hidden"), "nothing is wrong"


def test_a_job_that_is_watched_says_that_the_service_is_away_until_it_is_back(settings):
    with tab() as page:
        with serving(settings) as service:
            job, attempt = add_running(service, add_rig(service))
            page.open(f"{service.url}/#/job/{job}")
            page.until("document.body.innerText.includes('42 %')")
            assert page.run(f"{PROBLEM}.hidden")
        page.until(f"{PROBLEM}.innerText.includes('{AWAY}')")
        with serving(settings) as service:
            with service.services.database.write() as session:
                jobs.note(session, job, attempt, percent=43.0)
            page.until("document.body.innerText.includes('43 %')")
            assert page.run(f"{PROBLEM}.hidden")


def test_a_job_that_is_watched_says_that_the_key_has_ended(settings):
    with serving(settings) as service, tab() as page:
        first = service.key()
        job, _ = add_running(service, add_rig(service))
        page.open(f"{service.url}/#/job/{job}")
        page.show_key(first)
        page.until("document.body.innerText.includes('42 %')")
        with service.services.database.write() as session:
            keys.revoke(session, str(id_of(first)))
        page.until(f"!{PROBLEM}.hidden && !document.getElementById('key').hidden")
        assert "key" in page.run(f"{PROBLEM}.innerText")
        with service.services.database.write() as session:
            jobs.finish(session, job, 1, jobs.FAILED, {}, "controller tripped", "why")
        page.show_key(service.key())
        page.until("document.querySelector('main .lead').innerText.includes('controller tripped')")
        assert page.run(f"{PROBLEM}.hidden")


def test_a_rig_that_is_looked_at_asks_for_a_key_when_its_own_has_ended(settings):
    with serving(settings) as service, tab() as page:
        first = service.key()
        page.open(f"{service.url}/#/rig/{add_rig(service)}")
        page.show_key(first)
        page.until(f"{LIVE}.includes('controller does not answer')")
        with service.services.database.write() as session:
            keys.revoke(session, str(id_of(first)))
        page.until("!document.getElementById('key').hidden")
        assert "controller" not in page.run(LIVE)
        page.show_key(service.key())
        page.until(f"{LIVE}.includes('controller does not answer') && {PROBLEM}.hidden")


@pytest.mark.parametrize("waiting", [0, 4])
def test_a_stop_that_was_not_done_stays_told_when_the_service_is_back(settings, waiting):
    """Also where so many jobs are alive that the page is refreshed every few seconds."""
    with tab() as page:
        with serving(settings) as service:
            rig = add_rig(service)
            with service.services.database.write() as session:
                for _ in range(waiting):
                    jobs.submit(session, "gap", rig, 1, "laptop")
            job, attempt = add_running(service, rig)
            page.open(f"{service.url}/#/rig/{rig}")
            page.until(f"{LIVE}.includes('controller does not answer')")
        page.until(f"{PROBLEM}.innerText.includes('asks again by itself')")
        stop = "[...document.querySelectorAll('button')].find((b) => b.innerText === 'Stop the excitation')"
        page.run(f"{stop}.click()")
        page.until(f"{PROBLEM}.innerText.includes('may not be done')")
        with serving(settings) as service:
            with service.services.database.write() as session:
                jobs.note(session, job, attempt, percent=43.0)
            page.until(f"document.body.innerText.includes('43 %') && {LIVE}.includes('controller does not answer')")
            assert "may not be done" in page.run(f"{PROBLEM}.innerText")
            page.run("location.hash = '#/'")
            page.until("document.body.innerText.includes('not checked')")
            assert page.run(f"{PROBLEM}.hidden"), "it is of the page that was left"


def test_a_cancel_without_an_answer_is_told_and_can_be_asked_for_again(settings):
    button = "document.querySelector('main button.danger')"
    with tab() as page:
        with serving(settings) as service:
            job, _ = add_running(service, add_rig(service))
            page.open(f"{service.url}/#/job/{job}")
            page.until(button)
        page.run(f"{button}.click()")
        page.until(f"{PROBLEM}.innerText.includes('may not be done')")
        assert not page.run(f"{button}.disabled")
        with serving(settings) as service:
            page.until(f"{button} && !{button}.disabled")
            page.run(f"{button}.click()")
            page.until(f"{button}.innerText === 'stopping'")
            with service.services.database.read() as session:
                assert jobs.get(session, job).cancel_requested


def test_a_retry_without_an_answer_is_told(settings):
    with tab() as page:
        with serving(settings) as service:
            job, _ = add_running(service, add_rig(service))
            with service.services.database.write() as session:
                jobs.finish(session, job, 1, jobs.FAILED, {}, "bus error", "no answer")
            page.open(f"{service.url}/#/job/{job}")
            page.until("document.querySelector('button.retry')")
        page.run("document.querySelector('button.retry').click()")
        page.until(f"{PROBLEM}.innerText.includes('{AWAY}')")
        assert not page.run("document.querySelector('button.retry').disabled")


def test_a_document_that_cannot_be_given_is_told(settings):
    with serving(settings) as service, tab() as page:
        key, rig = service.key(), add_rig(service)
        with service.services.database.write() as session:
            lost = ExperimentRow(
                id=new_id("exp"), rig_id=rig, rig_version=1, source="measured", complete=True, file_bytes=4,
                file_sha256="0" * 64, media_type="application/x-hdf5", file_name="e.h5", summary={},
                created_at=now(), created_by="local",
            )  # fmt: skip
            session.add(lost)
            job = jobs.submit(session, "experiment", rig, 1, "laptop").id
            jobs.claim(session, job, 1, "w1")
            jobs.finish(session, job, 1, jobs.DONE, {"experiment": lost.id})
        page.open(f"{service.url}/#/job/{job}")
        page.show_key(key)
        page.until("document.querySelector('main .state.done')")
        assert page.run(f"{PROBLEM}.hidden")
        page.run("[...document.querySelectorAll('main a')].find((a) => a.innerText === 'experiment').click()")
        page.until(f"!{PROBLEM}.hidden")
        assert "file" in page.run(f"{PROBLEM}.innerText")
