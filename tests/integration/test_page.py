"""The page at the root: its files, and what a person sees in a browser of a service with a history."""

import gzip
import json
import time
from contextlib import closing
from datetime import timedelta

import httpx
import numpy as np
import pytest

from drivers.controller import State
from drivers.device.machine import RigDevice
from drivers.device.serve import ModbusOptions, serve_modbus
from service import web
from service.config import Settings
from service.health.compare import Baseline, compare
from service.jobs.calculations import model_summary
from service.report.curves import curves
from service.storage import jobs, results, rigs
from service.storage.database import now
from service.storage.ids import derived_id, new_id
from service.storage.tables import ExperimentRow, GapRow, HealthRow, JobRow, ModelRow, ScheduleRow, ScheduleRunRow
from sim.reference import reference_rig
from sim.rig_file import to_toml
from tests.support.browser import BROWSER
from tests.support.commissioned import AXES, LAW, SHEET, commissioned, plan, result
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.serving import Serving, serving
from tests.support.tab import HOST, tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
NOBODY = "modbus://127.0.0.1:9?unit=1"
"""A controller that does not answer."""
NAME = 'bench <img src=x onerror="document.title=1">'
GAP = {
    "format": "amb-gap-report",
    "version": 1,
    "verdict": {"kind": "effect", "effects": ["loop_delay"], "sentence": "The rig has a loop_delay of 35 us."},
    "candidates": [
        {"effect": "loop_delay", "probability": 0.97},
        {"effect": "loop_delay+magnetic_cross_coupling+cross_coupled_stiffness", "probability": 0.02},
    ],
    "notes": ["current stiffness xA is <i>far</i> off"],
}


VERDICT = {
    "sentence": "The rig does not <i>behave</i> as its model.",
    "tone": "warn",
    "warnings": ["rotating: residuals over all speeds are 7 times the noise"],
}
"""What a commissioning says beside its figures."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with a rig that has everything, model, gap, checks, a schedule, jobs, and one that was checked once."""
    with serving(Settings(home=tmp_path_factory.mktemp("page") / "home", port=0)) as found:
        yield found


