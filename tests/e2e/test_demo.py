"""The demo goes through the service, and what it starts is gone when it is; an interrupted one goes on."""

import os
import re
import signal
from pathlib import Path

import httpx
import pytest

from service.experiment import file
from tests.support.command import Running, refusal, wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds processes in /proc, as on Linux"),
]


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
    """Journal of a demo that was ended after 20 more points, in its main sweep; all that it had started is gone."""
    before = _journalled(folder)
    demo = Running("demo", "--quick", "--out", folder)
    try:
        wait_until(lambda: any(line.startswith("main sweep") for line in demo.said), "the main sweep")
        wait_until(lambda: _journalled(folder) > before + 20, "more points")
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
    (journal,) = _journals(folder)
    return journal


def _journals(folder: Path) -> list[Path]:
    return list((folder / "service" / "work").glob("job_*/experiment.journal"))


def _journalled(folder: Path) -> int:
    """Lines that were kept of the campaigns."""
    return sum(journal.read_bytes().count(b"\n") for journal in _journals(folder))


def _wait_for_end(processes: dict[int, str]) -> None:
    for process, command in processes.items():
        wait_until(lambda process=process: not _alive(process), f"the end of {command}", 20)


def test_a_demo_that_was_ended_or_killed_goes_on_and_can_be_looked_at_in_the_service_until_ctrl_c(tmp_path):
    journal = _interrupted(tmp_path, signal.SIGINT)
    known = journal.read_bytes()
    assert _interrupted(tmp_path, signal.SIGKILL) == journal
    assert journal.read_bytes().startswith(known)
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
