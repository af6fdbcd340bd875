"""Telling others of a check: what is sent, how it is signed, when it is tried again. Nothing here sends.

Payload and signature follow the Standard Webhooks specification 1.0.0 (standardwebhooks.com), so receivers have
libraries for it: headers ``webhook-id``, ``webhook-timestamp`` and ``webhook-signature`` = ``v1,`` and the base64 of
HMAC-SHA256 over ``id.timestamp.body``; a secret is written ``whsec_`` and base64.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import json
import math
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Any
from urllib.parse import urlsplit

from sim.errors import AmbError
from sim.host_names import must_be_encodable

PREFIX = "whsec_"
RETRY_S = (5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 36000.0)
"""Waits between attempts: eight attempts over some thirty hours."""
TOLERANCE_S = 300.0
"""A receiver refuses what is older: a recorded message cannot be sent again later."""
LONGEST_WAIT_S = 86_400.0
LOOPBACK_SETTING = "webhook_loopback"
"""Field of `service.config.Settings` that lets messages go to receivers on the machine itself."""
METADATA = frozenset(ip_address(a) for a in ("fd00:ec2::254", "100.100.100.200", "192.0.0.192"))
"""Where clouds hand credentials to whoever asks, beside the link-local 169.254.169.254: AWS, Alibaba, Oracle."""


NAT64 = bytes.fromhex("0064ff9b") + bytes(8)
"""The well-known prefix 64:ff9b::/96."""
Address = IPv4Address | IPv6Address


class WebhookError(AmbError):
    """A webhook that cannot be used: its address or secret is wrong, or a signature does not hold."""


@dataclass(frozen=True)
class Message:
    """What is sent: one body, and the headers that prove its origin."""

    body: bytes
    headers: dict[str, str]


def payload(check_id: str, rig_id: str, document: Mapping[str, Any], ended: datetime, url: str = "") -> dict[str, Any]:
    """Contents of a message about a check: what drifted, and where the whole result is.

    Parameters
    ----------
    document
        Of the check (``amb-health-check``).
    url
        Of the check at the service.
    """
    drifted = [
        {
            "parameter": name,
            "change_percent": document["parameters"][name]["change_percent"],
            "significance": document["parameters"][name]["significance"],
        }
        if name in document["parameters"]
        else {"parameter": name, "change_percent": None, "significance": None}
        for name in document["drifted"]
    ]
    return {
        "type": "health.alarm" if document["alarm"] else "health.ok",
        "timestamp": ended.isoformat().replace("+00:00", "Z"),
        "data": {
            "check": check_id,
            "rig": rig_id,
            "rig_name": document["rig"],
            "alarm": document["alarm"],
            "sentence": document["sentence"],
            "drifted": drifted,
            "zone": document["zone"],
            "url": url,
        },
    }


def failed_payload(
    schedule_id: str, job_id: str, rig_id: str, rig_name: str, title: str, detail: str, ended: datetime, url: str = ""
) -> dict[str, Any]:
    """Contents of a message about a check that came to nothing: nobody knows how the rig is.

    Parameters
    ----------
    title, detail
        Of the job's error.
    url
        Of the job at the service.
    """
    return {
        "type": "health.failed",
        "timestamp": ended.isoformat().replace("+00:00", "Z"),
        "data": {
            "schedule": schedule_id,
            "job": job_id,
            "rig": rig_id,
            "rig_name": rig_name,
            "sentence": f"{rig_name}: the check failed: {title}: {detail}",
            "url": url,
        },
    }


def missed_payload(
    schedule_id: str, rig_id: str, rig_name: str, due: datetime, count: int, why: str, at: datetime, url: str = ""
) -> dict[str, Any]:
    """Contents of a message about checks that were not made.

    Parameters
    ----------
    due
        When the last of them was due.
    count
        How many they are.
    url
        Of the schedule's runs at the service.
    """
    due_text = due.isoformat().replace("+00:00", "Z")
    which = f"the check of {due_text} was" if count == 1 else f"{count} checks up to {due_text} were"
    return {
        "type": "health.missed",
        "timestamp": at.isoformat().replace("+00:00", "Z"),
        "data": {
            "schedule": schedule_id,
            "rig": rig_id,
            "rig_name": rig_name,
            "due_at": due_text,
            "missed": count,
            "sentence": f"{rig_name}: {which} not made: {why}",
            "url": url,
        },
    }


def signed(contents: Mapping[str, Any], secret: str, message_id: str, at_unix_s: float) -> Message:
    """A message that its receiver can check; the body is signed byte by byte as it is sent."""
    body = json.dumps(contents, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode("utf-8")
    stamp = str(math.floor(at_unix_s))
    return Message(
        body,
        {
            "content-type": "application/json",
            "webhook-id": message_id,
            "webhook-timestamp": stamp,
            "webhook-signature": f"v1,{_signature(_key(secret), message_id, stamp, body)}",
        },
    )


def verify(message: Message, secret: str, now_unix_s: float) -> None:
    """What a receiver does: compares signature and time.

    Raises
    ------
    WebhookError
        The signature does not hold, or the message is too old or from the future.
    """
    headers = {k.lower(): v for k, v in message.headers.items()}
    try:
        name, stamp, given = (headers[f"webhook-{k}"] for k in ("id", "timestamp", "signature"))
        age = abs(now_unix_s - float(stamp))
    except (KeyError, ValueError) as error:
        raise WebhookError("the message has no webhook-id, webhook-timestamp and webhook-signature") from error
    expected = f"v1,{_signature(_key(secret), name, stamp, message.body)}"
    if not any(hmac.compare_digest(expected.encode(), one.encode()) for one in given.split()):
        raise WebhookError("the signature does not hold: the body was changed, or the secret is another")
    if not age <= TOLERANCE_S:
        raise WebhookError(f"the message is {age:.0f} s off; it may be an old one sent again")


def new_secret() -> str:
    """A fresh secret; show it once."""
    return PREFIX + base64.b64encode(secrets.token_bytes(32)).decode("ascii")


def retry_at(
    attempts: int, last_unix_s: float, retry_after_s: float | None = None, jitter: float = 0.0
) -> float | None:
    """When to try again after a failure; None when it is given up.

    Parameters
    ----------
    attempts
        Made so far, at least one.
    retry_after_s
        What the receiver asked for; a longer wait than the schedule's is granted, up to a day.
    jitter
        In [-1, 1]: a tenth of the wait is spread, so that many messages do not come back at once.

    >>> retry_at(1, 0.0), retry_at(3, 0.0), retry_at(8, 0.0)
    (5.0, 1800.0, None)
    """
    if attempts > len(RETRY_S):
        return None
    wait = RETRY_S[attempts - 1] * (1 + 0.1 * max(-1.0, min(1.0, jitter)))
    return last_unix_s + max(wait, min(retry_after_s or 0.0, LONGEST_WAIT_S))


def worth_retrying(status: int | None) -> bool:
    """Whether another attempt may help: no answer, too many requests, or an error of the receiver's own.

    >>> worth_retrying(None), worth_retrying(503), worth_retrying(429), worth_retrying(410), worth_retrying(404)
    (True, True, True, False, True)
    """
    # 410 is a receiver's way to say: never again (Standard Webhooks); any other refusal may be a deployment under way
    return status != 410 and not (status is not None and 200 <= status < 300)


def checked_url(url: str, loopback: bool = True) -> str:
    """The address, when messages can go there; whether its name leads elsewhere is seen when they are sent.

    Parameters
    ----------
    loopback
        Whether a receiver may be on the machine itself.

    Raises
    ------
    WebhookError
        Not http or https, no host or one that no name server can know, port 0, a password, a fragment, a space or a
        control character; or an address as of `permitted_address`.
    """
    if any(c <= " " or c == "\x7f" for c in url):  # looked for first: urlsplit leaves some of them out
        raise WebhookError(f"webhook address {url!r} has a space or control character; write it as %20 and the like")
    try:
        parts = urlsplit(url)
        host = parts.hostname
        if parts.port == 0:
            raise ValueError("no receiver has the port 0")
        if host:
            _must_be_sendable(host)
    except ValueError as error:
        raise WebhookError(f"webhook address {url!r} cannot be read: {error}") from error
    if parts.scheme not in ("http", "https") or not host:
        raise WebhookError(f"webhook address {url!r} is no http or https address of a host")
    if parts.fragment:
        raise WebhookError(f"webhook address {url!r}: what is behind # reaches no receiver; write a # in it as %23")
    if parts.username or parts.password:
        raise WebhookError("a webhook address holds no user or password: messages are signed instead")
    try:
        address = ip_address(host)
    except ValueError:  # a name
        return url
    permitted_address(url, address, loopback)
    return url


def permitted_address(url: str, address: Address, loopback: bool) -> Address:
    """The address to which a webhook leads, when messages may go there: the service sends from inside the network.

    A plant's receivers are on private networks, which stay possible. What only this machine or this link answers, and
    where clouds hand out credentials, is no receiver.

    Raises
    ------
    WebhookError
        Link-local, multicast, reserved or unspecified, where a cloud keeps credentials; or loopback, unless allowed.
    """
    inner = _embedded(address)
    if inner.is_loopback:
        if loopback:
            return address
        raise WebhookError(
            f"webhook address {url!r} leads to this machine itself ({address}); give the receiver's address on the "
            f"network, or allow it by the setting {LOOPBACK_SETTING} = true (AMBIT_{LOOPBACK_SETTING.upper()}=true)"
        )
    this_network = isinstance(inner, IPv4Address) and inner.packed[0] == 0
    if inner.is_link_local or inner.is_multicast or inner.is_reserved or this_network or inner.is_unspecified:
        raise WebhookError(
            f"webhook address {url!r} leads to {address}, which is link-local, multicast or no host's; "
            "give the receiver's address on the network"
        )
    if inner in METADATA:
        raise WebhookError(
            f"webhook address {url!r} leads to {address}, where a cloud keeps its machines' credentials; "
            "give the receiver's address"
        )
    return address


def _embedded(address: Address) -> Address:
    """The address of version 4 in one of version 6 that stands for it: mapped, 6to4, or NAT64 (RFC 6052)."""
    if isinstance(address, IPv4Address):
        return address
    if address.packed[:12] == NAT64:
        return IPv4Address(address.packed[12:])
    return address.ipv4_mapped or address.sixtofour or address


def _must_be_sendable(host: str) -> None:
    """Raise ValueError for a host that a sender fails to encode: it would come to grief there with every message."""
    if not host.strip("0123456789."):
        IPv4Address(host)
    must_be_encodable(host)


def _key(secret: str) -> bytes:
    try:
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except (binascii.Error, ValueError) as error:
        raise WebhookError(f"a webhook's secret is {PREFIX} and base64; make one with ambit health secret") from error
    if len(key) < 16:
        raise WebhookError("a webhook's secret has at least 16 bytes; make one with ambit health secret")
    return key


def _signature(key: bytes, name: str, stamp: str, body: bytes) -> str:
    signed_text = f"{name}.{stamp}.".encode() + body
    return base64.b64encode(hmac.new(key, signed_text, hashlib.sha256).digest()).decode("ascii")
