"""Telling webhooks of health checks: what to tell is kept first, then sent until it is heard or too late."""

from __future__ import annotations

import asyncio
import logging
import random
import socket
import time
from datetime import UTC, datetime
from ipaddress import ip_address
from typing import Any
from urllib.parse import urldefrag, urlsplit
from urllib.request import getproxies, proxy_bypass

import httpx
from sqlalchemy.orm import Session

from service.health import webhook
from service.jobs.context import Context, context
from service.jobs.engine import Dispatcher
from service.storage import jobs, results, rigs, schedules
from service.storage.database import Database, now
from service.storage.ids import derived_id
from service.storage.schedules import DELIVERED, FAILED, PENDING, REMOVED
from service.storage.tables import HealthRow, ScheduleRow, WebhookRow

log = logging.getLogger(__name__)
TIMEOUT_S = 10.0
"""For each step of an attempt: to connect, to send, to receive a part."""
DEADLINE_S = 30.0
"""For all of an attempt: a receiver that answers byte by byte never exceeds the time for a step."""
LARGEST = 4096
"""Bytes that are read of an answer: a reason is in its first lines, and what else there is may never end."""


def begin(health_id: str) -> None:
    """Tell the webhook of a check's schedule, if it has one and wants to know."""
    worker = context()
    delivery_id = derived_id("whd", health_id)

    def prepare(session: Session) -> bool:
        check = results.get(session, HealthRow, health_id)
        schedule = None if check.schedule_id is None else session.get(ScheduleRow, check.schedule_id)
        if schedule is None or (schedule.webhook_on == "alarm" and not check.alarm):
            return False
        return schedules.add_delivery(session, schedule, delivery_id, _contents(worker, check), health_id)

    if worker.database.surely(prepare):
        _hand_over(worker.database, worker.dispatcher, delivery_id)


def begin_failed(job_id: str, run: int) -> None:
    """Tell the webhook of a check's schedule that the check failed: silence would pass for a healthy rig."""
    worker = context()
    delivery_id = f"{derived_id('whd', job_id)}f{run}"

    def prepare(session: Session) -> bool:
        job = jobs.get(session, job_id)
        schedule = None if job.schedule_id is None else session.get(ScheduleRow, job.schedule_id)
        if schedule is None or job.run != run or job.state != jobs.FAILED:
            return False
        rig = rigs.get(session, job.rig_id)
        url = worker.settings.link(f"/jobs/{job.id}")
        contents = webhook.failed_payload(
            schedule.id, job.id, rig.id, rig.name, job.error_title, job.error_detail, job.ended_at or now(), url
        )
        return schedules.add_delivery(session, schedule, delivery_id, contents)

    if worker.database.surely(prepare):
        _hand_over(worker.database, worker.dispatcher, delivery_id)


def hand_over_all(database: Database, dispatcher: Dispatcher) -> None:
    """Tell the engine of every attempt that is due and that it was not told of."""
    with database.read() as session:
        waiting = schedules.undispatched(session, now())
    for delivery_id, number in waiting:
        if not _hand_over(database, dispatcher, delivery_id, number):
            break  # the others would not get there either, and each would say so


def _hand_over(database: Database, dispatcher: Dispatcher, delivery_id: str, number: int = 1) -> bool:
    """Tell the engine of an attempt; False when it could not be told now."""
    try:
        dispatcher.notify(delivery_id, number)
        with database.write() as session:
            schedules.dispatched(session, delivery_id, number)
    except Exception as error:  # the row is kept, and a worker hands it over
        log.warning("message %s waits for the job engine: %s", delivery_id, str(error).splitlines()[0])
        return False
    return True


def _contents(worker: Context, check: HealthRow) -> dict[str, Any]:
    url = worker.settings.link(f"/health-checks/{check.id}")
    return webhook.payload(check.id, check.rig_id, check.document, check.created_at, url)


def attempt(delivery_id: str, number: int) -> None:
    """Send a message, unless that attempt was made already or it was given up; what came of it is in its row."""
    worker = context()
    with worker.database.read() as session:
        delivery = session.get(WebhookRow, delivery_id)
        if delivery is None or delivery.state != PENDING or delivery.attempts + 1 != number:
            return
        contents = delivery.contents or _contents(worker, results.get(session, HealthRow, delivery.health_id))
        schedule = session.get(ScheduleRow, delivery.schedule_id)
    secret = "" if schedule is None else schedule.webhook_secret
    try:
        message = webhook.signed(contents, secret, delivery.id, time.time())
    except webhook.WebhookError as error:  # the webhook was removed before its messages were given up
        why = str(error) if secret else REMOVED
        worker.database.surely(lambda session: schedules.give_up_deliveries(session, delivery.schedule_id, why))
        return
    status, detail, asked = _post(delivery.url, message, worker.settings.webhooks_to_itself)
    worker.database.surely(lambda session: _note(session, delivery_id, number, status, detail, asked))


