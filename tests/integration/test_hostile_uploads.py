"""Files that are built to do harm end in one line that says why; this process and its memory are left alone."""

import resource
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from service.experiment import file
from service.uploads import (
    Limits,
    UploadBusyError,
    UploadContentError,
    UploadError,
    UploadSizeError,
    confined,
    parse,
)
from service.uploads.limits import MIB
from tests.support.uploads import HOSTILE, good, good_matlab, very_many_points

PATIENT = Limits(check_cpu_s=10.0, read_cpu_s=10.0, wall_s=60.0)
"""Which reason a file is refused for must not depend on how fast the machine is; time has tests of its own."""


def refused(path: Path, tmp_path: Path, limits: Limits | None = None) -> UploadError:
    with pytest.raises(UploadError) as refusal:
        parse(path, "sent.h5", tmp_path / "understood.h5", limits)
    assert len(str(refusal.value).splitlines()) == 1
    assert str(tmp_path) not in str(refusal.value)
    assert not (tmp_path / "understood.h5").exists()
    return refusal.value


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_with_its_reason(tmp_path, name):
    make, status, said = HOSTILE[name]
    path = make(tmp_path / "received")
    if status == 0:
        assert parse(path, "sent.h5", tmp_path / "understood.h5").summary["rig"] == "bench 3"
        return
    refusal = refused(path, tmp_path, PATIENT)
    assert refusal.status == status, str(refusal)
    assert said in str(refusal)
    assert not [p for p in tmp_path.iterdir() if p != path]


def test_a_good_file_is_written_anew(tmp_path):
    path = good(tmp_path / "received")
    parsed = parse(path, "a folder/sent.h5", tmp_path / "understood.h5")
    assert parsed.summary["file_format"] == "HDF5"
    assert parsed.summary["sweeps"][0] | {"to_hz": 0} == {
        "kind": "stepped-sine",
        "comment": "main",
        "points": 8,
        "from_hz": 10.0,
        "to_hz": 0,
        "blocks": 4,
        "harmonics": [0, 1],
        "speed_rad_s": 0.0,
        "sample_rate_hz": 10_000.0,
        "coil_current": True,
    }
    sent, understood = file.read(path), file.read(parsed.file)
    np.testing.assert_array_equal(understood.main.Y, sent.main.Y)
    with h5py.File(parsed.file) as written:
        assert set(written) == {"sweeps"}


def test_a_matlab_file_without_a_name_is_called_after_the_file(tmp_path):
    import scipy.io

    path = good_matlab(tmp_path / "received")
    content = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__") and k != "rig"}
    scipy.io.savemat(path, content)
    parsed = parse(path, "../bench 7.mat", tmp_path / "understood.h5")
    assert (parsed.summary["rig"], parsed.summary["file_format"]) == ("bench_7", "MATLAB 5")


def test_text_of_a_file_cannot_reach_a_terminal_or_break_a_database(tmp_path):
    path = good(tmp_path / "received")
    with h5py.File(path, "r+") as opened:
        opened.attrs["rig"] = "a\x1b[2J\nb" + "c" * 10_000
    rig = parse(path, "x.h5", tmp_path / "understood.h5").summary["rig"]
    assert rig.startswith("a\N{REPLACEMENT CHARACTER}[2J b")
    assert len(rig) <= 400


def test_a_file_larger_than_allowed_is_not_even_looked_at(tmp_path):
    path = tmp_path / "received"
    with path.open("wb") as stream:
        stream.truncate(10 * MIB)
    refusal = refused(path, tmp_path, Limits(file_bytes=MIB))
    assert isinstance(refusal, UploadSizeError)
    assert "at most 1 MiB" in str(refusal)


def test_memory_is_bounded(tmp_path):
    """60 MiB of noise, which no look at the structure can object to, in a process that may take 50 MiB."""
    noise = np.random.default_rng(0).standard_normal((30_000, 4, 2, 16)) + 0j
    path = good(tmp_path / "received", Y=noise)
    refusal = refused(path, tmp_path, Limits(memory_bytes=50 * MIB))
    assert isinstance(refusal, UploadSizeError | UploadContentError)
    assert "memory" in str(refusal) or "allocate" in str(refusal)


def test_processor_time_is_bounded(tmp_path):
    """60,000 short records, which take seconds to demodulate, where their number is no objection."""
    began = time.monotonic()
    refusal = refused(very_many_points(tmp_path / "received"), tmp_path, Limits(points=10**6))
    assert "takes longer than a file of its size may take" in str(refusal)
    assert time.monotonic() - began < 60


def test_a_child_that_hangs_is_ended(tmp_path, monkeypatch):
    """The wall clock ends what the processor clock does not see."""
    monkeypatch.setattr(confined, "COMMAND", ("/bin/sh", "-c", "sleep 60"))
    began = time.monotonic()
    refusal = refused(good(tmp_path / "received"), tmp_path, Limits(wall_s=0.2, decoded_bytes=MIB))
    assert "takes longer" in str(refusal)
    assert time.monotonic() - began < 10


def test_no_more_children_than_places(tmp_path, monkeypatch):
    monkeypatch.setattr(confined, "WAIT_S", 0.05)
    monkeypatch.setattr(confined, "_PLACES", threading.BoundedSemaphore(1))
    with confined._PLACES, pytest.raises(UploadBusyError):
        parse(good(tmp_path / "received"), "x.h5", tmp_path / "understood.h5")
    parse(tmp_path / "received", "x.h5", tmp_path / "understood.h5")


def test_the_child_knows_nothing_of_the_service(monkeypatch):
    monkeypatch.setenv("AMBIT_DATABASE_URL", "postgresql://u:secret@h/d")
    assert not any("secret" in v for v in confined._environment().values())


def test_this_process_is_not_limited():
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.getrlimit(resource.RLIMIT_AS)[1]


def test_a_crash_of_the_reader_is_the_files_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(confined, "COMMAND", ("/bin/sh", "-c", "kill -SEGV $$"))
    assert "ends in a crash" in str(refused(good(tmp_path / "received"), tmp_path))
