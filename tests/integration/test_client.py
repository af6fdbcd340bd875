"""The client against the real application: typed answers, errors that say what to do, a watch that goes on."""

import json
import re
import socket
import threading
import time
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import h5py
import httpx
import pytest
from sqlalchemy import update

from service.access.keys import Scope
from service.cli import run
from service.client import (
    Client,
    ClientError,
    ConflictingError,
    JobEndedError,
    KeyRefusedError,
    MissingError,
    RefusedError,
    UnreachableError,
)
from service.client.shapes import Job, Rig
from service.config import Settings
from service.storage import jobs as job_rows
from service.storage.database import now
from service.storage.tables import JobRow
from sim.reference import reference_datasheet
from sim.rig_file import to_toml
from tests.support.api import assert_problem, commissioned
from tests.support.command import wait_until
from tests.support.service import rig_device
from tests.support.serving import serving
from tests.support.two_axes import sheet_of_one_plane
from tests.support.uploads import HOSTILE, good, good_matlab

SHEET = to_toml(reference_datasheet())
NO_IDS = ("nonsense", "", "../rigs")


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with serving(Settings(home=tmp_path_factory.mktemp("home"), port=0)) as service:
        service.operator = service.key(Scope.operator)
        yield service


@pytest.fixture
def ambit(service):
    with Client(service.url, service.operator, patience_s=5) as client:
        yield client


@pytest.fixture(scope="module")
def rig(service):
    with Client(service.url, service.operator) as client:
        return client.rigs.create(SHEET, "simulated://", name="bench")


@pytest.fixture
def sent(ambit, rig, tmp_path):
    return ambit.experiments.upload(rig.id, good(tmp_path / "a b.h5"))


def change(service, job_id: str, **values) -> None:
    """What a worker would write."""
    with service.services.database.write() as session:
        session.execute(update(JobRow).where(JobRow.id == job_id).values(changes=JobRow.changes + 1, **values))


def test_rigs(ambit, rig):
    assert ambit.rigs.get(rig.id).datasheet == SHEET
    assert ambit.rigs.named("bench").id == rig.id
    assert rig.id in [r.id for r in ambit.rigs.list()]
    changed = ambit.rigs.change(ambit.rigs.get(rig.id), SHEET, "simulated://?seed=2")
    assert changed.version == rig.version + 1
    assert ambit.rigs.get(rig.id, version=rig.version).controller_url == "simulated://"
    with pytest.raises(ConflictingError, match="read it again"):
        ambit.rigs.change(rig, SHEET, "")
    with pytest.raises(ConflictingError):
        ambit.rigs.create(SHEET, name="bench")


def losing(client: Client, sends: bool = True) -> None:
    """Lose the answer to the next change of a client, or with it the change."""
    request = client._transport._http.request

    def lose(method: str, *words, **how):
        if method == "PUT":
            client._transport._http.request = request
            if sends:
                assert request(method, *words, **how).is_success
            raise httpx.ReadTimeout("the answer is lost")
        return request(method, *words, **how)

    client._transport._http.request = lose


def test_a_change_whose_answer_was_lost_is_not_somebody_else_s(service, ambit):
    rig = ambit.rigs.create(SHEET, "simulated://", name="far away")
    losing(ambit)
    rig = ambit.rigs.change(rig, SHEET, "simulated://?seed=2")
    assert (rig.version, rig.controller_url) == (2, "simulated://?seed=2")
    experiment = commissioned(service, rig.id)
    model = experiment.replace("exp_", "mod_")
    losing(ambit)
    assert ambit.rigs.choose_baseline(rig, model).baseline_model == model
    schedule = ambit.schedules.create(rig.id, "0 3 * * *")
    losing(ambit)
    assert ambit.schedules.change(schedule.model_copy(update={"cron": "0 4 * * *"})).cron == "0 4 * * *"

    # but somebody else's is, though an answer was lost
    with Client(service.url, service.operator) as other:
        losing(ambit, sends=False)
        lost = ambit._transport._http.request

        def meanwhile(method: str, *words, **how):
            if method == "PUT":
                other.rigs.change(rig, SHEET, "simulated://?seed=4")
            return lost(method, *words, **how)

        ambit._transport._http.request = meanwhile
        with pytest.raises(ConflictingError):
            ambit.rigs.change(rig, SHEET, "simulated://?seed=3")


