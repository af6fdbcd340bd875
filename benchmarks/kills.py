"""Kills while jobs run: API, workers, devices and database connections, at random, over jobs on simulated rigs.

``python benchmarks/kills.py --kills 100 --jobs 50 --rigs 3 --database sqlite|postgresql [--seed 1]``

Every job must end done, failed with a reason, or cancelled; no finished point may be lost or be there twice; no two
hosts may hold one rig at the same time; nothing may be excited at the end. Prints the figures, and exits 1 if one of
these does not hold.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sqlite3
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401  before numpy
import httpx

sys.path.insert(0, str(Path(__file__).parents[1]))

from service.campaign.run import recover
from service.experiment import file
from service.experiment.data import Experiment
from sim.errors import AmbError
from tests.support.service import QUICK, Rig, Running, Service, free_port, reference_sheet, service

PLAN = {**QUICK, "points": 40, "rig_seconds": 60}
LEASE_S = 2
LOCKED_S = 2.0
ENDED = ("done", "failed", "cancelled")


def device(folder: Path, k: int) -> Rig:
    """A rig on a port that stays the same when it is started again."""
    events = folder / f"rig{k}.events.jsonl"
    events.touch()
    arguments = ("rig", "serve", "--protocol", "modbus", "--port", free_port(), "--seed", k, "--events", events)
    running = Running(folder / f"rig{k}.log", *arguments)
    return Rig(running, running.said, events)


@dataclass
class Trial:
    """A service with its workers and rigs, and what was done to them."""

    found: Service
    rigs: list[Rig]
    rng: random.Random
    folder: Path
    database: str
    kills: Counter[str] = field(default_factory=Counter)
    copies: list[tuple[str, Path]] = field(default_factory=list)
    """Journals as they were at a kill: job and folder."""
    recovery_s: list[float] = field(default_factory=list)

    def kill(self) -> None:
        """Kill something, and start it again after a while."""
        what = self.rng.choice(["api", "worker", "worker", "device", "connection"])
        self.kills[what] += 1
        if what == "connection":
            self._cut_connection()
            return
        target = {
            "api": lambda: self.found.api,
            "worker": lambda: self.found.workers[self.rng.choice(sorted(self.found.workers))],
            "device": lambda: self.rng.choice(self.rigs).device,
        }[what]()
        target.kill()
        if what == "worker":
            self._copy_journals()
        time.sleep(self.rng.uniform(0, 1.5))
        began = time.monotonic()
        target.start()
        self.recovery_s.append(time.monotonic() - began)

    def _copy_journals(self) -> None:
        """What is on disk right after a worker died: none of it may be missing in the end."""
        for journal in self.found.home.glob("work/job_*/experiment.journal"):
            target = self.folder / f"copy{len(self.copies)}"
            target.mkdir()
            try:
                shutil.copy(journal, target)
            except FileNotFoundError:  # the other worker has just finished it
                continue
            self.copies.append((journal.parent.name, target))

    def _cut_connection(self) -> None:
        """PostgreSQL: every connection ends. SQLite: another process holds the whole database for a while."""
        if self.database == "postgresql":
            import psycopg

            url = self.found.environment["AMBIT_DATABASE_URL"]
            with psycopg.connect(url, autocommit=True) as connection:
                connection.execute(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                    "WHERE datname = current_database() AND pid <> pg_backend_pid()"
                )
            return
        for name in ("ambit.db", "jobs.db"):
            with closing(sqlite3.connect(self.found.home / name, timeout=30, isolation_level=None)) as file:
                file.execute("BEGIN IMMEDIATE")
                time.sleep(self.rng.uniform(0, LOCKED_S))
                file.execute("ROLLBACK")


def patiently(call: Any) -> Any:
    """Result of a request, sent again while the API is down."""
    deadline = time.monotonic() + 60
    while True:
        try:
            answer = call()
            if answer.status_code not in (429, 503):
                return answer
        except httpx.TransportError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError("the API does not come back")
        time.sleep(0.2)


def run(trial: Trial, kills: int, count: int, gap_s: float) -> dict[str, dict[str, Any]]:
    """Submit jobs, kill, and wait for every job's end; the jobs."""
    client, rng = trial.found.client, trial.rng
    sheet = reference_sheet()
    rig_ids = [trial.found.add_rig(sheet, rig.url, name=f"rig {k}") for k, rig in enumerate(trial.rigs)]
    submitted: list[str] = []
    cancelled: set[str] = set()
    killed = threading.Event()

    def submit() -> None:
        for k in range(count):
            body = {
                "kind": "experiment",
                "rig": rig_ids[k % len(rig_ids)],
                "options": {"profile": PLAN, "identify": k % 3 == 0},
                "priority": rng.randint(1, 9),
            }
            headers = {"Idempotency-Key": f"kills-{k}"}
            answer = patiently(lambda: client.post("/api/v1/jobs", json=body, headers=headers))  # noqa: B023
            assert answer.status_code == 202, answer.text
            submitted.append(answer.json()["id"])
            if k % 10 == 7:  # some are cancelled, at whatever moment
                time.sleep(rng.uniform(0, 2))
                patiently(lambda: client.post(f"/api/v1/jobs/{submitted[-1]}/cancel"))
                cancelled.add(submitted[-1])

    def kill() -> None:
        for _ in range(kills):
            time.sleep(rng.uniform(0, 2 * gap_s))
            trial.kill()
        killed.set()

    threads = [threading.Thread(target=submit), threading.Thread(target=kill)]
    began = time.monotonic()
    for thread in threads:
        thread.start()
    threads[0].join()
    jobs: dict[str, dict[str, Any]] = {}
    while len(jobs) < count or not killed.is_set():
        for job_id in submitted:
            if job_id not in jobs:
                job = patiently(lambda: client.get(f"/api/v1/jobs/{job_id}")).json()  # noqa: B023
                if job["state"] in ENDED:
                    jobs[job_id] = job
                    print(f"{time.monotonic() - began:6.1f} s  {len(jobs):3d}/{count}  {job['state']:9s} "
                          f"{(job['error'] or {}).get('detail', '')[:100]}", flush=True)  # fmt: skip
        time.sleep(0.5)
        if time.monotonic() - began > 60 + 30 * count + 10 * kills:
            break
    threads[1].join()
    return jobs


