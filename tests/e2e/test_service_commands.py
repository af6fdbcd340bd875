"""submit, watch, cancel and fetch against ``ambit serve`` and a rig on Modbus, as at an engineer's terminal."""

import json
import os
import pty
import re
import select
import subprocess
import time

import numpy as np
import pytest

from service.experiment import file
from sim.reference import reference_rig
from tests.support import command
from tests.support.commissioned import LAW
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.processes import ROOT
from tests.support.service import QUICK, SLOW, rig_device, service
from tests.support.two_axes import true_and_known

TRUE, KNOWN = true_and_known()
PROFILE = f"profile={json.dumps(QUICK)}"
ENDLESS = f"profile={json.dumps({**SLOW, 'points': 200, 'rig_seconds': 400})}"
"""Nobody waits for its end."""


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    home = tmp_path_factory.mktemp("home")
    true = home / "controllers" / "true.toml"
    true.parent.mkdir()
    true.write_text(TRUE)
    rig = rig_device(tmp_path_factory.mktemp("rig"), "rig", "--rig", str(true))
    with service(home, "sqlite", requests_per_s=10_000) as found:
        found.rig, found.inside = rig, f"simulated://?rig={true}&seed=1"
        yield found
    rig.device.end()


@pytest.fixture
def ambit(running, monkeypatch):
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_URL", running.api.said)
    return command.ambit


@pytest.fixture(scope="module")
def sheet(tmp_path_factory):
    path = tmp_path_factory.mktemp("sheet") / "rig.toml"
    path.write_text(KNOWN)
    return path