def test_a_known_rig_is_given_no_other_controller_or_datasheet_by_mistake(service, ambit, tmp_path, capsys):
    """The controller of one rig is not that of another of its make, whose datasheet has the same name."""
    sheet = tmp_path / "rig.toml"
    sheet.write_text(SHEET.replace('"reference"', '"of a make"', 1))
    rig = ambit.rigs.create(sheet.read_text())

    def submit(*more: str) -> str:
        """The error, or nothing; no job is left to move a rotor."""
        words = ("submit", "experiment", "--rig", str(sheet), "--url", service.url, "--key", service.operator, *more)
        status = run(list(words))
        shown = capsys.readouterr()
        assert (status == 0) == (not shown.err), shown
        assert len(shown.err.splitlines()) <= 1
        return shown.err

    first, second = "simulated://?seed=1", "simulated://?seed=2"
    assert not submit("--controller", first)  # it had none
    assert not submit("--controller", first)
    assert not submit()
    told = submit("--controller", second)
    assert all(part in told for part in (rig.id, f"'{first}'", f"'{second}'", "--change")), told
    assert f"'{first}', not ''" in submit("--controller", "")
    assert ambit.rigs.get(rig.id).version == 2
    assert not submit("--controller", second, "--change")
    assert ambit.rigs.get(rig.id).controller_url == second
    old, new = 'name = "of a make"', 'name = "of a make" # as built'
    sheet.write_text(sheet.read_text().replace(old, new))
    told = submit()
    assert all(part in told for part in (f"'{old}'", f"'{new}'", "--change")), told
    both = submit("--controller", first)
    assert f"'{first}' and a datasheet with '{old}', not '{new}'" in both
    assert not submit("--change")
    assert new in ambit.rigs.get(rig.id).datasheet
    assert ambit.rigs.get(rig.id).controller_url == second


@pytest.fixture
def new_sheet(tmp_path):
    """The datasheet of a rig that the service does not know."""
    sheet = tmp_path / "rig.toml"
    sheet.write_text(SHEET.replace('"reference"', '"not known yet"', 1))
    return sheet


def submitted(service, capsys, kind: str, rig, *more: str) -> tuple[int, str]:
    """Exit status and error of ambit submit for a rig, or its datasheet."""
    words = ("submit", kind, "--rig", str(rig), "--url", service.url, "--key", service.operator, *more)
    status = run(list(words))
    return status, " ".join(capsys.readouterr().err.replace("│", "").split())


@pytest.mark.parametrize("name", ["rig_bench2", "rig_" + "a" * 25])
def test_a_rig_and_a_file_may_be_named_as_if_they_were_ids(service, ambit, tmp_path, capsys, monkeypatch, name):
    rig = ambit.rigs.create(SHEET, name=name)
    assert ambit.rigs.named(name).id == ambit.rigs.named(rig.id).id == rig.id
    monkeypatch.chdir(tmp_path)
    good(tmp_path / "exp_run3.h5")
    assert submitted(service, capsys, "identification", name, "--experiment", "exp_run3.h5") == (0, "")
    (sent,) = ambit.experiments.list(rig.id)
    assert submitted(service, capsys, "identification", name, "--experiment", sent.id) == (0, "")
    assert [job.experiment for job in ambit.jobs.list(rig=rig.id)] == [sent.id, sent.id]
    status, told = submitted(service, capsys, "identification", name, "--experiment", "exp_run4.h5")
    assert (status, "cannot read exp_run4.h5" in told) == (1, True)


