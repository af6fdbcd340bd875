"""Processes of a pool end with their command, whatever ends it and whatever they do, and none says a word."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

LOADING = """
import os, sys, time
if any("forkserver" in argument for argument in sys.orig_argv):
    open(os.path.join(os.environ["LOADING"], str(os.getpid())), "w").close()
    time.sleep(1.0)
"""
ANOTHER_THREAD = "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()"
"""With it processes begin as copies of one that has only loaded, else as copies of the command."""
COMMAND = f"""
import sys, threading, time
from service.pool import workers

if __name__ == "__main__":
    {ANOTHER_THREAD}
    try:
        with workers(3) as pool:
            for future in [pool.submit(time.sleep, 600) for _ in range(3)]:
                future.result()
    except KeyboardInterrupt:
        sys.exit("interrupted")
"""
SLOW = """
import os
LOADED_BY = os.getpid()
"""
PREPARED = f"""
import threading, time
from service.pool import prepare, workers

def ask(number):
    import os, slow
    time.sleep(0.5)
    return slow.LOADED_BY, os.getpid()

if __name__ == "__main__":
    {ANOTHER_THREAD}
    prepare("slow")
    with workers(2) as pool:
        (a, one), (b, other) = pool.map(ask, range(2))
    assert a == b
    print(a, one, other)
"""
COPIED = """
import slow, time
from service.pool import workers

def ask(number):
    import os
    time.sleep(0.5)
    return slow.LOADED_BY, os.getpid()

if __name__ == "__main__":
    with workers(2) as pool:
        (a, one), (b, other) = pool.map(ask, range(2))
    assert a == b == slow.LOADED_BY
    print(a, one, other)
"""
BUSY = f"""
import os, sys, threading, time
from pathlib import Path
from service.pool import workers

def work(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)

if __name__ == "__main__":
    if sys.argv[2] == "with a thread":
        {ANOTHER_THREAD}
    try:
        with workers(2) as pool:
            for future in [pool.submit(work, sys.argv[1]) for _ in range(2)]:
                future.result()
    except KeyboardInterrupt:
        sys.exit("interrupted")
"""


@contextmanager
def started(
    program: str, folder: Path, begun: Path, processes: int, *arguments: str
) -> Iterator[subprocess.Popen[str]]:
    """The program, once so many processes have left their number in a folder."""
    (folder / "command.py").write_text(program)
    begun.mkdir(parents=True)
    command = subprocess.Popen(
        [sys.executable, str(folder / "command.py"), *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)]), "LOADING": str(begun)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 60
        while len(list(begun.iterdir())) < processes:
            assert command.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield command
    finally:
        with suppress(ProcessLookupError):
            os.killpg(command.pid, signal.SIGKILL)
        command.communicate()


def gone(process: str) -> bool:
    """Whether it has ended; where nobody waits for it, a name is left."""
    try:
        return Path("/proc", process, "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def end_soon(begun: Path) -> bool:
    """Whether the processes end that have left their number in a folder."""
    deadline = time.monotonic() + 20
    while not (ended := all(map(gone, os.listdir(begun)))) and time.monotonic() < deadline:
        time.sleep(0.01)
    return ended


def test_ctrl_c_while_processes_load_ends_them_all_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(LOADING)
    loading = tmp_path / "loading"
    with started(COMMAND, tmp_path, loading, 1) as command:
        os.killpg(command.pid, signal.SIGINT)  # as a terminal does
        _, said = command.communicate(timeout=60)
    assert said == "interrupted\n"
    assert command.returncode == 1
    assert end_soon(loading)


@pytest.mark.parametrize("program", [PREPARED, COPIED], ids=["said in advance", "loaded by the command"])
def test_what_is_known_beforehand_is_loaded_once(program: str, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "command.py").write_text(program)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    command = [sys.executable, str(tmp_path / "command.py")]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout
    loaded, own, other = map(int, told.split())
    assert loaded not in {own, other}
    assert own != other


both_ways = pytest.mark.parametrize("threads", ["alone", "with a thread"])


@both_ways
def test_an_interrupt_of_the_command_alone_does_not_wait_for_what_runs(threads: str, tmp_path: Path) -> None:
    with started(BUSY, tmp_path, tmp_path / "busy", 2, str(tmp_path / "busy"), threads) as command:
        command.send_signal(signal.SIGINT)
        _, said = command.communicate(timeout=20)
        assert said == "interrupted\n"
        assert all(map(gone, os.listdir(tmp_path / "busy")))


@both_ways
def test_ctrl_c_ends_what_runs_without_a_word(threads: str, tmp_path: Path) -> None:
    with started(BUSY, tmp_path, tmp_path / "busy", 2, str(tmp_path / "busy"), threads) as command:
        os.killpg(command.pid, signal.SIGINT)  # as a terminal does
        _, said = command.communicate(timeout=20)
        assert said == "interrupted\n"
        assert end_soon(tmp_path / "busy")


@both_ways
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_processes_end_with_a_command_that_was_killed(number: signal.Signals, threads: str, tmp_path: Path) -> None:
    with started(BUSY, tmp_path, tmp_path / "busy", 2, str(tmp_path / "busy"), threads) as command:
        command.send_signal(number)
        command.wait(20)
        assert end_soon(tmp_path / "busy")
