"""Webhooks: a real receiver checks the signature; what it does not take is sent again, and then given up."""

import asyncio
import json
import ssl
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from itertools import repeat
from types import SimpleNamespace

import pytest

from service.config import Settings
from service.health.webhook import Message, new_secret, verify
from service.jobs import context as contexts
from service.jobs import notices, steps, workflows
from service.storage import jobs, rigs, schedules
from service.storage.database import now
from service.storage.tables import ExperimentRow, HealthRow, ModelRow, ScheduleRow, WebhookRow
from tests.support.certificates import make_authority
from tests.support.databases import migrated
from tests.support.service import reference_sheet


class Receiver(HTTPServer):
    """Keeps what it is told, and answers as it was told to."""

    def __init__(self):
        self.messages, self.answers, self.heard, self.more = [], [], lambda: None, None
        self.after, self.sent, self.location = "", 0, ""
        super().__init__(("127.0.0.1", 0), Handler)


class Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        self.server.messages.append(Message(body, dict(self.headers)))
        self.server.heard()
        self.send_response(self.server.answers.pop(0) if self.server.answers else 204)
        if self.server.after:
            self.send_header("retry-after", self.server.after)
        if self.server.location:
            self.send_header("location", self.server.location)
        if self.server.more is None:
            self.send_header("content-length", "0")
        self.end_headers()
        with suppress(OSError):  # the caller has heard enough
            for part in self.server.more or ():
                self.wfile.write(part)
                self.server.sent += len(part)

    def log_message(self, *_):
        pass


@pytest.fixture
def receiver():
    server = Receiver()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def told(tmp_path, monkeypatch):
    """Deliveries that were handed to the engine."""
    with migrated("sqlite", tmp_path) as database:
        handed = []
        context = SimpleNamespace(
            database=database,
            dispatcher=SimpleNamespace(notify=lambda delivery_id, number: handed.append(delivery_id)),
            settings=Settings(home=tmp_path, public_url="https://rotor.example.org", webhook_loopback=True),
        )
        monkeypatch.setattr(contexts, "_context", context)
        yield SimpleNamespace(database=database, handed=handed, dispatcher=context.dispatcher, context=context)


def check(database, url, alarm, secret="", on="alarm"):
    document = {"rig": "bench", "alarm": alarm, "zone": "A", "drifted": [], "sentence": "as it was", "parameters": {}}
    common = {"rig_version": 1, "created_at": now()}
    with database.write() as session:
        rig = rigs.create(session, f"bench {url} {alarm} {on}", reference_sheet(), "", "", "me").id
        session.add(
            ScheduleRow(
                id="sch_1", rig_id=rig, cron="0 6 * * *", options={}, enabled=True, webhook_url=url,
                webhook_secret=secret, webhook_on=on, created_at=now(), updated_at=now(), created_by="me",
            )
        )  # fmt: skip
        session.add(
            ExperimentRow(
                id="exp_1", rig_id=rig, source="measured", complete=True, file_sha256="", file_bytes=0,
                media_type="", file_name="", summary={}, created_by="me", **common,
            )
        )  # fmt: skip
        session.flush()
        session.add(
            ModelRow(
                id="mod_1", rig_id=rig, experiment_id="exp_1", result_sha256="", report_sha256="", plots_sha256="",
                summary={}, created_by="me", **common,
            )
        )  # fmt: skip
        session.flush()
        session.add(
            HealthRow(
                id="hc_1", rig_id=rig, experiment_id="exp_1", model_id="mod_1", schedule_id="sch_1", alarm=alarm,
                document=document, report_sha256="", **common,
            )
        )  # fmt: skip
    return "hc_1"


def delivery(told, delivery_id="whd_1"):
    with told.database.read() as session:
        return session.get(WebhookRow, delivery_id)


def attempt(told, delivery_id="whd_1"):
    """Make the next attempt; seconds until the one after it, None when there shall be none."""
    notices.attempt(delivery_id, delivery(told, delivery_id).attempts + 1)
    row = delivery(told, delivery_id)
    return None if row.next_at is None else (row.next_at - row.updated_at).total_seconds()


def hand_over_due(told):
    """Attempts that are handed over now, by the message and their number."""
    handed = []
    dispatcher = SimpleNamespace(notify=lambda *given: handed.append(given))
    notices.hand_over_all(told.database, dispatcher)
    return handed


def make_due(told):
    """The clock reaches the next attempt."""
    with told.database.write() as session:
        session.get(WebhookRow, "whd_1").next_at = now()