def test_the_name_of_a_retired_rig_leads_to_its_history_and_to_another_name(service, ambit, tmp_path, capsys):
    sheet = tmp_path / "rig.toml"
    sheet.write_text(SHEET.replace('"reference"', '"pump 7"', 1))
    assert submitted(service, capsys, "experiment", sheet, "--controller", "simulated://") == (0, "")
    rig = ambit.rigs.named("pump 7")
    with Client(service.url, service.key(Scope.admin)) as admin:
        admin.rigs.retire(rig.id)
    assert rig.id not in [r.id for r in ambit.rigs.list()]
    for kind, given in (("experiment", sheet), ("health", sheet), ("experiment", "pump 7")):
        status, told = submitted(service, capsys, kind, given)
        assert status == 1
        assert f"the rig 'pump 7' ({rig.id}) was retired at 20" in told
        assert "a new rig takes another name" in told
    with pytest.raises(
        ConflictingError, match=r"was retired at 20.* UTC, and its history keeps the name; give another"
    ):
        ambit.rigs.create(sheet.read_text())
    assert ambit.rigs.named(rig.id).name == "pump 7"
    for name in ("pump 7", rig.id):
        words = ["--rig", name, "--url", service.url, "--key", service.operator]
        assert run(["jobs", *words, "--json"]) == 0
        (job,) = json.loads(capsys.readouterr().out)["jobs"]
        assert (job["rig"], job["state"]) == (rig.id, "cancelled")
        assert run(["jobs", *words]) == 0
        assert "pump 7" in capsys.readouterr().out
        assert run(["schedules", *words]) == 0
        capsys.readouterr()
    sheet.write_text(sheet.read_text().replace('"pump 7"', '"pump 7 (2)"', 1))
    assert submitted(service, capsys, "experiment", sheet, "--controller", "simulated://") == (0, "")


def test_what_moves_a_rotor_makes_no_rig_known_that_cannot_be_moved(service, ambit, new_sheet, capsys):
    def known() -> list[Rig]:
        return [rig for rig in ambit.rigs.list() if rig.name == "not known yet"]

    status, told = submitted(service, capsys, "experiment", new_sheet)
    assert status == 2
    assert "--controller" in told
    assert "the rig 'not known yet' has no controller yet" in told
    status, told = submitted(service, capsys, "health", new_sheet, "--controller", "simulated://")
    assert status == 1
    assert "commission it first: ambit submit experiment" in told
    assert known() == []
    rig = ambit.rigs.create(new_sheet.read_text())
    assert submitted(service, capsys, "experiment", new_sheet)[0] == 2
    assert "no controller_url" in submitted(service, capsys, "experiment", rig.name)[1]
    new_sheet.write_text(new_sheet.read_text() + "# as built\n")
    assert submitted(service, capsys, "experiment", new_sheet, "--change")[0] == 2
    assert [(found.id, found.version) for found in known()] == [(rig.id, 1)]
    assert submitted(service, capsys, "experiment", new_sheet, "--change", "--controller", "simulated://") == (0, "")
    assert submitted(service, capsys, "experiment", new_sheet) == (0, "")


def test_errors_say_what_to_do(ambit):
    with pytest.raises(MissingError) as missing:
        ambit.jobs.get("job_0")
    assert missing.value.status == 404
    assert missing.value.request_id
    with pytest.raises(RefusedError, match="datasheet"):
        ambit.rigs.create("[rig]")
    with pytest.raises(MissingError, match="no rig 'nobody'"):
        ambit.rigs.named("nobody")


def test_a_key_is_never_shown_however_it_was_copied(service, capsys, monkeypatch):
    monkeypatch.setenv("AMBIT_KEY", f"{service.operator}\r\n")  # of a file as some editors write one
    assert run(["rigs", "--url", service.url]) == 0
    for broken in ("ambit_secret\r\nambit_other", "ambit_secr\u00e9t"):
        monkeypatch.setenv("AMBIT_KEY", broken)
        capsys.readouterr()
        assert run(["rigs", "--url", service.url]) == 1
        told = capsys.readouterr().err
        assert "the API key holds a character that no key has" in told
        assert "secr" not in told


