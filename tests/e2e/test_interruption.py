"""Ctrl-C in the middle: the rig stops, what was measured is kept, and the same command goes on where it stopped."""

import json
import re
import resource
import signal
import socket

import pytest

from drivers.controller import Status
from drivers.url import connect
from service.experiment import file
from tests.support.command import Running, ambit, refusal, wait_until
from tests.support.two_axes import true_and_known


@pytest.fixture
def rig(tmp_path):
    """A rig of one plane on Modbus in a process of its own: URL and datasheet."""
    for name, text in zip(("true", "rig"), true_and_known(), strict=True):
        (tmp_path / f"{name}.toml").write_text(text)
    device = Running("rig", "serve", "--rig", tmp_path / "true.toml", "--protocol", "modbus", "--port", 0, "--seed", 5)
    url = device.first_line()
    assert url.startswith("modbus://"), device.said
    yield url, tmp_path / "rig.toml"
    device.end()


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture
def command(rig, out):
    url, datasheet = rig
    return ("commission", "--controller", url, "--rig", datasheet, "--out", out, "--quick")


def interrupted(command, out, number):
    """What a campaign had measured that was ended in its main sweep; it said so in one line."""
    first = Running(*command)
    try:
        wait_until(lambda: any(line.startswith("main sweep") for line in first.said), "the main sweep")
        first.interrupt(number)
        assert first.wait() == 1
        last = first.said[-1]
        assert last.startswith("ambit: ")
        assert "kept" in last
        assert "Traceback" not in "".join(first.said)
    finally:
        first.end()
    kept = file.read(out / "experiment.h5")
    assert (out / "experiment.journal").exists()
    assert not (out / "result.json").exists()
    assert sum(s.n_points for s in kept.sweeps) > 20
    return kept


@pytest.mark.slow
def test_a_campaign_terminated_and_then_ended_by_ctrl_c_is_kept_and_resumed(rig, command, out):
    first = interrupted(command, out, signal.SIGTERM)
    assert not _excited(rig[0])
    kept = interrupted(command, out, signal.SIGINT)
    assert not _excited(rig[0])
    assert first.named("main").n_points <= kept.named("main").n_points

    again = ambit(*command, "--json", timeout_s=240)
    assert again.returncode == 0, again.stderr
    whole = file.read(out / "experiment.h5")
    assert not (out / "experiment.journal").exists()
    before, after = kept.named("preliminary"), whole.named("preliminary")
    assert before is not None
    assert after is not None
    assert (before.Y == after.Y).all()  # not measured a second time
    assert json.loads(again.stdout)["planes"]["x"]["stiffness"]["kiA"]["value"] == pytest.approx(181, rel=0.02)


def test_a_disk_that_is_full_ends_the_campaign_with_its_rig_at_rest(rig, command, out):
    """No file of the command may grow any more: to whoever writes, that is a full disk."""
    run = Running(*command)
    try:
        journal = out / "experiment.journal"
        wait_until(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 10, "the first points")
        size = journal.stat().st_size
        resource.prlimit(run.process.pid, resource.RLIMIT_FSIZE, (size, size))
        assert run.wait() == 1
        assert re.fullmatch(r"ambit: cannot write .*experiment\.journal: .*; free space and resume\n", run.said[-1])
    finally:
        run.end()
    status = _status(rig[0])
    assert (status.excitation_a, status.lease_holder) == (0, "")


def test_without_resuming_an_old_campaign_is_put_aside(tmp_path):
    ambit("rig", "datasheet", "--out", tmp_path / "rig.toml")
    out = tmp_path / "out"
    out.mkdir()
    (out / "experiment.journal").write_text("not a journal\n")
    command = ("commission", "--controller", "simulated://?seed=1", "--rig", tmp_path / "rig.toml", "--out", out)
    assert "journal" in refusal(*command, "--quick")
    run = Running(*command, "--quick", "--no-resume")
    wait_until(lambda: any(p.name.startswith("experiment.previous") for p in out.iterdir()), "the old journal aside")
    run.interrupt()
    assert run.wait() == 1
    run.end()
    put_aside = next(p for p in out.iterdir() if p.name.startswith("experiment.previous"))
    assert put_aside.read_text() == "not a journal\n"


def _excited(url: str) -> bool:
    return _status(url).excitation_a != 0


def _status(url: str) -> Status:
    controller = connect(url)
    try:
        return controller.status()
    finally:
        controller.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_still_connecting_ends_with_the_first_signal_and_speaks_of_no_excitation(
    tmp_path, out, number
):
    (tmp_path / "rig.toml").write_text(true_and_known()[1])
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"canopen://socketcand/127.0.0.1:{silent.getsockname()[1]}/can0?node=5"
        command = Running("commission", "--controller", url, "--rig", tmp_path / "rig.toml", "--out", out)
        try:
            silent.settimeout(60)
            connection, _ = silent.accept()
            with connection:
                command.interrupt(number)
                assert command.wait(20) == 1
            assert command.said == ["ambit: stopped by the user; files that were finished are kept\n"]
        finally:
            command.end()