@pytest.fixture(scope="module")
def ids(service: Serving) -> dict[str, str]:
    database, blobs = service.services.database, service.services.blobs
    common = {"rig_version": 1, "created_at": now(), "job_id": None}
    with database.write() as session:
        rig = rigs.create(session, NAME, to_toml(SHEET), "", "a note & <b>more</b>", "local")
        experiment = ExperimentRow(
            id=new_id("exp"), rig_id=rig.id, source="uploaded", complete=True, file_bytes=4,
            file_sha256=blobs.put(b"\x89HDF"), media_type="application/x-hdf5", file_name="e.h5", summary={},
            created_by="local", **common,
        )  # fmt: skip
        session.add(experiment)
        session.flush()
        model = ModelRow(
            id=new_id("mod"), rig_id=rig.id, experiment_id=experiment.id, created_by="local",
            result_sha256=blobs.put(json.dumps(result()).encode()),
            report_sha256=blobs.put(b"<h1>report</h1>"),
            plots_sha256=blobs.put(json.dumps(curves(commissioned(), SHEET)).encode()),
            summary=model_summary({**result(), **VERDICT}), **common,
        )  # fmt: skip
        session.add(model)
        gap = new_id("gap")
        session.add(
            GapRow(
                id=gap, rig_id=rig.id, experiment_id=experiment.id, created_by="local",
                gap_sha256=blobs.put(json.dumps(GAP).encode()), report_sha256=blobs.put(b""),
                summary={"verdict": "effect", "gap_before": 0.12, "noise_floor": 0.001, "closure": 0.98}, **common,
            )
        )  # fmt: skip
        session.flush()
        checks = _checks()
        second = rigs.create(session, "bench 2", to_toml(SHEET), NOBODY, "", "local")
        health = new_id("hc")
        session.add(
            HealthRow(
                id=health, rig_id=second.id, rig_version=1, experiment_id=experiment.id, model_id=model.id,
                schedule_id=None, job_id=None, document=checks[0], report_sha256=blobs.put(b""), alarm=False,
                created_at=now(),
            )
        )  # fmt: skip
        for day, document in enumerate(checks):
            at = now() - timedelta(days=9 - day)
            time.sleep(0.003)  # lists are by id, and ids by the millisecond
            session.add(
                HealthRow(
                    id=new_id("hc"), rig_id=rig.id, rig_version=1, experiment_id=experiment.id, model_id=model.id,
                    schedule_id=None, job_id=None, document=document, report_sha256=blobs.put(b""),
                    alarm=document["alarm"], created_at=at,
                )
            )  # fmt: skip
        schedule = ScheduleRow(
            id=new_id("sch"), rig_id=rig.id, cron="0 6 * * *", options={}, enabled=True, next_at=now(),
            created_at=now(), updated_at=now(), created_by="local",
        )  # fmt: skip
        session.add(schedule)
        session.add(
            ScheduleRow(
                id=new_id("sch"), rig_id=second.id, cron="0 7 * * *", options={}, enabled=True, next_at=now(),
                created_at=now(), updated_at=now(), created_by="local",
            )
        )  # fmt: skip
        session.flush()
        missed = ScheduleRunRow(schedule_id=schedule.id, due_at=now(), state="missed", detail="", recorded_at=now())
        session.add(missed)
        running, ended = (jobs.submit(session, "identification", rig.id, 1, "laptop") for _ in range(2))
        running.state, ended.state = jobs.RUNNING, jobs.FAILED
        ended.error_title, ended.error_detail = "too few points", "plane x: 3 usable points"
        made = {"experiment": experiment.id, "model": model.id, "gap": gap, "health": health}
        return {"rig": rig.id, "second": second.id, "running": running.id, "failed": ended.id, **made}


def _checks() -> list[dict]:
    """Documents of ten checks, the last one an alarm."""
    models = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    found = []
    for seed, loss in ((1, 1.0), (2, 0.9)):
        weak = {p: m.at(np.concatenate([m.theta[:2] * loss, m.theta[2:]])) for p, m in models.items()}
        f = np.array(plan().profile.frequencies_hz)
        sweep = synthetic_sweep(weak, AXES, LAW, f, 0.05, seed=seed)
        found.append(compare(Baseline(result()), synthetic_experiment(sweep, axes=AXES), SHEET).document())
    assert [document["alarm"] for document in found] == [False, True]
    return [found[0]] * 9 + [found[1]]


# ---- files


def test_the_page_and_each_of_its_files_come_with_a_type_a_tag_and_a_policy(service):
    with httpx.Client(base_url=service.url) as client:
        page = client.get("/")
        assert page.status_code == 200
        assert "script-src 'self'" in page.headers["content-security-policy"]
        assert "unsafe" not in page.headers["content-security-policy"].split("script-src")[1].split(";")[0]
        for name in (*web.ASSETS, web.PLOTLY, web.REPORT_STYLE):
            answer = client.get(f"/web/{name}")
            assert answer.status_code == 200, name
            assert answer.headers["content-type"] == web.MEDIA[name[name.rindex(".") :]]
            again = client.get(f"/web/{name}", headers={"If-None-Match": answer.headers["etag"]})
            assert again.status_code == 304
        assert all(f"web/{name}" in page.text for name in ("main.js", "plotly.min.js", "style.css", "report.css"))


def test_files_are_compressed_for_whoever_can_read_that(service):
    with httpx.Client(base_url=service.url) as client:
        plain = client.get(f"/web/{web.PLOTLY}", headers={"Accept-Encoding": "identity"})
        packed = client.get(f"/web/{web.PLOTLY}", headers={"Accept-Encoding": "gzip"})
    assert plain.content == packed.content
    assert int(packed.headers["content-length"]) < 0.4 * int(plain.headers["content-length"])
    assert plain.headers["etag"] != packed.headers["etag"]
    assert gzip.decompress(web.asset(web.PLOTLY).compressed) == plain.content