@pytest.mark.parametrize(
    ("job", "status", "said"),
    [
        ("job_0", 1, "ambit: there is no job 'job_0'; list them with ambit jobs"),
        *((job, 2, f"{job!r} is no id of a job, which begins with job_; ambit jobs lists them") for job in NO_IDS),
    ],
)
@pytest.mark.parametrize("command", ["watch", "cancel", "retry"])
def test_a_job_that_there_is_not_is_told_with_where_they_are(service, capsys, command, job, status, said):
    assert run([command, job, "--url", service.url, "--key", service.operator]) == status
    assert said in capsys.readouterr().err


def test_keys(service, rig):
    with Client(service.url, "ambit_00000000_" + "0" * 48) as nobody, pytest.raises(KeyRefusedError, match="not known"):
        nobody.rigs.get(rig.id)
    with Client(service.url, service.key(Scope.viewer)) as viewer:
        assert viewer.rigs.get(rig.id)
        with pytest.raises(KeyRefusedError, match="operator"):
            viewer.jobs.submit("experiment", rig.id)


def test_uploads(ambit, rig, sent, tmp_path):
    assert (sent.file_name, sent.summary["sweeps"][0]["points"]) == ("a b.h5", 8)
    back = ambit.experiments.save(sent.id, tmp_path / "back" / "x.h5")
    assert len(back.read_bytes()) == sent.file_bytes
    assert not list(back.parent.glob(".*"))
    assert ambit.experiments.upload(rig.id, good_matlab(tmp_path / "m.mat")).summary["file_format"] == "MATLAB 5"
    assert sent.id in [e.id for e in ambit.experiments.list(rig.id)]
    assert sent.id in [e.id for e in ambit.experiments.list(rig.id, purpose="commissioning", complete=True)]
    assert sent.id not in [e.id for e in ambit.experiments.list(rig.id, purpose="health")]
    assert sent.id not in [e.id for e in ambit.experiments.list(rig.id, complete=False)]


