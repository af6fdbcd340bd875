"""How fast the service is: reads while a job runs, a long list, submission to start, workers on PostgreSQL.

``python benchmarks/api.py [reads|list|start|workers ...] [--seconds 20]``; the load comes from a process of its
own, at a fixed rate, and a request's time counts from when it was due.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import _cpu
import _one_thread  # noqa: F401  before numpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from service.storage import jobs, rigs
from service.storage.database import Database
from tests.support.service import QUICK, Service, reference_sheet, rig_device, service

RATE = 200.0
CONNECTIONS = 16


async def _load(url: str, paths: list[str], rate: float, seconds: float) -> list[float]:
    """Times of requests at a fixed rate, s; raises when one is not answered with 200."""
    parts = urlsplit(url)
    due: asyncio.Queue[tuple[float, str] | None] = asyncio.Queue()
    times: list[float] = []

    async def connection() -> None:
        reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
        while (item := await due.get()) is not None:
            at, path = item
            writer.write(f"GET {path} HTTP/1.1\r\nHost: {parts.netloc}\r\n\r\n".encode())
            head = await reader.readuntil(b"\r\n\r\n")
            if not head.startswith(b"HTTP/1.1 200"):
                raise RuntimeError(head.decode())
            length = next(int(h.split(b":")[1]) for h in head.split(b"\r\n") if h.lower().startswith(b"content-length"))
            await reader.readexactly(length)
            times.append(time.perf_counter() - at)
        writer.close()

    workers = [asyncio.create_task(connection()) for _ in range(CONNECTIONS)]
    began = time.perf_counter()
    for k in range(int(rate * seconds)):
        at = began + k / rate
        await asyncio.sleep(max(0.0, at - time.perf_counter()))
        due.put_nowait((at, paths[k % len(paths)]))
    for _ in workers:
        due.put_nowait(None)
    await asyncio.gather(*workers)
    return times


def load(url: str, paths: list[str], rate: float, seconds: float) -> np.ndarray:
    """Times of requests from a process of its own, ms."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return 1e3 * np.array(pool.apply(_run, (url, paths, rate, seconds)))


def _run(url: str, paths: list[str], rate: float, seconds: float) -> list[float]:
    return asyncio.run(_load(url, paths, rate, seconds))


def told(name: str, ms: np.ndarray, limit: str) -> None:
    """One line of percentiles."""
    p50, p99 = np.percentile(ms, [50, 99])
    print(f"{name}: {len(ms)} requests, median {p50:.1f} ms, p99 {p99:.1f} ms, slowest {ms.max():.1f} ms ({limit})")


def commissioned(found: Service, folder: Path) -> tuple[str, str, str]:
    """A rig with an experiment and a model: their ids."""
    rig = rig_device(folder / "device")
    try:
        rig_id = found.add_rig(reference_sheet(), rig.url)
        job = found.done(found.submit("experiment", rig_id, options={"profile": QUICK}), s=120)
    finally:
        rig.device.end()
    return rig_id, job["result"]["experiment"], job["result"]["model"]


def reads(folder: Path, seconds: float) -> None:
    """200 reads/s of a model while jobs run."""
    with service(folder / "home", "sqlite", requests_per_s=100_000, requests_burst=100_000) as found:
        rig_id, experiment, model = commissioned(found, folder)
        address = f"/api/v1/models/{model}"
        told("reads, idle", load(found.api.said, [address], RATE, seconds / 2), "200/s")
        device = rig_device(folder / "second")
        measured = found.add_rig(reference_sheet(), device.url, name="second")
        busy = threading.Event()

        def keep_busy() -> None:
            while not busy.is_set():
                done = [found.submit("identification", rig_id, experiment=experiment)]
                done.append(found.submit("experiment", measured, options={"profile": QUICK, "identify": False}))
                for job in done:
                    found.wait(job, s=120)

        thread = threading.Thread(target=keep_busy)
        thread.start()
        try:
            time.sleep(1.0)
            ms = load(found.api.said, [address], RATE, seconds)
            told("reads of a model while an experiment and an identification run", ms, "200/s, p99 <= 50 ms")
            ms = load(found.api.said, [f"{address}/result.json"], RATE, seconds)
            told("reads of result.json while they run", ms, "200/s, p99 <= 50 ms")
        finally:
            busy.set()
            thread.join()
            device.device.end()


def listing(folder: Path, seconds: float) -> None:
    """A list of 10,000 jobs."""
    with service(folder / "home", "sqlite", "--no-worker", requests_per_s=100_000, requests_burst=100_000) as found:
        rig_id = found.add_rig(reference_sheet())
        database = Database(f"sqlite:///{found.home / 'ambit.db'}")
        with database.write() as session:
            version = rigs.get(session, rig_id).version
            for k in range(10_000):
                job = jobs.submit(session, "identification", rig_id, version, "benchmark", options={})
                job.state, job.dispatched_run = jobs.STATES[k % 5] if k % 5 > 1 else jobs.DONE, 1
        database.close()
        pages, after = [], ""
        began = time.perf_counter()
        while True:
            pages.append(f"/api/v1/jobs?limit=100{after}")
            page = found.client.get(pages[-1]).json()
            if page["next"] is None:
                break
            after = f"&after={page['next']}"
        took = time.perf_counter() - began
        print(f"list of 10,000 jobs: all {len(pages)} pages of 100 one after another in {took:.2f} s")
        told("pages of 100 of 10,000 jobs", load(found.api.said, pages, 20.0, seconds), "20/s, p99 <= 100 ms")
        filtered = [f"/api/v1/jobs?limit=100&state={s}&rig={rig_id}" for s in ("done", "failed", "cancelled")]
        told("the same with a filter", load(found.api.said, filtered, 20.0, seconds), "20/s, p99 <= 100 ms")