@pytest.mark.parametrize("name", ["__init__.py", "index.html", "nothing.js", "..%2f..%2fpyproject.toml", "%00"])
def test_nothing_but_its_files_is_served(service, name):
    answer = httpx.get(f"{service.url}/web/{name}")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


# ---- in a browser


@needs_browser
def test_the_overview_lists_rigs_and_jobs_and_reads_no_name_as_html(service, ids):
    with tab() as page:
        page.open(f"{service.url}/")
        page.until("document.querySelectorAll('main section').length === 2")
        text = page.text()
        assert NAME in text
        assert "alarm" in text
        assert "force-current factor of bearing x" in text
        assert "too few points" in text
        assert page.run("document.querySelectorAll('img').length") == 0
        assert page.run("document.title") == "ambit"
        script = (
            "import('./web/dom.js').then((dom) => [dom.fixed(-0.002, 2), dom.fixed(-1.5, 2), dom.figures(-0.01, 1.4)])"
        )
        drawn = page.run(script)
        assert drawn == ["0.00", "-1.50", "0.0 ± 1.4"], "what rounds to nought has no sign"
        assert page.complaints == []


@needs_browser
def test_a_rig_shows_model_gap_health_and_missed_checks(service, ids):
    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['rig']}")
        page.until("document.querySelectorAll('#trend .plot[data-drawn]').length === 28", 40)
        page.until("document.querySelector('#bode[data-drawn]') && document.querySelector('#gap[data-drawn]')")
        text = page.text()
        labels = page.run("[...document.querySelectorAll('#gap .ytick')].map((t) => t.getBoundingClientRect().left)")
        assert min(labels) >= page.run("document.getElementById('gap').getBoundingClientRect().left")
        for words in ("a note & <b>more</b>", "kiA, N/A", "loop_delay of 35 us", "98 %", "10 checks", "missed"):
            assert words in text, words
        assert GAP["notes"][0] in text
        assert "force-current factor of bearing" in text
        assert VERDICT["sentence"] in page.run("[...document.querySelectorAll('.lead.warn')].map((t) => t.textContent)")
        told = "[...document.querySelectorAll('details.notes li')].map((t) => t.textContent)"
        assert page.run(told)[:1] == VERDICT["warnings"]
        assert page.run("document.querySelectorAll('#bode .scatterlayer .trace').length") >= 4
        page.run("document.getElementById('entry').value = 1")
        page.run("document.getElementById('entry').dispatchEvent(new Event('change'))")
        assert page.run("document.getElementById('entry').selectedOptions[0].text") == "y xA / u xB"
        assert page.complaints == []


@needs_browser
def test_a_rig_shows_the_model_and_the_diagnosis_that_were_made_last(service, ids):
    """The first of two commissionings is tried again after the second one; checks compare with what it then finds."""
    database, blobs = service.services.database, service.services.blobs
    with database.write() as session:
        rig = rigs.create(session, "commissioned twice", to_toml(SHEET), "", "", "local")
        submitted = [jobs.submit(session, "experiment", rig.id, 1, "laptop").id for _ in range(2)]
        for job, told, days in ((submitted[1], "the second's", 1), (submitted[0], "the first's, tried again", 0)):
            common = {"rig_id": rig.id, "rig_version": 1, "created_at": now() - timedelta(days=days), "job_id": job}
            experiment = ExperimentRow(
                id=derived_id("exp", job), source="measured", complete=True, file_bytes=4, created_by="laptop",
                file_sha256="0" * 64, media_type="application/x-hdf5", file_name="e.h5", summary={}, **common,
            )  # fmt: skip
            session.add(experiment)
            session.flush()
            summary = model_summary({**result(), **VERDICT, "sentence": f"The model is {told}."})
            plots = blobs.put(json.dumps(curves(commissioned(), SHEET)).encode())
            verdict = {**GAP["verdict"], "sentence": f"The diagnosis is {told}."}
            model = ModelRow(
                id=derived_id("mod", job), experiment_id=experiment.id, created_by="laptop", result_sha256="0" * 64,
                report_sha256="0" * 64, plots_sha256=plots, summary=summary, **common,
            )  # fmt: skip
            session.add(model)
            session.add(
                GapRow(
                    id=derived_id("gap", job), experiment_id=experiment.id, created_by="laptop",
                    gap_sha256=blobs.put(json.dumps({**GAP, "verdict": verdict}).encode()), report_sha256="0" * 64,
                    summary={"verdict": "effect", "gap_before": 0.12, "noise_floor": 0.001, "closure": 0.98}, **common,
                )
            )  # fmt: skip
            session.flush()
        assert results.baseline(session, rig).id == model.id
    with tab() as page:
        page.open(f"{service.url}/#/rig/{rig.id}")
        page.until("document.querySelector('#bode[data-drawn]') && document.querySelector('#gap[data-drawn]')")
        assert "The model is the first's, tried again." in page.text()
        assert "The diagnosis is the first's, tried again." in page.text()
        assert page.complaints == []