def test_an_uploaded_file_of_a_stopped_campaign_is_no_whole_commissioning(ambit, rig, tmp_path):
    """Checks of the rig's health would be compared with what it knew by then."""
    path = good(tmp_path / "stopped.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["incomplete"] = "the rig tripped"
    kept = ambit.experiments.upload(rig.id, path)
    assert (kept.complete, kept.summary["incomplete"]) == (False, "the rig tripped")


@pytest.mark.parametrize("name", ["1e9 elements", "external link", "zip", "NaN", "half", "mat, cells 20,000 deep"])
def test_a_hostile_upload_is_refused_over_http_too(service, ambit, rig, tmp_path, name):
    make, status, said = HOSTILE[name]
    with pytest.raises(RefusedError) as refused:
        ambit.experiments.upload(rig.id, make(tmp_path / "bad.h5"))
    assert refused.value.status == status
    assert said in refused.value.detail
    assert ambit.rigs.get(rig.id)


def test_a_file_of_other_axes_than_the_rig_s_is_refused_when_it_is_sent(ambit, rig, tmp_path):
    """Two axes are a rig of its own, with a datasheet of two axes; every job on the file would fail."""
    plane = good(tmp_path / "plane.h5", n_axes=2)
    with pytest.raises(RefusedError, match=r"axes xA, xB and the rig xA, xB, yA, yB; .* datasheet") as refused:
        ambit.experiments.upload(rig.id, plane)
    assert refused.value.status == 422
    of_a_plane = ambit.rigs.create(to_toml(sheet_of_one_plane(reference_datasheet())), name="plane")
    assert ambit.experiments.upload(of_a_plane.id, plane).summary["axes"] == ["xA", "xB"]


def test_a_file_larger_than_the_limit(tmp_path, rig):
    small = Settings(home=tmp_path / "small", port=0, max_upload_bytes=5000)
    with serving(small) as service, Client(service.url) as client:
        known = client.rigs.create(SHEET)
        with pytest.raises(RefusedError) as refused:
            client.experiments.upload(known.id, good(tmp_path / "a.h5"))
        assert refused.value.status == 413


def test_a_file_that_does_not_tell_its_length_is_larger_than_the_limit(tmp_path, caplog):
    small = Settings(home=tmp_path / "small", port=0, max_upload_bytes=5000)
    with serving(small) as service, Client(service.url) as client:
        path = f"{service.url}/api/v1/rigs/{client.rigs.create(SHEET).id}/experiments"
        parts = iter([b"x" * 2000] * 4)
        answer = httpx.post(path, content=parts, headers={"content-type": "application/x-hdf5"})
        assert_problem(answer, 413, "5,000 bytes")
    assert not [r for r in caplog.records if r.levelname == "ERROR"]


def test_a_sender_that_goes_away_in_the_middle_of_a_file_is_no_defect(tmp_path, caplog):
    caplog.set_level("INFO", "service.api.middleware")
    with serving(Settings(home=tmp_path / "home", port=0)) as service, Client(service.url) as client:
        where = httpx.URL(f"{service.url}/api/v1/rigs/{client.rigs.create(SHEET).id}/experiments")
        head = f"POST {where.path} HTTP/1.1\r\nHost: {where.host}\r\nContent-Type: application/x-hdf5\r\n"
        with socket.create_connection((where.host, where.port)) as sender:
            sender.sendall(f"{head}Content-Length: 1000\r\n\r\nhalf of it".encode())
        wait_until(lambda: " 499 in " in caplog.text, "the end of the request")
    assert not [r for r in caplog.records if r.levelname == "ERROR"]


def test_a_job_is_watched_to_its_end(service, ambit, rig, sent):
    job = ambit.jobs.submit("identification", rig.id, sent.id, priority=3)
    assert (job.state, job.priority, job.ended) == ("queued", 3, False)

    def work() -> None:
        time.sleep(0.3)
        change(service, job.id, state=job_rows.RUNNING, started_at=now(), phase="main", points=10)
        for point in (5, 10):
            time.sleep(0.3)
            change(service, job.id, point=point, percent=10.0 * point, time_left_s=1.0)
        time.sleep(0.3)
        change(service, job.id, state=job_rows.DONE, ended_at=now(), result={"model": "mod_1"})

    worker = threading.Thread(target=work)
    worker.start()
    seen = list(ambit.jobs.events(job.id))
    worker.join()
    assert [e.job.state for e in seen if e.kind == "state"] == ["queued", "running", "done"]
    assert [e.job.progress.percent for e in seen] == sorted(e.job.progress.percent for e in seen)
    assert seen[-1].job.result == {"model": "mod_1"}
    assert ambit.jobs.wait(job.id).state == "done"


def test_a_job_that_failed_says_why(service, ambit, rig, sent):
    job = ambit.jobs.submit("identification", rig.id, sent.id)
    change(service, job.id, state=job_rows.FAILED, error_title="No rotor", error_detail="it is gone")
    with pytest.raises(JobEndedError, match="No rotor: it is gone") as ended:
        ambit.jobs.wait(job.id)
    assert ended.value.job.id == job.id
    assert ambit.jobs.retry(job.id).state == "queued"
    assert ambit.jobs.cancel(job.id).state == "cancelled"
    assert job.id in [j.id for j in ambit.jobs.list(state="cancelled", rig=rig.id)]


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        ({"state": job_rows.FAILED, "error_title": "No rotor", "error_detail": "it is gone"}, "failed: No rotor: it"),
        ({"state": job_rows.CANCELLED}, "was cancelled"),
        ({"state": job_rows.CANCELLED, "phase": job_rows.cancelled_as("it was sold")}, "was cancelled: it was sold"),
        ({}, "is still queued; wait for it with: ambit watch"),
    ],
)
def test_fetching_from_a_job_that_is_not_done_gets_what_there_is_and_fails(
    service, ambit, rig, sent, tmp_path, capsys, ended, said
):
    job = ambit.jobs.submit("identification", rig.id, sent.id)
    change(service, job.id, **ended)
    words = ["fetch", job.id, "--out", str(tmp_path), "--url", service.url, "--key", service.operator]
    assert run(words) == 1
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert line.startswith(f"ambit: the job {job.id} ")
    assert said in line
    assert {p.name for p in tmp_path.iterdir()} == {"rig.toml", "experiment.h5", "a b.h5"}
    change(service, job.id, state=job_rows.DONE)
    assert run(words) == 0


