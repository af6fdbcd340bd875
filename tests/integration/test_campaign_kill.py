"""A campaign that is killed without warning, again and again, loses no finished point and measures none twice."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np

from service.campaign import journal
from service.campaign.run import recover
from service.cli import run
from service.experiment.file import read
from tests.support.campaigns import assert_same

PROGRAM = """
import sys
from pathlib import Path
from drivers.simulated.driver import SimulatedController
from service.campaign.run import run_campaign
from service.campaign.aims import Profile
from sim.reference import reference_datasheet, reference_rig

def progress(report):
    print(report.done, flush=True)

run_campaign(
    SimulatedController(reference_rig(), seed=1),
    reference_datasheet(),
    Path(sys.argv[1]),
    progress=progress,
    profile=Profile(
        accuracy=0.005, points=16, validation_points=3, amplifier_points=3, coarse_points=6, rig_seconds=60.0
    ),
)
"""


def started(folder):
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(folder)], stdout=subprocess.PIPE, text=True, env=environment
    )


def killed_after(folder, points, delay):
    """Points that the program had reported when it was killed."""
    process = started(folder)
    reported = 0
    for text in process.stdout:
        reported = int(text)
        if reported >= points:
            break
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    reported += len(process.stdout.read().split())
    process.wait()
    process.stdout.close()
    return reported


def test_kill_9_at_any_instant(tmp_path, capsys):
    rng = np.random.default_rng(0)
    points = 0
    before = []
    for wanted in (2, 30, 70):
        reported = killed_after(tmp_path, wanted, float(rng.uniform(0, 0.05)))
        assert reported >= wanted
        # on disk: every entry of before, unchanged, and all that was reported since
        entries = journal.read(tmp_path / "experiment.journal")[1]
        assert [e["request"] for e in entries[: len(before)]] == before
        before = [e["request"] for e in entries]
        kept = recover(tmp_path)
        excited = [s for s in kept.sweeps if s.kind != "noise"]
        points = sum(s.n_points for s in excited)
        assert points + 5 >= reported  # five reports are of noise records
    assert run(["recover", str(tmp_path), "--json"]) == 0
    assert sum(json.loads(capsys.readouterr().out)["points"].values()) == points
    assert_same(read(tmp_path / "experiment.h5"), kept)  # without a controller, and the journal goes on from there
    process = started(tmp_path)
    output = process.communicate(timeout=120)[0]
    assert process.returncode == 0
    experiment = read(tmp_path / "experiment.h5")
    assert not (tmp_path / "experiment.journal").exists()
    for sweep in kept.sweeps:
        final = experiment.named(sweep.comment)
        for f, axis, y in zip(sweep.frequency_hz, sweep.axis, sweep.Y, strict=True):
            match = (final.frequency_hz == f) & (final.axis == axis)
            assert match.sum() == 1
            np.testing.assert_array_equal(final.Y[match][0], y)
    for sweep in experiment.sweeps:
        rows = list(zip(sweep.frequency_hz, sweep.axis, strict=True))
        assert len(rows) == len(set(rows))
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise", "preliminary"]
    assert int(output.split()[-1]) == sum(s.n_points for s in experiment.sweeps if s.kind != "noise") + 5


def test_control_c_in_the_middle_leaves_a_file_and_a_quiet_rig(tmp_path):
    process = started(tmp_path)
    for text in process.stdout:
        if int(text) >= 40:
            break
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode not in (0, -signal.SIGINT)
    kept = read(tmp_path / "experiment.h5")
    assert sum(s.n_points for s in kept.sweeps if s.kind != "noise") + 5 >= 40
    assert (tmp_path / "experiment.journal").exists()