def test_an_alarm_is_signed_and_heard(told, receiver):
    secret = new_secret()
    health = check(told.database, f"http://127.0.0.1:{receiver.server_port}/hook", True, secret)
    notices.begin(health)
    notices.begin(health)  # a step that is repeated
    assert told.handed == ["whd_1", "whd_1"]
    assert attempt(told) is None
    for number in (1, 2):  # a step that is repeated, and an attempt too many
        notices.attempt("whd_1", number)
    (message,) = receiver.messages  # once
    verify(message, secret, now().timestamp())
    assert b'"type":"health.alarm"' in message.body
    assert b'"url":"https://rotor.example.org/api/v1/health-checks/hc_1"' in message.body
    assert (delivery(told).state, delivery(told).attempts, delivery(told).status_code) == ("delivered", 1, 204)


def failed_check(told, url):
    """A scheduled check that failed; its id."""
    check(told.database, url, False, new_secret())
    with told.database.write() as session:
        rig = session.get(ScheduleRow, "sch_1").rig_id
        job = jobs.submit(session, "health", rig, 1, "schedule sch_1", schedule_id="sch_1")
        jobs.finish(session, job.id, 1, jobs.FAILED, {}, "bus error", "no answer")
        return job.id


def test_a_check_that_failed_is_told_whatever_the_webhook_wants_to_know(told, receiver):
    job = failed_check(told, f"http://127.0.0.1:{receiver.server_port}/")
    for _ in range(2):  # a step that is repeated
        notices.begin_failed(job, 1)
    assert len(set(told.handed)) == 1
    assert attempt(told, told.handed[0]) is None
    (message,) = receiver.messages
    body = json.loads(message.body)
    assert (body["type"], body["data"]["job"]) == ("health.failed", job)
    assert body["data"]["url"] == f"https://rotor.example.org/api/v1/jobs/{job}"
    assert "bus error: no answer" in body["data"]["sentence"]
    with told.database.write() as session:  # tried again, and failed again: another message
        jobs.retry(session, job, "me")
        jobs.finish(session, job, 2, jobs.FAILED, {}, "bus error", "no answer")
    notices.begin_failed(job, 1)  # a late word of the first run
    notices.begin_failed(job, 2)
    assert len(set(told.handed)) == 2


def test_the_workflow_of_a_check_tells_that_it_failed(monkeypatch):
    begun = []
    answers = {"measure": {"state": "failed", "result": {}, "title": "bus error", "detail": "no answer"}}
    monkeypatch.setattr(notices, "begin_failed", lambda *run: begun.append(run))
    monkeypatch.setattr(steps, "finish", lambda *_: None)
    monkeypatch.setattr(
        workflows.DBOS, "run_step", lambda options, work, *given: answers.get(options["name"]) or work(*given)
    )
    workflows.health.__wrapped__("job_1", 2)
    assert begun == [("job_1", 2)]


def test_a_message_that_the_engine_was_not_told_of_is_handed_over_later(told):
    def away(*_):
        raise OSError("no engine")

    health, told.dispatcher.notify = check(told.database, "http://127.0.0.1:9/", True, new_secret()), away
    notices.begin(health)
    assert hand_over_due(told) == [("whd_1", 1)]
    assert hand_over_due(told) == []


def test_while_the_engine_is_away_one_message_says_so_for_all(told, caplog):
    def away(*_):
        raise OSError("no engine")

    health, told.dispatcher.notify = check(told.database, "http://127.0.0.1:9/", True, new_secret()), away
    notices.begin(health)
    with told.database.write() as session:
        schedules.add_delivery(session, session.get(ScheduleRow, "sch_1"), "whd_2", {"type": "health.missed"})
    caplog.clear()
    notices.hand_over_all(told.database, told.dispatcher)
    assert len(caplog.records) == 1
    assert hand_over_due(told) == [("whd_1", 1), ("whd_2", 1)]


def test_an_attempt_is_made_when_it_is_due_and_until_then_nothing_waits_for_it(told, receiver):
    receiver.answers = [503, 503]
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/hook", True, new_secret()))
    for number in (1, 2):
        notices.attempt("whd_1", number)
        assert hand_over_due(told) == []
        make_due(told)
        assert hand_over_due(told) == [("whd_1", number + 1)]
        assert hand_over_due(told) == []
    notices.attempt("whd_1", 3)
    assert (delivery(told).state, len(receiver.messages)) == ("delivered", 3)
    assert hand_over_due(told) == []


def test_an_attempt_that_is_over_before_it_is_noted_as_handed_over_is_followed_by_the_next(told, receiver):
    receiver.answers = [503]
    health = check(told.database, f"http://127.0.0.1:{receiver.server_port}/hook", True, new_secret())
    told.dispatcher.notify = notices.attempt
    notices.begin(health)
    make_due(told)
    assert hand_over_due(told) == [("whd_1", 2)]