def test_a_list_says_why_a_job_was_cancelled(service, ambit, rig, sent, capsys):
    job = ambit.jobs.submit("identification", rig.id, sent.id)
    change(service, job.id, state=job_rows.CANCELLED, phase=job_rows.cancelled_as("sold"))
    assert run(["jobs", "--limit", "1", "--url", service.url, "--key", service.operator]) == 0
    assert "sold" in capsys.readouterr().out


def test_a_wait_that_is_too_long_ends(service, ambit, rig, sent):
    job = ambit.jobs.submit("identification", rig.id, sent.id)
    ticking = threading.Event()

    def tick() -> None:
        while not ticking.wait(0.1):
            change(service, job.id, phase="busy")

    ticker = threading.Thread(target=tick)
    ticker.start()
    with pytest.raises(TimeoutError, match="goes on"):
        ambit.jobs.wait(job.id, timeout_s=0.5)
    ticking.set()
    ticker.join()


def test_lists_go_over_pages(ambit, rig, sent):
    made = {ambit.jobs.submit("identification", rig.id, sent.id).id for _ in range(3)}
    paged = list(ambit._transport.pages("/jobs", lambda job: job["id"], limit=2))
    assert made <= set(paged)
    assert len(paged) == len(set(paged))


def test_a_service_that_is_away():
    with Client("http://127.0.0.1:1", patience_s=0.3) as nobody:
        with pytest.raises(UnreachableError, match="AMBIT_URL"):
            list(nobody.rigs.list())
        with pytest.raises(UnreachableError):
            list(nobody.jobs.watch("job_0"))


def test_whoever_waits_for_a_service_that_is_away_is_told_at_once():
    """Once for each request, and not only when the patience is at its end."""
    told = []
    with Client("http://127.0.0.1:1", patience_s=1.0, waiting=told.append) as nobody:
        for ask in (lambda: nobody.rigs.stop("rig_0"), lambda: list(nobody.jobs.watch("job_0"))):
            with pytest.raises(UnreachableError):
                ask()
            (why,) = told
            assert why.startswith("the service at http://127.0.0.1:1 does not answer (")
            told.clear()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["stop", "bench"], r"not stopped yet: (.*); trying on, use the hardware stop meanwhile"),
        (["acknowledge", "bench"], r"(.*); trying again"),
        (["jobs"], r"(.*); trying again"),
    ],
)
def test_a_command_says_that_the_service_is_away_before_it_gives_up(monkeypatch, capsys, words, said):
    monkeypatch.setattr("service.client.Client", partial(Client, patience_s=0.5))
    assert run([*words, "--url", "http://127.0.0.1:1"]) == 1
    first, last = capsys.readouterr().err.splitlines()
    why = re.fullmatch(said, first)
    assert why, first
    assert last.startswith(f"ambit: {why[1]}; is it running?")


class Ailing(BaseHTTPRequestHandler):
    """Answers each request by what comes next: it is busy, breaks off, lacks what is asked for, or sends a file."""

    FILE = b"an experiment" * 1000

    def do_GET(self):
        answer = self.server.answers.pop(0) if len(self.server.answers) > 1 else self.server.answers[0]
        body = self.FILE if isinstance(answer, str) else b'{"detail": "try again in a moment"}'
        self.send_response(200 if isinstance(answer, str) else answer)
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if answer == "half" else body)

    def log_message(self, *_):
        pass