def lost_or_twice(trial: Trial, jobs: dict[str, dict[str, Any]]) -> tuple[int, int, int]:
    """Points that were on disk at a kill and are not in the end, points that are there twice, points compared."""
    lost = twice = compared = 0
    ends: dict[str, Experiment] = {}
    for job_id, job in jobs.items():
        if job["state"] != "done":
            continue
        answer = patiently(lambda: trial.found.client.get(f"/api/v1/experiments/{job['result']['experiment']}/file"))  # noqa: B023
        path = trial.folder / f"{job_id}.h5"
        path.write_bytes(answer.content)
        ends[job_id] = file.read(path)
        for sweep in ends[job_id].sweeps:
            values = [y.tobytes() for y in sweep.Y]
            twice += len(values) - len(set(values))
    for job_id, folder in trial.copies:
        if job_id not in ends:
            continue
        try:
            before = recover(folder)
        except AmbError:  # killed before its first line
            continue
        for old in before.sweeps:
            if old.kind == "noise" or old.comment == "preliminary":
                continue
            new = ends[job_id].named(old.comment)
            found = set() if new is None else {y.tobytes() for y in new.Y}
            compared += old.n_points
            lost += sum(y.tobytes() not in found for y in old.Y)
    return lost, twice, compared


def overlaps(rig: Rig) -> int:
    """How often a host got the rig while another one held it: neither released, nor lapsed, nor was it restarted."""
    count, holder, heard = 0, "", 0.0
    for event in rig.events():
        text, at = str(event["text"]), float(event["monotonic_s"])
        if text.startswith("leased to "):
            if holder not in ("", text) and at - heard < LEASE_S - 0.1:
                count += 1
            holder, heard = text, at
        elif text in ("lease released", "levitated"):
            holder = ""
        elif text.startswith("excitation on"):
            heard = at
    return count


def main() -> int:
    """Run the trial and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=50)
    parser.add_argument("--rigs", type=int, default=3)
    parser.add_argument("--gap-s", type=float, default=2.0, help="mean time between kills")
    parser.add_argument("--database", choices=["sqlite", "postgresql"], default="sqlite")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder to leave logs in")
    a = parser.parse_args()
    settings = {"lease_s": LEASE_S, "worker_timeout_s": 10, "requests_per_s": 10_000, "port": free_port()}
    with tempfile.TemporaryDirectory() as temporary:
        folder = a.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        flags = ("--no-worker", "--port", str(settings["port"]))
        with service(folder / "home", a.database, *flags, **settings) as found:
            rigs = [device(folder, k) for k in range(a.rigs)]
            try:
                for name in ("w1", "w2"):
                    found.worker(name)
                trial = Trial(found, rigs, random.Random(a.seed), folder, a.database)
                began = time.monotonic()
                jobs = run(trial, a.kills, a.jobs, a.gap_s)
                took = time.monotonic() - began
                states = Counter(job["state"] for job in jobs.values())
                unexplained = sum(j["state"] == "failed" and not j["error"]["detail"] for j in jobs.values())
                lost, twice, compared = lost_or_twice(trial, jobs)
                excited = sum(rig.status().excitation_a != 0 or bool(rig.status().lease_holder) for rig in rigs)
                shared = sum(overlaps(rig) for rig in rigs)
            finally:
                for rig in rigs:
                    rig.device.end()
    print(f"{a.database}: {sum(trial.kills.values())} kills ({', '.join(f'{v} {k}' for k, v in trial.kills.items())}) "
          f"over {a.jobs} jobs on {a.rigs} rigs in {took:.0f} s")  # fmt: skip
    print(f"ended: {', '.join(f'{v} {k}' for k, v in states.items())}; never: {a.jobs - len(jobs)}; "
          f"failed without a reason: {unexplained}")  # fmt: skip
    for job in jobs.values():
        if job["state"] == "failed":
            print(f"  {job['error']['title']}: {job['error']['detail']}")
    print(f"points: {compared} compared with journals at a kill, {lost} lost, {twice} twice")
    print(f"rigs held by two hosts: {shared}; excited or leased at the end: {excited}")
    if trial.recovery_s:
        print(f"started again in {statistics.median(trial.recovery_s):.1f} s (median)")
    good = len(jobs) == a.jobs and not (unexplained or lost or twice or shared or excited)
    print("all held" if good else "NOT ALL HELD")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
