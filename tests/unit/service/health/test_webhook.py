"""Messages that a receiver can trust."""

import base64
import hashlib
import hmac
import json
from datetime import UTC, datetime

import pytest

from service.config import Settings
from service.health.webhook import (
    RETRY_S,
    Message,
    WebhookError,
    checked_url,
    new_secret,
    payload,
    retry_at,
    signed,
    verify,
    worth_retrying,
)

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
DOCUMENT = {
    "rig": "reference",
    "alarm": True,
    "sentence": "reference: force-current factor of bearing xA -5 %",
    "drifted": ["x.kiA", "x.unexplained"],
    "parameters": {"x.kiA": {"change_percent": -5.0, "significance": -80.0}},
    "zone": "A",
}


def trusted(message: Message, secret: str, now: float) -> bool:
    """Whether a receiver believes a message."""
    try:
        verify(message, secret, now)
    except WebhookError:
        return False
    return True


def test_the_example_of_the_standard_webhooks_specification():
    """Id, time, secret and signature as the specification's reference implementations test them."""
    body = b'{"test": 2432232314}'
    expected = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
    message = Message(
        body,
        {
            "webhook-id": "msg_p5jXN8AQM9LWM0D4loKWxJek",
            "webhook-timestamp": "1614265330",
            "webhook-signature": expected,
        },
    )
    assert trusted(message, SECRET, 1614265330.0)


def test_a_receiver_can_check_a_message_with_nothing_but_hmac():
    message = signed(payload("hc_1", "rig_1", DOCUMENT, datetime(2026, 3, 1, 6, tzinfo=UTC)), SECRET, "msg_1", 1000.7)
    key = base64.b64decode(SECRET.removeprefix("whsec_"))
    want = hmac.new(key, b"msg_1.1000." + message.body, hashlib.sha256).digest()
    assert message.headers["webhook-signature"] == "v1," + base64.b64encode(want).decode()
    assert trusted(message, SECRET, 1010.0)
    sent = json.loads(message.body)
    assert sent["type"] == "health.alarm"
    assert sent["timestamp"] == "2026-03-01T06:00:00Z"
    assert sent["data"]["drifted"][0] == {"parameter": "x.kiA", "change_percent": -5.0, "significance": -80.0}
    assert sent["data"]["drifted"][1]["parameter"] == "x.unexplained"


@pytest.mark.parametrize("spoil", ["body", "id", "timestamp", "secret", "late", "missing"])
def test_whatever_was_changed_is_noticed(spoil):
    message = signed({"a": 1}, SECRET, "msg_1", 1000.0)
    body, headers, secret, now = message.body, dict(message.headers), SECRET, 1001.0
    match spoil:
        case "body":
            body = body.replace(b"1", b"2")
        case "id":
            headers["webhook-id"] = "msg_2"
        case "timestamp":
            headers["webhook-timestamp"] = "1001"
        case "secret":
            secret = new_secret()
        case "late":
            now = 1000.0 + 301.0
        case "missing":
            del headers["webhook-signature"]
    assert not trusted(Message(body, headers), secret, now)


def test_an_old_and_a_new_secret_may_sign_together():
    message = signed({"a": 1}, SECRET, "msg_1", 1000.0)
    other = signed({"a": 1}, new_secret(), "msg_1", 1000.0)
    both = f"{other.headers['webhook-signature']} {message.headers['webhook-signature']}"
    assert trusted(Message(message.body, {**message.headers, "webhook-signature": both}), SECRET, 1000.0)


def test_retries_come_ever_later_and_end():
    times = [0.0]
    while (again := retry_at(len(times), times[-1])) is not None:
        times.append(again)
    assert len(times) == len(RETRY_S) + 1
    assert 24 * 3600 < times[-1] < 48 * 3600
    assert all(b - a >= 0.9 * wait for a, b, wait in zip(times, times[1:], RETRY_S, strict=False))