@pytest.fixture
def ailing():
    server = ThreadingHTTPServer(("127.0.0.1", 0), Ailing)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def fetch(ailing, to, patience_s, *answers):
    """Fetch a file from a service that answers like that; why it was waited for."""
    ailing.answers, told = list(answers), []
    url = f"http://127.0.0.1:{ailing.server_port}"
    with Client(url, "", patience_s=patience_s, waiting=told.append) as client:
        client.experiments.save("exp_1", to)
    return told


def test_a_file_is_fetched_whole_from_a_service_that_is_busy_or_breaks_off_for_a_moment(ailing, tmp_path):
    told = fetch(ailing, tmp_path / "a.h5", 20, 503, "half", 503, "whole")
    assert (tmp_path / "a.h5").read_bytes() == Ailing.FILE
    assert told == ["try again in a moment"]  # once


@pytest.mark.parametrize(("patience_s", "answers"), [(0.5, [503]), (0.5, ["half"]), (20, [404, "whole"])])
def test_a_file_that_is_not_to_be_had_is_told_and_leaves_nothing(ailing, tmp_path, patience_s, answers):
    with pytest.raises(ClientError):
        fetch(ailing, tmp_path / "a.h5", patience_s, *answers)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("url", ["rotor", "ftp://127.0.0.1", "http://127.0.0.1:x", "http://["])
def test_an_address_that_is_none(url):
    with pytest.raises(UnreachableError, match="--url"), Client(url, patience_s=0.2) as nobody:
        nobody.jobs.get("job_0")


def test_a_watch_survives_a_restart_of_the_service(tmp_path):
    settings = Settings(home=tmp_path / "home", port=0)
    with serving(settings) as first, Client(first.url) as client:
        rig = client.rigs.create(SHEET)
        experiment = client.experiments.upload(rig.id, good(tmp_path / "a.h5"))
        job = client.jobs.submit("identification", rig.id, experiment.id)
        port = int(first.url.rpartition(":")[2])
    seen = []
    with Client(f"http://127.0.0.1:{port}", patience_s=20) as client:
        watcher = threading.Thread(target=lambda: seen.extend(client.jobs.watch(job.id)))
        watcher.start()
        for state in (job_rows.RUNNING, job_rows.DONE):
            with serving(settings.model_copy(update={"port": port})) as again:
                change(again, job.id, state=state)
                deadline = time.monotonic() + 20
                while not any(j.state == state for j in seen):
                    assert time.monotonic() < deadline, [j.state for j in seen]
                    time.sleep(0.02)
        watcher.join(20)
    assert [j.state for j in seen] == ["running", "done"]


def test_the_address_of_a_report_is_one_that_a_browser_can_open():
    """With keys a browser is refused what it cannot show a key for; the page asks for it."""
    job = Job(id="job_1", kind="identification", rig="rig_1", state="done", result={"model": "mod_1"})
    with Client("http://plant:1", "") as free, Client("http://plant:1", "ambit_key_secret") as guarded:
        assert free.report_address(job) == "http://plant:1/api/v1/models/mod_1/report.html"
        assert guarded.report_address(job) == "http://plant:1/#/job/job_1"


def test_a_rig_is_seen_and_stopped_live(ambit, tmp_path):
    device = rig_device(tmp_path)
    try:
        rig = ambit.rigs.create(SHEET, device.url, name="live")
        status = ambit.rigs.status(rig.id)
        assert (status.reachable, status.state, status.excitation_a) == (True, "levitated", 0.0)
        ambit.rigs.stop(rig.id)
        assert ambit.rigs.acknowledge(rig.id).acknowledged is None
    finally:
        device.device.end()