def test_a_message_that_an_earlier_version_waited_with_in_the_engine_is_sent_by_its_row_alone(told, receiver):
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    workflows.notice.__wrapped__("whd_1")
    assert receiver.messages == []
    assert (delivery(told).state, delivery(told).attempts) == ("pending", 0)


def test_a_message_of_an_earlier_version_is_sent_all_the_same(told, receiver):
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    with told.database.write() as session:
        session.get(WebhookRow, "whd_1").contents = {}
    attempt(told)
    assert b'"type":"health.alarm"' in receiver.messages[0].body


def test_what_is_not_taken_is_sent_again_and_at_last_given_up(told, receiver):
    receiver.answers = [503, 500, 410]
    health = check(told.database, f"http://127.0.0.1:{receiver.server_port}/hook", True, new_secret())
    notices.begin(health)
    waits = [attempt(told) for _ in range(3)]
    assert 4 < waits[0] < 6
    assert 250 < waits[1] < 350
    assert waits[2] is None  # 410: never again
    assert (delivery(told).state, delivery(told).attempts) == ("failed", 3)


def test_a_receiver_that_is_away_is_tried_again(told, receiver):
    health = check(told.database, "http://127.0.0.1:9/hook", True, new_secret())
    notices.begin(health)
    assert attempt(told) > 4
    assert (delivery(told).state, delivery(told).status_code) == ("pending", None)


@pytest.mark.parametrize("url", ["http://☃.xn--0/", "http://xn--0/", "http://host/\x01", "http://a..b/"])
def test_an_address_that_cannot_be_used_is_a_failed_attempt(told, url):
    notices.begin(check(told.database, url, True, new_secret()))  # as an earlier version kept it
    assert attempt(told) > 4
    assert (delivery(told).state, delivery(told).attempts) == ("pending", 1)
    assert delivery(told).detail


def resolved(monkeypatch, *addresses):
    """Every name leads to these addresses in turn, the last one for ever; the names that were asked for."""
    asked, left = [], list(addresses)

    async def getaddrinfo(_, host, port, **__):
        asked.append(host)
        found = left.pop(0) if len(left) > 1 else left[0]
        return [(0, 0, 0, "", (address, port)) for address in found]

    monkeypatch.setattr(asyncio.BaseEventLoop, "getaddrinfo", getaddrinfo)
    return asked