def test_a_receiver_may_ask_for_more_time_but_not_for_ever():
    assert retry_at(1, 100.0, retry_after_s=60.0) == 160.0
    assert retry_at(1, 0.0, retry_after_s=1e9) == 86_400.0
    assert 4.5 <= retry_at(1, 0.0, jitter=-1.0) < retry_at(1, 0.0, jitter=1.0) <= 5.5


def test_success_is_not_repeated_and_gone_is_final():
    assert not worth_retrying(204)
    assert not worth_retrying(410)
    assert worth_retrying(500)


@pytest.mark.parametrize(
    "bad",
    [
        *("ftp://host/x", "http:///x", "https://user:pass@host/", "host/x", "http://[::1"),
        *("http://a..b/", "http://.a/", f"http://{'a' * 300}/", "http://☃.net/", "http://☃.xn--0/", "http://xn--0/"),
        *("http://999.1.1.1/", "http://host/\x01", "http://ho\tst/", " http://host/", "http://host/a b"),
        *("http://host:0/", "http://host:99999/", "http://host/hook#token", "http://host%2f/", "http://ho%73t/"),
    ],
)
def test_addresses_that_cannot_be_used_are_refused(bad):
    with pytest.raises(WebhookError):
        checked_url(bad)
    assert checked_url("https://host:8443/hook?x=1") == "https://host:8443/hook?x=1"


@pytest.mark.parametrize(
    "host", ["my_host", "host.", "192.0.2.1:80", "[::1]:80", "münchen.example", "xn--mnchen-3ya.example"]
)
def test_addresses_that_can_be_used_are_left_as_they_are(host):
    assert checked_url(f"http://{host}/x%20y?z=ü") == f"http://{host}/x%20y?z=ü"


LOCAL = ["127.0.0.1", "127.8.9.1", "[::1]", "[::ffff:127.0.0.1]"]
NOWHERE = [
    *("169.254.169.254", "169.254.1.1", "[fe80::1]", "[::ffff:169.254.169.254]", "[64:ff9b::a9fe:a9fe]"),
    *("[2002:a9fe:a9fe::1]", "[fd00:ec2::254]", "100.100.100.200", "192.0.0.192", "0.0.0.0", "0.1.2.3", "[::]"),
    *("224.0.0.1", "[ff02::1]", "255.255.255.255", "240.0.0.1"),
]


@pytest.mark.parametrize("host", NOWHERE)
@pytest.mark.parametrize("loopback", [False, True])
def test_no_message_goes_where_a_cloud_keeps_credentials_or_to_no_host(host, loopback):
    url = f"http://{host}:8000/latest"
    with pytest.raises(WebhookError) as told:
        checked_url(url, loopback)
    assert url in str(told.value)
    assert "give the receiver's address" in str(told.value)


@pytest.mark.parametrize("host", LOCAL)
def test_a_receiver_on_the_machine_itself_is_allowed_by_a_setting(host):
    url = f"http://{host}:8311/hook"
    with pytest.raises(WebhookError) as told:
        checked_url(url, loopback=False)
    assert url in str(told.value)
    assert "AMBIT_WEBHOOK_LOOPBACK=true" in str(told.value)
    assert "webhook_loopback" in Settings.model_fields
    assert checked_url(url, loopback=True) == url


@pytest.mark.parametrize("host", ["10.1.2.3", "172.16.0.9", "192.168.1.7", "[fd12::9]", "100.64.0.1", "192.0.2.1", "h"])
def test_a_receiver_may_be_on_a_private_network(host):
    assert checked_url(f"http://{host}/", loopback=False)


@pytest.mark.parametrize("bad", ["", "whsec_", "whsec_c2hvcnQ=", "not base64!"])
def test_weak_secrets_are_refused(bad):
    with pytest.raises(WebhookError):
        signed({}, bad, "m", 0.0)


def test_secrets_are_all_different_and_strong():
    secrets = {new_secret() for _ in range(20)}
    assert len(secrets) == 20
    assert all(len(base64.b64decode(s.removeprefix("whsec_"))) == 32 for s in secrets)
