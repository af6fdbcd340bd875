"""The demo goes through the service, and what it starts is gone when it is; an interrupted one goes on."""

import os
import re
import signal
from pathlib import Path

import httpx
import pytest

from service.experiment import file
from tests.support.command import Running, refusal, wait_until

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds processes in /proc, as on Linux")


def _started_by(pid: int) -> dict[int, str]:
    """Processes below a process, and their commands."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == pid:
                found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        except (OSError, ValueError, IndexError):
            continue
    return found | {k: v for child in list(found) for k, v in _started_by(child).items()}


def _alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def _interrupted(folder: Path, number: int) -> Path:
    """Journal of a demo that was ended in its main sweep; everything that it had started is gone."""
    demo = Running("demo", "--quick", "--out", folder)
    try:
        wait_until(lambda: any(line.startswith("main sweep") for line in demo.said), "the main sweep")
        started = _started_by(demo.process.pid)
        for what in ("--until-stdin-closes", "service.jobs.supervised", "service.jobs.calculating"):
            assert any(what in command for command in started.values()), started
        if number == signal.SIGKILL:
            os.kill(demo.process.pid, number)
        else:
            demo.interrupt(number)
        assert demo.wait() == (1 if number == signal.SIGINT else -signal.SIGKILL)
        _wait_for_end(started)
    finally:
        demo.end()
    (journal,) = (folder / "service" / "work").glob("job_*/experiment.journal")
    assert journal.read_bytes().count(b"\n") > 20
    return journal


def _wait_for_end(processes: dict[int, str]) -> None:
    for process, command in processes.items():
        wait_until(lambda process=process: not _alive(process), f"the end of {command}", 20)


def test_what_the_demo_starts_ends_with_it(tmp_path):
    _interrupted(tmp_path, signal.SIGINT)


def test_a_killed_demo_goes_on_and_can_be_looked_at_in_the_service_until_ctrl_c(tmp_path):
    journal = _interrupted(tmp_path, signal.SIGKILL)
    demo = Running("demo", "--quick", "--out", tmp_path, "--keep-serving")
    try:
        wait_until(lambda: any(line.startswith("serving on") for line in demo.said), "the end of the job", 120)
        assert any(journal.parent.name in line and "was interrupted" in line for line in demo.said)
        assert not journal.exists()
        assert file.read(tmp_path / "experiment.h5").named("main") is not None
        told = (re.match("report in the service: (http.*)", line) for line in demo.process.stdout)
        url = next(match[1] for match in told if match)
        assert httpx.get(url).text == (tmp_path / "report.html").read_text()
        for other in ("--quick", "--in-process"):
            assert f"another ambit demo is at work in {tmp_path}" in refusal("demo", other, "--out", tmp_path)
        started = _started_by(demo.process.pid)
        demo.interrupt()
        assert demo.wait() == 0
        _wait_for_end(started)
        with pytest.raises(httpx.ConnectError):
            httpx.get(url)
    finally:
        demo.end()