@needs_browser
@pytest.mark.parametrize(
    ("states", "told"),
    [
        (["refused", "refused", "missed", "submitted"], "3 of the last 4, newest refused"),
        (["submitted", "missed", "refused"], "2 of the last 3, newest missed"),
        (["submitted", "submitted"], "none of the last 2"),
    ],
)
def test_a_schedule_says_how_many_checks_were_not_made_and_why_the_newest_was_not(service, states, told):
    """One that is refused each time leaves its rig unchecked as one that is missed does."""
    why = {"refused": "the rig has no model to compare with", "missed": "the service was <b>down</b>", "submitted": ""}
    with service.services.database.write() as session:
        rig = rigs.create(session, f"checked by the clock, {told}", to_toml(SHEET), NOBODY, "", "local").id
        schedule = ScheduleRow(
            id=new_id("sch"), rig_id=rig, cron="0 6 * * *", options={}, enabled=True, next_at=now(),
            created_at=now(), updated_at=now(), created_by="local",
        )  # fmt: skip
        session.add(schedule)
        session.flush()
        for day, state in enumerate(states):
            due = now() - timedelta(days=day)
            session.add(
                ScheduleRunRow(
                    schedule_id=schedule.id, due_at=due, state=state, detail=f"{why[state]}, {day}", recorded_at=due
                )
            )
    with tab() as page:
        page.open(f"{service.url}/#/rig/{rig}")
        page.until("document.querySelectorAll('main section').length === 5")
        found = page.run("[...document.querySelectorAll('main section')].pop().innerText")
        assert told in found
        newest = next((day for day, state in enumerate(states) if state != "submitted"), None)
        reasons = [f"{why[state]}, {day}" for day, state in enumerate(states)]
        assert [reason in found for reason in reasons] == [day == newest for day in range(len(states))]
        assert page.complaints == []


@needs_browser
def test_one_check_is_told_in_figures_as_it_is_no_trend(service, ids):
    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['second']}")
        page.until("document.querySelectorAll('#changes table').length === 2")
        text = page.text()
        assert "1 check ·" in text
        assert "no run yet" in text
        assert "x.kiA" in text
        assert page.run("document.querySelectorAll('#trend').length") == 0
        assert page.complaints == []


@needs_browser
def test_a_rig_says_that_a_later_check_than_the_one_it_tells_of_failed(service, ids):
    with service.services.database.write() as session:
        failed = jobs.submit(session, "health", ids["second"], 1, "local")
        jobs.claim(session, failed.id, 1, "w1")
        jobs.finish(session, failed.id, 1, jobs.FAILED, {}, "controller tripped", "at 120 Hz")
    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['second']}")
        page.until("document.querySelector('#changes')")
        section = "[...document.querySelectorAll('section')].find((s) => s.innerText.startsWith('Health'))"
        assert "newest check failed: controller tripped" in page.run(f"{section}.innerText")
        assert page.run(f"{section}.querySelector('a').getAttribute('href')") == f"#/job/{failed.id}"
        page.open(f"{service.url}/#/rig/{ids['rig']}")
        page.until("document.querySelector('#trend')")
        assert "newest check failed" not in page.text()
        assert page.complaints == []


