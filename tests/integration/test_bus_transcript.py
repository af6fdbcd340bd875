"""A session is recorded, and replayed as a controller without the rig."""

import errno
import os
import re
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

from drivers.controller import State, Tone
from drivers.device.machine import RigDevice
from drivers.device.serve import CanOptions, ModbusOptions, Served, serve_canopen, serve_modbus
from drivers.errors import ControllerError, TripError
from drivers.url import connect
from sim.reference import reference_rig

TONES = [
    Tone(axis=0, amplitude_a=0.05, periods=10, samples=500, blocks=2),
    Tone(axis=3, amplitude_a=0.05, periods=11, samples=500, blocks=1, raw=True),
]
STRONG = Tone(axis=0, amplitude_a=5.9, periods=1, samples=200)


def _modbus() -> Served:
    return serve_modbus(RigDevice(reference_rig(), 2), ModbusOptions(port=0))


def _canopen() -> Served:
    return serve_canopen(RigDevice(reference_rig(), 2), CanOptions())


@pytest.mark.parametrize("serve", [_modbus, _canopen])
def test_replay_gives_what_the_session_gave(serve, tmp_path: Path) -> None:
    path = tmp_path / "session.jsonl"

    def session(url: str):
        controller = connect(url)
        with controller.lease("support"):
            points = [controller.measure(tone) for tone in TONES]
            with pytest.raises(TripError) as trip:
                controller.measure(STRONG)
            controller.acknowledge()
        capabilities = controller.capabilities()
        controller.close()
        return capabilities, points, str(trip.value)

    served = serve()
    recorded = session(f"{served.url}&transcript={path}")
    served.close()
    replayed = session(f"replay://{path}")
    assert replayed[0] == recorded[0]
    assert replayed[2] == recorded[2]
    for one, two in zip(replayed[1], recorded[1], strict=True):
        np.testing.assert_array_equal(one.Y, two.Y)
        assert (one.sequence, one.rig_seconds, one.tone) == (two.sequence, two.rig_seconds, two.tone)
    np.testing.assert_array_equal(replayed[1][1].records["y"], recorded[1][1].records["y"])


def test_a_host_of_another_name_replays_a_session(tmp_path: Path) -> None:
    """A campaign's is drawn anew each time: devices tell hosts by their names."""
    path = tmp_path / "session.jsonl"
    served = _modbus()
    found = []
    for url, holder in (
        (f"{served.url}&transcript={path}", "ambit campaign 1a2b3c"),
        (f"replay://{path}", "campaign 2"),
    ):
        controller = connect(url)
        with controller.lease(holder):
            status = controller.status()
            found.append(controller.measure(TONES[0]))
        controller.close()
        assert status.lease_holder == holder
    served.close()
    np.testing.assert_array_equal(found[0].Y, found[1].Y)


def test_replay_of_another_session_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "session.jsonl"
    served = _modbus()
    controller = connect(f"{served.url}&transcript={path}")
    with controller.lease("support"):
        controller.measure(TONES[0])
    controller.close()
    served.close()
    replay = connect(f"replay://{path}")
    message = r"session\.jsonl, line \d+: tone\.axis was 0, and is now 3"
    with pytest.raises(ControllerError, match=message), replay.lease("support"):
        replay.measure(TONES[1])


@pytest.mark.parametrize("text", ["", "{}", '{"format": "amb-transcript", "version": 2}', "not json"])
def test_what_is_no_transcript_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "session.jsonl"
    path.write_text(text)
    with pytest.raises(ControllerError, match=r"session\.jsonl"):
        connect(f"replay://{path}")


def test_transcript_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ControllerError, match="cannot write the transcript"):
        connect(f"modbus://127.0.0.1:1?transcript={tmp_path}/no/folder.jsonl")


class _Disk:
    """A file on a disk that may be full: what is written then stays in memory, and says so at each flush."""

    def __init__(self, file: IO[str]) -> None:
        self.file, self.full = file, False

    @property
    def closed(self) -> bool:
        return self.file.closed

    def write(self, text: str) -> int:
        return self.file.write(text)

    def flush(self) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.file.flush()

    def close(self) -> None:
        self.file.close()
        self.flush()


def test_a_disk_that_is_full_ends_the_session_by_the_transcripts_name_and_leaves_nothing_excited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, opened, disks = tmp_path / "session.jsonl", Path.open, []

    def open_(self: Path, *arguments: str, **more: str) -> Any:
        disk = _Disk(opened(self, *arguments, **more))
        disks.append(disk)
        return disk

    device = RigDevice(reference_rig(), seed=5)
    served = serve_modbus(device, ModbusOptions(port=0))
    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", open_)
        controller = connect(f"{served.url}&transcript={path}")
    try:
        with controller.lease("host"):
            controller.measure(TONES[0])
            disks[0].full = True
            told = re.escape(f"cannot write the transcript {path}: No space left on device; free space, or leave")
            with pytest.raises(ControllerError, match=told):
                controller.measure(TONES[0])
            controller.stop()
        assert device.status().excitation_a == 0
        assert device.status().state not in (State.ARMED, State.SETTLING, State.RECORDING)
        assert device.status().lease_holder == ""
        with pytest.raises(ControllerError, match=told), controller.lease("host"):
            pass
        assert device.status().lease_holder == "", "what was given before the disk told of it is given back"
    finally:
        controller.close()
        served.close()


def test_a_disk_that_is_full_from_the_beginning_is_told_by_the_transcripts_name() -> None:
    served = serve_modbus(RigDevice(reference_rig(), seed=5), ModbusOptions(port=0))
    try:
        with pytest.raises(ControllerError, match="cannot write the transcript /dev/full: No space left on device"):
            connect(f"{served.url}&transcript=/dev/full")
    finally:
        served.close()