def not_made(delivery_id: str, number: int, error: Exception) -> None:
    """Note that the engine failed at an attempt: unless it was made, it counts as one that nobody heard."""
    log.error("message %s: the job engine failed", delivery_id, exc_info=error)
    why = (str(error).splitlines() or [type(error).__name__])[0]
    detail = f"the job engine could not make an attempt: {why}"[:500]
    context().database.surely(lambda session: _note(session, delivery_id, number, None, detail, None))


def _note(
    session: Session, delivery_id: str, number: int, status: int | None, detail: str, asked_s: float | None
) -> None:
    """Write down what came of an attempt, once, and when the next one is due."""
    row = session.get(WebhookRow, delivery_id, with_for_update=True)
    if row is None or row.attempts + 1 != number:
        return
    row.attempts, row.status_code, row.updated_at = number, status, now()
    if status is not None and 200 <= status < 300:
        row.state, row.detail, row.next_at = DELIVERED, detail, None
    elif row.state == PENDING:  # what was given up meanwhile stays so
        jitter = random.uniform(-1, 1)
        again = webhook.retry_at(number, time.time(), asked_s, jitter) if webhook.worth_retrying(status) else None
        row.state, row.detail = FAILED if again is None else PENDING, detail
        row.next_at = None if again is None else datetime.fromtimestamp(again, UTC)
        row.dispatched = False


def _post(url: str, message: webhook.Message, loopback: bool) -> tuple[int | None, str, float | None]:
    """Status, what went wrong, and how long the receiver asks to be left alone."""
    try:
        return asyncio.run(_answer(url, message, loopback))
    except TimeoutError:
        return None, f"no whole answer within {DEADLINE_S:g} s", None
    except webhook.WebhookError as error:
        return None, str(error)[:500], None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:  # an address that an older version took
        return None, f"{type(error).__name__}: {error}"[:500], None


async def _answer(url: str, message: webhook.Message, loopback: bool) -> tuple[int, str, float | None]:
    async with asyncio.timeout(DEADLINE_S):
        proxied = _by_proxy(webhook.checked_url(urldefrag(url).url, loopback))
        targets = [httpx.URL(url)] if proxied else await _targets(httpx.URL(url), loopback)
        trusted = httpx.create_ssl_context()  # with the authorities of SSL_CERT_FILE, which trust_env would leave out
        async with httpx.AsyncClient(
            timeout=TIMEOUT_S, follow_redirects=False, trust_env=proxied, verify=trusted
        ) as client:
            for target in targets[:-1]:
                try:
                    return await _sent(client, target, httpx.URL(url), message)
                except (httpx.ConnectError, httpx.ConnectTimeout):  # the receiver's next address
                    continue
            return await _sent(client, targets[-1], httpx.URL(url), message)


def _by_proxy(url: str) -> bool:
    """Whether the environment names a proxy for an address: it then looks up the name, and decides where one gets."""
    parts, proxies = urlsplit(url), getproxies()
    return bool(proxies.get(parts.scheme) or proxies.get("all")) and not proxy_bypass(parts.netloc)


async def _targets(url: httpx.URL, loopback: bool) -> list[httpx.URL]:
    """The same URL by each address that its host has now and that messages may go to.

    What is looked up once more when it is connected to could lead elsewhere by then (DNS rebinding).
    """
    loop = asyncio.get_running_loop()
    host = url.raw_host.decode("ascii").strip("[]")
    found = await loop.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    addresses = dict.fromkeys(str(entry[4][0]) for entry in found)
    targets, refused = [], None
    for address in addresses:
        try:
            webhook.permitted_address(str(url), ip_address(address), loopback)
            targets.append(url.copy_with(host=address))
        except webhook.WebhookError as error:
            refused = error
    if refused is not None and not targets:
        raise refused
    return targets


async def _sent(
    client: httpx.AsyncClient, target: httpx.URL, url: httpx.URL, message: webhook.Message
) -> tuple[int, str, float | None]:
    """Send to an address of the receiver, which shows and is asked for the certificate of its name."""
    # a few bytes that unfold to many are not unfolded
    headers = message.headers | {"accept-encoding": "identity", "host": url.netloc.decode("ascii")}
    named = {"sni_hostname": url.raw_host.decode("ascii")}
    async with client.stream("POST", target, content=message.body, headers=headers, extensions=named) as answer:
        why = "" if answer.is_success else await _beginning(answer)
    after = answer.headers.get("retry-after", "")
    return answer.status_code, why, float(after) if after.isascii() and after.isdigit() else None


async def _beginning(answer: httpx.Response) -> str:
    """First characters of an answer's body, as far as a database takes them."""
    body = b""
    async for part in answer.aiter_raw(LARGEST):
        body += part
        if len(body) >= LARGEST:
            break
    return body.decode(errors="replace").replace("\0", "\N{REPLACEMENT CHARACTER}")[:500]