@needs_browser
def test_no_rotor_is_moved_before_somebody_has_confirmed_it(service, ids):
    def moving() -> list[JobRow]:
        with service.services.database.read() as session:
            found = jobs.listed(session, rig_id=ids["second"]).items
            return [job for job in found if job.kind == "experiment"]

    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['second']}")
        page.until("document.querySelector('button.commission')")
        for key in ("Escape", "Enter"):  # neither key that is pressed without a thought moves anything
            page.run("document.querySelector('button.commission').click()")
            page.until("document.querySelector('dialog[open]')")
            asked = page.run("document.querySelector('dialog').innerText")
            for named in ("Commission bench 2?", NOBODY, "80 µm", "6 A", "standard"):
                assert named in asked, named
            page.press(key)
            page.until("!document.querySelector('dialog')")
        assert not moving()
        page.run("document.querySelector('button.commission').click()")
        page.until("document.querySelector('dialog[open]')")
        page.run("document.getElementById('profile').value = 'quick'")
        page.press("Tab")
        assert page.run("document.activeElement.className") == "go danger"
        page.press("Enter")
        page.until("location.hash.startsWith('#/job/')")
        (job,) = moving()
        assert job.options == {"profile": "quick"}

        with service.services.database.write() as session:
            jobs.get(session, job.id).state = jobs.FAILED
        page.open(f"{service.url}/#/job/{job.id}")
        page.run("location.reload()")
        page.until("document.querySelector('button.retry')")
        page.run("document.querySelector('button.retry').click()")
        page.until("document.querySelector('dialog[open]')")
        assert "Try the experiment on bench 2 again?" in page.run("document.querySelector('dialog').innerText")
        page.run("document.querySelector('dialog .go').click()")
        page.until("document.querySelector('.state.queued')", 10)
        assert page.complaints == []


@needs_browser
def test_a_trip_is_acknowledged_on_the_page_once_somebody_has_confirmed_it(service):
    with closing(serve_modbus(RigDevice(reference_rig(), seed=1), ModbusOptions(port=0))) as served, tab() as page:
        with service.services.database.write() as session:
            rig = rigs.create(session, "tripping", to_toml(SHEET), served.url, "", "local").id
        page.open(f"{service.url}/#/rig/{rig}")
        page.until("document.querySelector('#live dl')")
        assert not page.run("document.querySelector('button.acknowledge')")
        served.device.fault("sensor supply lost")
        page.until("document.querySelector('button.acknowledge')")
        page.run("document.querySelector('button.acknowledge').click()")
        page.until("document.querySelector('dialog[open]')")
        assert "sensor supply lost" in page.run("document.querySelector('dialog').innerText")
        page.press("Enter")  # on "Cancel"
        page.until("!document.querySelector('dialog')")
        assert served.device.status().state == State.TRIPPED
        page.run("document.querySelector('button.acknowledge').click()")
        page.run("document.querySelector('dialog .go').click()")
        page.until("document.querySelector('#live dl') && !document.querySelector('button.acknowledge')", 10)
        assert served.device.status().state == State.LEVITATED
        assert page.complaints == []


@needs_browser
@pytest.mark.parametrize("width", [390, 320])
def test_a_phone_shows_every_page_without_scrolling_it_sideways(service, ids, width):
    with tab() as page:
        page.narrow(width)
        for place in ("#/", f"#/rig/{ids['rig']}", f"#/job/{ids['failed']}", "docs"):
            page.open(f"{service.url}/{place}")
            page.until(f"document.documentElement.dataset.shown === '{place}'")
            assert page.run("document.documentElement.scrollWidth") == width, place