def _start_s(job: dict[str, Any]) -> float:
    begun, made = (datetime.fromisoformat(job[k]) for k in ("started_at", "created_at"))
    return (begun - made).total_seconds()


def start(folder: Path, seconds: float) -> None:
    """From submission to start on an idle service."""
    with service(folder / "home", "sqlite") as found:
        rig_id, experiment, _ = commissioned(found, folder)
        device = rig_device(folder / "second")
        try:
            measured = found.add_rig(reference_sheet(), device.url, name="second")
            options = {"profile": QUICK, "identify": False}
            for kind, rig, more in (
                ("identification", rig_id, {"experiment": experiment}),
                ("experiment", measured, {"options": options}),
            ):
                waits = []
                until = time.monotonic() + seconds
                while time.monotonic() < until:
                    waits.append(_start_s(found.done(found.submit(kind, rig, **more))))
                print(f"{kind}: {len(waits)} jobs, submission to start {statistics.median(waits):.3f} s (median), "
                      f"{max(waits):.3f} s (longest) (<= 0.5 s median)")  # fmt: skip
        finally:
            device.device.end()


def workers(folder: Path, seconds: float) -> None:
    """Identifications per second of four workers against one, on PostgreSQL, and of bare processes without a service.

    The bare ones tell what two cores are worth on this machine: often less than two of one, which share its memory.
    """
    rate = {}
    with service(folder / "home", "postgresql", "--no-worker") as found:
        found.worker("w1")
        rig_id, experiment, _ = commissioned(found, folder)
        measured = found.client.get(f"/api/v1/experiments/{experiment}/file").content
        for count in (1, 4):
            for k in range(len(found.workers), count):
                found.worker(f"w{k + 1}")
            for _ in range(count):  # the children have loaded what they need
                found.submit("identification", rig_id, experiment=experiment)
            _all_ended(found)
            n = max(8, int(seconds / 2)) * (1 if count == 1 else 2) + 2 * count
            meter = _cpu.Meter(found)
            jobs = [found.submit("identification", rig_id, experiment=experiment) for _ in range(n)]
            _all_ended(found)
            spent = meter.told(n)
            rate[count] = _rate([found.job(job) for job in jobs], count)
            print(f"{count} workers on PostgreSQL: {n} identifications, {rate[count]:.3f} per second; {spent}")
    (folder / "experiment.h5").write_bytes(measured)
    (folder / "rig.toml").write_text(reference_sheet(), encoding="utf-8")
    bare = {count: _bare(folder, count, max(8, int(seconds / 2))) for count in (1, 2)}
    gain, ceiling = rate[4] / rate[1], bare[2] / bare[1]
    print(f"bare processes: one {bare[1]:.3f} per second, two {bare[2]:.3f}: {ceiling:.2f} times")
    print(f"four workers against one: {gain:.2f} times (>= 1.8), {100 * gain / ceiling:.0f} % of what two cores give")


def _rate(jobs: list[dict[str, Any]], count: int) -> float:
    """Jobs per second while every one of so many workers had one: the first and the last of each are left out."""
    ended = sorted(datetime.fromisoformat(job["ended_at"]) for job in jobs)[count - 1 : len(jobs) - count]
    return (len(ended) - 1) / (ended[-1] - ended[0]).total_seconds()


def _bare(folder: Path, processes: int, each: int) -> float:
    """Identifications per second of processes that calculate as a worker's do, with nothing around them."""
    arguments = {
        "experiment": str(folder / "experiment.h5"),
        "rig": str(folder / "rig.toml"),
        "name": "experiment.h5",
    }
    command = [sys.executable, "-m", "service.jobs.calculating"]
    started = []
    for k in range(processes):
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(
            (child, json.dumps({"function": "identification", "arguments": arguments | {"out": str(folder / str(k))}}))
        )
    for child, request in started:  # they have loaded what they need
        _asked(child, request, 1)
    began = time.monotonic()
    threads = [threading.Thread(target=_asked, args=(child, request, each)) for child, request in started]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    took = time.monotonic() - began
    for child, _ in started:
        child.communicate()
    return processes * each / took


def _asked(child: subprocess.Popen[str], request: str, times: int) -> None:
    assert child.stdin is not None
    assert child.stdout is not None
    for _ in range(times):
        child.stdin.write(request + "\n")
        child.stdin.flush()
        while "result" not in (said := json.loads(child.stdout.readline())):
            if "progress" not in said:
                raise RuntimeError(str(said))


def _all_ended(found: Service) -> None:
    while any(found.get("/jobs", params={"state": s, "limit": 1})["items"] for s in ("queued", "running")):
        time.sleep(1.0)  # what asks takes time from what works, and jobs know when they ended


NAMES = {"reads": reads, "list": listing, "start": start, "workers": workers}


def main() -> None:
    """Run the parts that were asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*NAMES, []], help="parts; all without")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement")
    a = parser.parse_args()
    for name in a.names or NAMES:
        with tempfile.TemporaryDirectory() as folder:
            NAMES[name](Path(folder), a.seconds)


if __name__ == "__main__":
    main()