def test_a_receiver_on_the_machine_itself_is_told_only_where_a_setting_allows_it(told, receiver):
    told.context.settings = Settings(home=told.context.settings.home, host="0.0.0.0")
    notices.begin(check(told.database, f"http://localhost:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) > 4
    assert receiver.messages == []
    assert (delivery(told).state, delivery(told).status_code) == ("pending", None)
    assert f"http://localhost:{receiver.server_port}/" in delivery(told).detail
    assert "AMBIT_WEBHOOK_LOOPBACK=true" in delivery(told).detail
    told.context.settings = Settings(home=told.context.settings.home, host="0.0.0.0", webhook_loopback=True)
    assert attempt(told) is None
    assert len(receiver.messages) == 1
    assert receiver.messages[0].headers["host"] == f"localhost:{receiver.server_port}"


def test_a_name_that_has_come_to_lead_elsewhere_is_looked_at_when_it_is_sent_to(told, receiver, monkeypatch):
    """By what it leads to at the first look: at a second one it may be another."""
    asked = resolved(monkeypatch, ["127.0.0.1"], ["169.254.169.254"])
    notices.begin(check(told.database, f"http://plant.example:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) is None
    assert asked[0] == "plant.example"
    assert len(receiver.messages) == 1


def test_a_name_that_leads_to_credentials_is_told_nothing(told, receiver, monkeypatch):
    resolved(monkeypatch, ["fe80::1", "169.254.169.254"])
    notices.begin(check(told.database, f"http://plant.example:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) > 4
    assert receiver.messages == []
    assert "leads to 169.254.169.254, which is link-local" in delivery(told).detail


def test_of_a_receiver_s_addresses_the_next_one_is_tried(told, receiver, monkeypatch):
    resolved(monkeypatch, ["fe80::1", "127.77.0.1", "127.0.0.1"])
    notices.begin(check(told.database, f"http://plant.example:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) is None
    assert len(receiver.messages) == 1


@pytest.mark.parametrize(("name", "heard"), [("plant.example", 1), ("another.example", 0)])
def test_a_receiver_shows_the_certificate_of_its_name(told, receiver, monkeypatch, tmp_path, name, heard):
    """Not of the address that it has: the authority is one of the machine's own."""
    made, context = make_authority(tmp_path), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(made.server.certificate, made.server.key)
    receiver.socket = context.wrap_socket(receiver.socket, server_side=True)
    monkeypatch.setenv("SSL_CERT_FILE", str(made.ca))
    resolved(monkeypatch, ["127.0.0.1"])
    notices.begin(check(told.database, f"https://{name}:{receiver.server_port}/", True, new_secret()))
    assert (attempt(told) is None) == bool(heard)
    assert len(receiver.messages) == heard
    assert ("certificate verify failed" in delivery(told).detail) == (not heard)


def test_a_redirect_is_not_followed(told, receiver):
    receiver.answers, receiver.location = [307], f"http://127.0.0.1:{receiver.server_port}/elsewhere"
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) > 4
    assert len(receiver.messages) == 1
    assert (delivery(told).state, delivery(told).status_code) == ("pending", 307)


def test_a_proxy_looks_up_the_name_itself(told, receiver, monkeypatch):
    monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{receiver.server_port}")
    monkeypatch.delenv("no_proxy", raising=False)
    notices.begin(check(told.database, "http://no-such-host.invalid/", True, new_secret()))
    assert attempt(told) is None
    assert len(receiver.messages) == 1


@pytest.mark.parametrize(("after", "least", "most"), [("60", 60, 61), ("²", 4, 6)])
def test_a_receiver_asks_for_time_in_digits(told, receiver, after, least, most):
    receiver.answers, receiver.after = [503], after
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    assert least <= attempt(told) <= most


def test_an_answer_without_end_is_read_as_far_as_a_reason_goes(told, receiver):
    receiver.answers, receiver.more = [500], repeat(b"why\0" * 16384, 1000)
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    assert attempt(told) > 4
    assert (delivery(told).state, delivery(told).status_code) == ("pending", 500)
    assert delivery(told).detail == "why\N{REPLACEMENT CHARACTER}" * 125
    assert receiver.sent < 32e6  # what the connection holds, of 65 MB


def test_an_answer_that_comes_byte_by_byte_is_not_waited_for(told, receiver, monkeypatch):
    monkeypatch.setattr(notices, "DEADLINE_S", 0.5)
    receiver.answers, receiver.more = [500], (time.sleep(0.1) or b"." for _ in range(30))
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    began = time.monotonic()
    assert attempt(told) > 4
    assert time.monotonic() - began < 2
    assert delivery(told).detail == "no whole answer within 0.5 s"


def test_messages_of_a_webhook_that_was_removed_are_given_up(told, receiver):
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    with told.database.write() as session:
        session.get(ScheduleRow, "sch_1").webhook_secret = ""
    assert attempt(told) is None
    assert receiver.messages == []
    assert (delivery(told).state, delivery(told).detail) == ("failed", "the webhook was removed")


def test_a_check_that_ends_after_its_schedule_was_removed_is_told_to_nobody(told, receiver):
    health = check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret())
    with told.database.write() as session:
        session.get(ScheduleRow, "sch_1").deleted_at = now()
    notices.begin(health)
    assert told.handed == []


def test_what_is_given_up_while_it_is_sent_is_not_sent_again(told, receiver):
    receiver.answers = [503]
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    receiver.heard = lambda: give_up(told)
    assert attempt(told) is None
    assert (delivery(told).state, delivery(told).status_code) == ("failed", 503)
    assert attempt(told) is None
    assert len(receiver.messages) == 1
    assert hand_over_due(told) == []


def give_up(told):
    with told.database.write() as session:
        schedules.give_up_deliveries(session, "sch_1", schedules.REMOVED)


@pytest.mark.parametrize(("alarm", "on", "heard"), [(False, "alarm", 0), (False, "always", 1), (True, "alarm", 1)])
def test_only_who_wants_to_know_is_told(told, receiver, alarm, on, heard):
    health = check(told.database, f"http://127.0.0.1:{receiver.server_port}/", alarm, new_secret(), on)
    notices.begin(health)
    assert len(told.handed) == heard


def test_an_attempt_at_which_the_engine_fails_is_one_that_nobody_heard_and_one_that_was_heard_stays_so(told, receiver):
    notices.begin(check(told.database, f"http://127.0.0.1:{receiver.server_port}/", True, new_secret()))
    notices.not_made("whd_1", 1, RuntimeError("database or disk is full\nand more"))
    assert (delivery(told).state, delivery(told).attempts) == ("pending", 1)
    assert "database or disk is full" in delivery(told).detail
    make_due(told)
    assert hand_over_due(told) == [("whd_1", 2)]
    notices.attempt("whd_1", 2)
    notices.not_made("whd_1", 2, RuntimeError())  # of an error that says nothing, too
    assert (delivery(told).state, delivery(told).attempts) == ("delivered", 2)