@needs_browser
def test_a_job_is_alive_on_the_page_without_reloading(service, ids):
    def report(**values) -> None:
        with service.services.database.write() as session:
            row = session.get(JobRow, ids["running"])
            for name, value in values.items():
                setattr(row, name, value)
            row.changes += 1

    with tab() as page:
        page.open(f"{service.url}/#/job/{ids['running']}")
        page.until("document.body.innerText.includes('running')")
        page.run("window.kept = true")
        report(percent=0.0, point=0, points=0, phase="", time_left_s=None)
        page.until("document.body.innerText.includes('0 %')", 5)
        assert "0 %," not in page.text(), "what just began has no comma for nothing"
        report(percent=42.0, point=126, points=300, phase="main", time_left_s=75.0)
        page.until("document.body.innerText.includes('42 %, 126 of 300 points, 1 min 15 s left')", 5)
        assert page.run("document.querySelector('.bar > i').style.width") == "42%"
        assert "main sweep" in page.text(), "a phase is told as on a terminal"
        report(state=jobs.DONE, ended_at=now())
        page.until("document.querySelector('.state.done')", 5)
        assert page.run("window.kept")
        assert page.complaints == []


@needs_browser
def test_cancel_on_the_page_asks_the_service(service, ids):
    with service.services.database.write() as session:
        job = jobs.submit(session, "gap", ids["rig"], 1, "laptop").id
    with tab() as page:
        page.open(f"{service.url}/#/job/{job}")
        page.until("document.querySelector('button.danger')")
        page.run("document.querySelector('button.danger').click()")
        page.until("document.querySelector('.state.cancelled')", 10)
    with service.services.database.read() as session:
        assert jobs.get(session, job).state == jobs.CANCELLED


@needs_browser
@pytest.mark.parametrize("place", ["#/job/{}", "#/"])
def test_cancel_stays_under_finger_and_focus_while_a_job_tells_how_far_it_is(service, ids, place):
    with service.services.database.write() as session:
        job = jobs.submit(session, "gap", ids["second"], 1, "laptop")
        job.state = jobs.RUNNING
    cancel = "document.querySelector('button.danger')"  # of the newest
    with tab() as page:
        page.open(f"{service.url}/{place.format(job.id)}")
        page.until("document.querySelector('button.danger')")
        time.sleep(1.0)  # the first event is what was read already
        page.run(f"{cancel}.focus(); window.seen = {cancel}; 0")
        for percent in (20.0, 40.0):
            with service.services.database.write() as session:
                row = session.get(JobRow, job.id)
                row.percent, row.changes = percent, row.changes + 1
            page.until(f"document.body.innerText.includes('{percent:.0f} %')")
            assert page.run("document.activeElement.isEqualNode(window.seen)")
            # the overview is drawn anew every few seconds, too, and keeps the focus alone
            drawn_anew = place == "#/" and page.run("!window.seen.isConnected")
            assert drawn_anew or page.run("document.activeElement === window.seen")
            page.run("window.seen = document.activeElement; 0")
        assert page.complaints == []
    with service.services.database.write() as session:
        session.get(JobRow, job.id).state = jobs.CANCELLED


@needs_browser
def test_the_focus_stays_where_it_is_when_the_overview_is_drawn_anew(service, ids):
    with tab() as page:
        page.open(f"{service.url}/#/")
        page.until("document.querySelectorAll('main section').length === 2")
        page.run(f"window.seen = document.querySelector('a[href=\"#/rig/{ids['second']}\"]'); window.seen.focus(); 0")
        page.run("window.dispatchEvent(new HashChangeEvent('hashchange'))")
        page.until("!window.seen.isConnected")
        assert page.run("document.activeElement.href === window.seen.href")


