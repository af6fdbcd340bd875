"""Every command explains itself; what is typed wrong ends in one line and status 2."""

import json
import subprocess
import sys

import pytest

from sim import rig_file
from sim.effects import CATALOGUE
from sim.reference import reference_datasheet
from tests.support.command import AMBIT, ENVIRONMENT, ambit, at_once, refusal

COMMANDS = (
    (),
    ("demo",),
    ("commission",),
    ("identify",),
    ("effects",),
    ("gap",),
    ("gap", "diagnose"),
    ("gap", "apply"),
    ("gap", "blind-trial"),
    ("rig",),
    ("rig", "serve"),
    ("rig", "datasheet"),
    ("rigs",),
    ("status",),
    ("stop",),
    ("acknowledge",),
    ("schedules",),
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help(command):
    done = at_once(*command, "--help")
    assert done.returncode == 0
    assert "Usage: ambit" in done.stdout
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("command", "word"),
    [("commission", "[tolerance]"), ("identify", "[tolerance]"), ("check-controller", "[controller]")],
)
def test_help_names_the_tables_of_the_datasheet(command, word):
    """Brackets would be taken for colours."""
    assert word in at_once(command, "--help").stdout


def test_help_needs_none_of_the_heavy_libraries():
    code = (
        "import sys, service.cli; service.cli.run(['--help']); "
        "print([m for m in ('numpy', 'scipy', 'numba', 'h5py', 'plotly') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nonsense",), "No such command 'nonsense'"),
        (("identify", "experiment.h5", "--out", "x"), "Missing option '--rig'"),
        (("demo", "--seed", "many"), "--seed"),
        (("demo", "--speed", "1"), "No such option: --speed"),
        (("rig", "serve", "--protocol", "profibus"), "--protocol"),
        (("rig", "serve", "--port", "70000"), "--port"),
        (("rig", "serve", "--effect", "gremlins=3"), "--effect: no effect 'gremlins'"),
        (("rig", "serve", "--faults", "gremlins=0.1"), "--faults: there is no fault 'gremlins'; known are drop, delay"),
        (("rig", "serve", "--speed-rad-s", "nan"), "--speed-rad-s"),
        (("rig", "serve", "--speed-rad-s", "1e9"), "--speed-rad-s"),
        (("rig", "serve", "--protocol", "modbus-tls"), "--certificate"),
        (("effects", "gremlins"), "loop_delay"),
        (("export", "model", "result.json", "plant.doc"), ".mat"),
        (("export", "model", "result.json", "plant.mat", "--plane", "z"), "'z' is not one of 'x', 'y'"),
        (("export", "responses", "experiment.h5", "r.uff", "--path", "a->b"), "'u->y'"),
        (("health", "plan", "--baseline", "x", "--budget-s", "inf"), "--budget-s"),
        (("submit", "gap", "--rig", "x"), "--experiment"),
        (("submit", "health", "--rig", "x", "--experiment", "e.h5"), "--experiment"),
        (
            ("submit", "experiment", "--rig", "x", "--quick", "--option", 'profile={"from_hz":-5}'),
            "--quick says it already",
        ),
        (("jobs", "--url", "nonsense"), "--url"),
        (("watch", "nonsense"), "job_"),
    ],
    ids=lambda a: " ".join(a) if isinstance(a, tuple) else "",
)
def test_bad_usage(arguments, said):
    line = refusal(*arguments, status=2)
    assert said in line
    assert "--help" in line


@pytest.mark.parametrize(
    ("arguments", "status"),
    [(("gap", "apply", "no.json", "--rig", "no.toml", "--out", "x.toml"), 1), (("effects", "gremlins"), 2)],
)
def test_a_process_ends_with_the_status_and_the_line_of_its_refusal(arguments, status):
    done = ambit(*arguments)
    assert done.returncode == status
    assert done.stdout == ""
    assert done.stderr == refusal(*arguments, status=status) + "\n"


def test_the_catalogue_as_json():
    done = at_once("effects", "--json")
    catalogue = json.loads(done.stdout)
    assert done.returncode == 0
    assert {e["id"] for e in catalogue["effects"]} >= {"loop_delay", "sensor_lag", "eddy_currents"}


def test_the_list_shows_every_law_to_the_letter():
    """Brackets of a law are no markup of the terminal's."""
    shown = "".join(at_once("effects").stdout.split())
    missing = [e.id for e in CATALOGUE.values() if "".join(e.law.split()) not in shown]
    assert not missing


def test_one_effect_in_words():
    done = at_once("effects", "loop_delay")
    assert "exp" in done.stdout or "tau" in done.stdout
    assert "separated by" in done.stdout


def test_a_reader_that_leaves_ends_no_one_in_a_traceback():
    import subprocess

    done = subprocess.run(
        f"{AMBIT[0]} effects --json | head -c 10",
        shell=True,
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        check=False,
    )
    assert done.stderr == ""


def test_the_datasheet_of_the_reference_rig(tmp_path):
    done = ambit("rig", "datasheet", "--out", tmp_path / "rig.toml")
    assert done.returncode == 0
    assert rig_file.read(tmp_path / "rig.toml") == reference_datasheet()
    assert at_once("rig", "datasheet").stdout == (tmp_path / "rig.toml").read_text()
