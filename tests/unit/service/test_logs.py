"""A line of the log tells which job, rig and request it belongs to, in one form, and never a secret."""

import io
import json
import logging

import pytest

from service import logs
from service.access import keys
from service.access.keys import Scope


@pytest.fixture
def restored():
    root = logging.getLogger()
    before = (root.handlers[:], root.level)
    yield
    root.handlers[:], level = before
    root.setLevel(level)
    logging.captureWarnings(False)


@pytest.fixture
def lines(restored):
    stream = io.StringIO()
    logs.configure("info", "json", stream)
    return lambda: [json.loads(line) for line in stream.getvalue().splitlines()]


def test_a_line_is_json_with_ids_and_time(lines):
    with logs.bound(job="job_1", rig="rig_1", request=None):
        logging.getLogger("service.jobs").info("point %d of %d", 3, 10, extra={"hz": 12.5})
    logging.getLogger("service.jobs").info("idle")
    first, second = lines()
    assert first["message"] == "point 3 of 10"
    assert (first["job"], first["rig"], first["hz"], first["level"]) == ("job_1", "rig_1", 12.5, "info")
    assert first["logger"] == "service.jobs"
    assert first["time"].endswith("Z")
    assert "request" not in first
    assert "job" not in second


def test_ids_nest_and_end(lines):
    with logs.bound(request="r"), logs.bound(job="j"):
        assert dict(logs.bound_ids()) == {"request": "r", "job": "j"}
    assert dict(logs.bound_ids()) == {}


def test_configured_twice_says_it_once(restored):
    stream = io.StringIO()
    for _ in range(2):
        logs.configure("info", "json", stream)
    logging.getLogger("a").info("once")
    assert len(stream.getvalue().splitlines()) == 1


def test_level_and_console(restored):
    stream = io.StringIO()
    logs.configure("warning", "console", stream)
    logging.getLogger("a").info("quiet")
    logging.getLogger("a").warning("loud", extra={"rig": "rig_1"})
    text = stream.getvalue()
    assert "quiet" not in text
    assert "loud" in text
    assert "rig_1" in text


KEY = keys.issue("key_018f2a3b4c5d", "laptop", Scope.admin)[1]
SECRET = KEY.rsplit("_", 1)[1]


@pytest.mark.parametrize("form", ["json", "console"])
@pytest.mark.parametrize(
    ("say", "secret"),
    [
        (lambda log: log.info("refused %s", KEY), SECRET),
        (lambda log: log.info("header Authorization: Bearer abcdef123456"), "abcdef123456"),
        (lambda log: log.info("Basic dXNlcjpwYXNz"), "dXNlcjpwYXNz"),
        (lambda log: log.info("connecting to postgresql://ambit:hush@db:5432/ambit"), "hush"),
        (lambda log: log.info("postgresql://ambit:h:u/sh@db/ambit"), "h:u/sh"),
        (lambda log: log.info("env", extra={"database_password": "hush"}), "hush"),
        (lambda log: log.info("webhook", extra={"hook": {"url": "https://h/x", "secret": "hush"}}), "hush"),
        (lambda log: log.info("headers", extra={"headers": [{"Authorization": "x-hush"}]}), "x-hush"),
        (lambda log: log.info('{"webhook_secret": "hush"}'), "hush"),
        (lambda log: log.info("password=hush&x=1"), "hush"),
        (lambda log: log.info("-----BEGIN PRIVATE KEY-----\nMIIhush\n-----END PRIVATE KEY-----"), "MIIhush"),
    ],
    ids=range(11),  # a key is another one in every process, and so would be its test's name
)
def test_a_secret_never_reaches_the_log(restored, form, say, secret):
    stream = io.StringIO()
    logs.configure("info", form, stream)
    say(logging.getLogger("a"))
    assert stream.getvalue()
    assert secret not in stream.getvalue()


@pytest.mark.parametrize("form", ["json", "console"])
def test_an_exception_brings_its_trace_and_not_its_secret(restored, form):
    stream = io.StringIO()
    logs.configure("info", form, stream)
    try:
        raise RuntimeError(f"cannot reach postgresql://ambit:hush@db with {KEY}")
    except RuntimeError:
        logging.getLogger("a").exception("failed")
    text = stream.getvalue()
    assert "RuntimeError" in text
    assert "test_logs.py" in text
    assert text.count("Traceback") == 1
    assert form == "console" or json.loads(text)["message"] == "failed"
    assert "hush" not in text
    assert SECRET not in text


def test_what_is_no_secret_is_left_alone():
    text = "rig bench-3 at modbus://10.0.0.7:502?unit=1: 0.25 A, https://host/a@b, token bucket is full"
    assert logs.redacted(text) == text