@needs_browser
def test_a_page_that_was_left_listens_to_nothing(service, ids):
    """A browser opens six connections to a server, and keeps pages that were left: the seventh page had no answer."""
    with service.services.database.write() as session:
        job = jobs.submit(session, "gap", ids["second"], 1, "laptop")
        job.state = jobs.RUNNING
    with tab() as page:
        for _ in range(8):
            page.open(f"{service.url}/#/job/{job.id}")
            page.until("document.querySelector('.state.running')", 5)
            time.sleep(0.3)
            page.open("about:blank")
            page.until("location.href === 'about:blank'")
        page.open(f"{service.url}/#/job/{job.id}")
        page.until("document.querySelector('.state.running')", 5)
        page.open("about:blank")
        page.back()
        page.until("document.querySelector('.state.running')", 5)
        with service.services.database.write() as session:
            row = session.get(JobRow, job.id)
            row.state, row.ended_at, row.changes = jobs.CANCELLED, now(), row.changes + 1
        page.until("document.querySelector('.state.cancelled')", 10)


@needs_browser
def test_the_gap_is_diagnosed_from_the_page_and_told_there(service, ids):
    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['rig']}")
        page.until("document.querySelector('button.diagnose')")
        page.run("document.querySelector('button.diagnose').click()")
        page.until("location.hash.startsWith('#/job/') && document.querySelector('.state.queued')")
        made = page.run("location.hash").removeprefix("#/job/")
        with service.services.database.write() as session:
            job = jobs.get(session, made)
            assert (job.kind, job.rig_id, job.experiment_id) == ("gap", ids["rig"], ids["experiment"])
            job.state, job.result, job.ended_at = jobs.DONE, {"gap": ids["gap"]}, now()
            job.changes += 1
        page.until(f"document.body.innerText.includes({json.dumps(GAP['verdict']['sentence'])})", 10)
        link = "[...document.querySelectorAll('a')].find((a) => a.textContent === 'report of the diagnosis')"
        assert httpx.get(page.run(f"{link}.href")).status_code == 200
        assert page.complaints == []


@needs_browser
def test_the_gap_is_diagnosed_from_the_page_however_often_the_rig_was_checked_since(service):
    with service.services.database.write() as session:
        rig = rigs.create(session, "checked daily", to_toml(SHEET), "", "", "local").id
        made = []
        for purpose, complete in (("commissioning", True), ("commissioning", False), *[("health", True)] * 201):
            row = ExperimentRow(
                id=new_id("exp"), rig_id=rig, rig_version=1, source="measured", purpose=purpose, complete=complete,
                file_sha256="0" * 64, file_bytes=1, media_type="application/x-hdf5", file_name="e.h5", summary={},
                created_at=now(), created_by="local",
            )  # fmt: skip
            session.add(row)
            made.append(row.id)
    with tab() as page:
        page.open(f"{service.url}/#/rig/{rig}")
        page.until("document.querySelectorAll('main section').length === 5")
        assert page.run("document.querySelectorAll('button.diagnose').length") == 1
        page.run("document.querySelector('button.diagnose').click()")
        page.until("location.hash.startsWith('#/job/') && document.querySelector('.state.queued')")
        submitted = page.run("location.hash").removeprefix("#/job/")
        assert page.complaints == []
    with service.services.database.read() as session:
        assert jobs.get(session, submitted).experiment_id == made[0]


@needs_browser
def test_a_job_that_failed_is_tried_again_from_the_page(service, ids):
    with service.services.database.write() as session:
        job = jobs.submit(session, "gap", ids["rig"], 1, "laptop")
        job.state, job.error_title = jobs.FAILED, "too few points"
        job = job.id
    with tab() as page:
        page.open(f"{service.url}/#/job/{job}")
        page.until("document.querySelector('button.retry')")
        page.run("document.querySelector('button.retry').click()")
        page.until("document.querySelector('.state.queued') && !document.querySelector('button.retry')", 10)
        assert page.complaints == []
    with service.services.database.read() as session:
        assert (jobs.get(session, job).run, jobs.get(session, job).requested_by) == (2, "local")