def on_a_terminal(*arguments: object) -> tuple[int, str]:
    """Exit status, and all that a terminal was sent."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*command.AMBIT, *map(str, arguments)], stdin=theirs, stdout=theirs, stderr=theirs, env=command.ENVIRONMENT
    )
    os.close(theirs)
    shown = b""
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline:
        if select.select([ours], [], [], 0.2)[0]:
            try:
                part = os.read(ours, 65536)
            except OSError:
                break
            if not part:
                break
            shown += part
        elif process.poll() is not None:
            break
    os.close(ours)
    return process.wait(20), shown.decode()


def test_measured_identified_and_fetched_by_one_command(ambit, running, sheet, tmp_path):
    done = ambit(
        *("submit", "experiment", "--rig", sheet, "--controller", running.rig.url),
        *("--option", PROFILE, "--out", tmp_path / "out"),
    )
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"experiment.h5", "rig.toml", "result.json", "report.html"}
    assert json.loads((tmp_path / "out" / "result.json").read_text())["format"] == "amb-commissioning-result"
    *_, report, verdict = done.stdout.splitlines()
    assert report.startswith(f"report: {running.api.said}/api/v1/models/mod_")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    for plane, found in result["planes"].items():
        told = next(part for part in verdict.split("; ") if part.startswith(f"{plane}: "))
        assert f"kiA {found['stiffness']['kiA']['value']:.0f}"[:6] in told
        assert f"zone {found['margins']['iso_14839_3_zone']}" in told
    assert "done" in done.stderr

    # the log of the worker tells of it under its ids
    lines = [json.loads(line) for line in running.logs().splitlines() if line.startswith("{")]
    ids = {(line["job"], line["rig"]) for line in lines if "job" in line}
    assert any(job.startswith("job_") and rig.startswith("rig_") for job, rig in ids)

    # the same file, uploaded: identified again on the rig that is known by now, its bar on a terminal
    said = ambit("submit", "identification", "--rig", "reference", "--experiment", tmp_path / "out" / "experiment.h5")
    job = said.stdout.strip()
    assert job.startswith("job_")
    status, shown = on_a_terminal("watch", job, "--out", tmp_path / "again")
    assert status == 0, shown
    assert "━" in shown
    assert "model: mod_" in shown
    assert (tmp_path / "again" / "result.json").exists()
    fetched = json.loads(command.at_once("fetch", job, "--out", tmp_path / "third", "--json").stdout)
    assert set(fetched["files"]) == {"datasheet", "experiment", "result", "report"}


def test_the_readme_s_calls_of_the_main_job_by_http(running, tmp_path):
    """As they stand there, but for the address; needs nothing but curl."""
    readme = (ROOT / "README.md").read_text()
    (calls,) = re.findall(r"```sh\n(api=http.*?)```", readme, re.DOTALL)
    assert calls.count("curl") > 4
    axes = ("xA", "xB")
    models = {"x": plane_model_of(reference_rig(), "x")}
    sweep = synthetic_sweep(models, axes, LAW, np.geomspace(10, 1000, 40), 0.05, seed=1)
    (tmp_path / "out" / "rig1").mkdir(parents=True)
    file.write(tmp_path / "out" / "rig1" / "experiment.h5", synthetic_experiment(sweep, axes=axes))
    (tmp_path / "rig.toml").write_text(KNOWN)
    script = "set -eu\n" + calls.replace("http://127.0.0.1:8311", running.api.said)
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert '"state":"done"' in done.stdout.replace(" ", "")
    assert json.loads((tmp_path / "result.json").read_text())["format"] == "amb-commissioning-result"


def test_a_rig_whose_controller_plays_waveforms_is_measured_by_multisines(ambit, running, sheet, tmp_path):
    few = {"lines": 40, "realisations": 2, "amplifier_lines": 16, "period_s": 0.25, "settle_s": 0.4}
    done = ambit(
        *("submit", "experiment", "--rig", sheet, "--controller", running.inside, "--change"),
        *("--excitation", "multisine"),
        *("--option", f"profile={json.dumps(few)}", "--option", "identify=false", "--out", tmp_path / "out"),
    )
    assert done.returncode == 0, done.stderr
    measured = file.read(tmp_path / "out" / "experiment.h5")
    assert {sweep.kind for sweep in measured.sweeps} == {"multisine", "noise"}
    assert len(np.unique(measured.named("main").frequency_hz)) <= 40

    # one that plays tones only says so, and its rotor has not moved
    job = ambit(
        *("submit", "experiment", "--rig", sheet, "--controller", running.rig.url, "--change"),
        *("--excitation", "multisine"),
    ).stdout.strip()
    assert "plays tones only" in ambit("watch", job).stderr.splitlines()[-1]


def test_a_cancelled_job_is_a_failure_of_whoever_watches(ambit, running, sheet):
    job = ambit(
        "submit", "experiment", "--rig", sheet, "--controller", running.rig.url, "--option", ENDLESS
    ).stdout.strip()
    running.wait(job, lambda j: j["progress"]["point"] > 5)
    assert ambit("cancel", job).stdout.strip() == job
    watched = ambit("watch", job)
    assert watched.returncode == 1
    assert watched.stderr.splitlines()[-1] == f"ambit: the job {job} was cancelled"
    assert running.rig.status().excitation_a == 0

    # it is found among the others, and goes on
    listed = command.at_once("jobs", "--state", "cancelled", "--rig", "reference").stdout
    line = next(line for line in listed.splitlines() if job in line)
    for whole in ("experiment", "reference", "cancelled", time.strftime("%Y-%m-%d", time.gmtime()), "local"):
        assert whole in line  # nothing is cut in a pipe
    assert job not in command.at_once("jobs", "--kind", "gap").stdout
    again = json.loads(command.at_once("retry", job, "--json").stdout)
    assert (again["id"], again["state"]) == (job, "queued")
    (found,) = json.loads(command.at_once("jobs", "--limit", "1", "--json").stdout)["jobs"]
    assert found["id"] == job
    command.at_once("cancel", job)
    running.wait(job)


def test_a_rig_is_seen_and_stopped_from_a_terminal(ambit, running, sheet):
    submit = ("submit", "experiment", "--rig", sheet, "--controller", running.rig.url, "--change", "--option", ENDLESS)
    job = ambit(*submit).stdout.strip()
    running.wait(job, lambda j: j["progress"]["point"] > 5)
    listed = ambit("rigs").stdout
    assert running.rig.url in listed
    assert job in listed, "who moves the rotor"
    assert json.loads(ambit("status", "reference", "--json").stdout)["lease_holder"]

    assert ambit("stop", "reference").stdout.startswith("reference: stopped")
    assert running.wait(job)["state"] == "failed"
    shown = ambit("status", "reference").stdout
    assert "moved by: nobody" in shown
    assert "excitation, A: 0" in shown
    assert "displacements, µm: xA " in shown
    found = {rig["name"]: rig for rig in json.loads(ambit("rigs", "--json").stdout)["rigs"]}
    assert found["reference"]["status"]["excitation_a"] == 0.0
    assert json.loads(ambit("schedules", "--json").stdout) == {"schedules": []}
    assert ambit("acknowledge", "reference").stdout.startswith("no trip is latched")


def test_what_cannot_be_done_is_one_line(ambit, running, sheet, tmp_path):
    assert "no rig 'nobody'" in command.refusal("submit", "experiment", "--rig", "nobody")
    assert "name=value" in command.refusal("submit", "gap", "--rig", "x", "--option", "a", status=2)
    wrong_kind = ("submit", "gap", "--rig", "x", "--excitation", "multisine")
    assert "--excitation" in command.refusal(*wrong_kind, status=2)
    assert "there is no job" in command.refusal("watch", "job_0")
    for word in ("status", "stop"):
        assert "no rig 'nobody'" in command.refusal(word, "nobody")
    no_option = ("submit", "health", "--rig", "reference", "--option", "gear=1")
    assert "--option: gear: there is no such option" in command.refusal(*no_option, status=2)
    (tmp_path / "x.h5").write_bytes(b"PK")
    assert "neither an HDF5 nor a MATLAB" in command.refusal(
        *("submit", "gap", "--rig", sheet, "--controller", running.rig.url, "--experiment", tmp_path / "x.h5")
    )
    unreachable = ("submit", "health", "--rig", sheet, "--controller", "", "--change")
    assert "has no controller yet" in command.refusal(*unreachable, status=2)