@needs_browser
@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("experiment", ["experiment"]),
        ("identification", ["model"]),
        ("gap", ["gap"]),
        ("health", ["experiment", "health"]),
    ],
)
def test_every_document_that_a_finished_job_links_to_is_there(service, ids, kind, made):
    with service.services.database.write() as session:
        job = jobs.submit(session, kind, ids["rig"], 1, "laptop")
        job.state, job.started_at, job.ended_at = jobs.DONE, now(), now()
        job.result = {name: ids[name] for name in made}
        place = f"#/job/{job.id}"
    with tab() as page:
        page.open(f"{service.url}/{place}")
        page.until(f"document.documentElement.dataset.shown === '{place}'")
        if kind == "gap":
            page.until("document.body.innerText.includes('report of the diagnosis')")
        links = page.run("[...document.querySelectorAll('#view a')].map((a) => a.href).filter((a) => !a.includes('#'))")
        assert len(set(links)) == len(made)
        for link in links:
            assert httpx.get(link).status_code == 200, link
        assert page.complaints == []


@needs_browser
def test_a_service_with_keys_asks_for_one_and_keeps_it_in_the_tab(tmp_path):
    with serving(Settings(home=tmp_path / "home", port=0)) as service, tab() as page:
        with service.services.database.write() as session:
            rigs.create(session, "bench 7", to_toml(SHEET), "", "", "local")
        key = service.key()
        page.open(f"{service.url}/")
        page.until("!document.getElementById('key').hidden")
        assert "bench 7" not in page.text()
        page.show_key(key[:-1] + "x")
        page.until("!document.getElementById('problem').hidden")
        page.show_key(key)
        page.until("document.body.innerText.includes('bench 7')")
        assert page.run("document.getElementById('key').hidden")
        assert page.run("localStorage.length + document.cookie.length") == 0
        assert key not in page.run("document.documentElement.outerHTML")


@needs_browser
def test_a_job_is_submitted_from_a_page_that_another_machine_shows_over_plain_http(tmp_path):
    with serving(Settings(home=tmp_path / "home", port=0)) as service, tab() as page:
        with service.services.database.write() as session:
            rig = rigs.create(session, "bench 7", to_toml(SHEET), NOBODY, "", "local").id
        page.open(f"{service.url.replace('127.0.0.1', HOST)}/#/rig/{rig}")
        page.show_key(service.key())
        page.until("document.querySelector('button.commission')")
        assert not page.run("isSecureContext"), "on the machine itself a browser offers more"
        for _ in range(2):
            page.run("document.querySelector('button.commission').click()")
            page.run("document.querySelector('dialog .go').click()")
            page.until("location.hash.startsWith('#/job/') && document.querySelector('.state.queued')")
            page.back()
            page.until("document.querySelector('button.commission')")
        with service.services.database.read() as session:
            assert len(jobs.listed(session, "queued", "experiment", rig).items) == 2, "two wishes are two jobs"


@needs_browser
def test_what_the_service_refuses_is_said_on_the_page(service):
    with tab() as page:
        page.open(f"{service.url}/#/rig/{new_id('rig')}")
        page.until("!document.getElementById('problem').hidden")
        assert "no" in page.run("document.getElementById('problem').textContent")


@needs_browser
def test_what_is_refused_does_not_leave_another_page_under_the_error(service, ids):
    with tab() as page:
        page.open(f"{service.url}/#/rig/{ids['rig']}")
        page.until("document.querySelectorAll('#view table').length > 0")
        page.run(f"location.hash = '#/rig/{new_id('rig')}'")
        page.until("!document.getElementById('problem').hidden")
        assert page.run("document.querySelectorAll('#view table').length") == 0


@needs_browser
def test_the_description_of_the_api_is_read_in_a_browser(service):
    with tab() as page:
        page.open(f"{service.url}/docs")
        page.until("document.documentElement.dataset.shown === 'docs'")
        for told in ("POST /api/v1/jobs", "GET /api/v1/rigs/{rig_id}/trend", "ProfileOptions"):
            assert told in page.text()
        assert page.complaints == []
