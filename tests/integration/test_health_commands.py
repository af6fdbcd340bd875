"""The commands around a commissioned rig, without the service: health, check-controller, export."""

import json
from functools import cache

import numpy as np
import pytest

from service.api.problems import UnprocessableError
from service.api.resources.options import checked_options
from service.cli import run
from service.experiment import file
from service.health.tones import short_plan
from service.identification.fit import identify
from service.jobs.calculations import health_compare
from sim.effects import CATALOGUE
from sim.reference import reference_rig
from sim.rig_file import to_toml
from tests.support.commissioned import LAW, SHEET
from tests.support.measured import small_experiment
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.two_axes import one_plane

MEASURED, PLANE = one_plane(*small_experiment())
"""One plane of the rig: the other one would be calculated in the same way."""


@cache
def result():
    return identify(MEASURED, PLANE).document()


@cache
def frequencies():
    return np.array(short_plan(PLANE, result(), 40.0).profile.frequencies_hz)


@pytest.fixture
def baseline(tmp_path):
    folder = tmp_path / "base"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(result()))
    (folder / "rig.toml").write_text(to_toml(PLANE))
    return folder


def experiment(path, ki=1.0, seed=1):
    model = plane_model_of(reference_rig(), "x")
    now = {"x": model.at(np.concatenate([model.theta[:2] * ki, model.theta[2:]]))}
    sweep = synthetic_sweep(now, PLANE.axes, LAW, frequencies(), 0.05, seed=seed)
    file.write(path, synthetic_experiment(sweep, axes=PLANE.axes))
    return path


def test_checks_add_up_to_a_history_in_the_baselines_folder_and_a_trend(baseline, tmp_path, capsys):
    """Those of a year share the allowance of false alarms, so each has to know of those before."""
    history = baseline / "history.jsonl"
    for k in range(3):
        found = experiment(tmp_path / f"{k}.h5", 0.97 if k == 2 else 1.0, seed=k)
        out = tmp_path / f"out{k}"
        command = ["health", "compare", found, "--baseline", baseline, "--out", out, "--json"]
        assert run([str(c) for c in command]) == 0
        printed = json.loads(capsys.readouterr().out)
        assert printed["files"]["history"] == str(history)
        assert printed["alarm"] is (k == 2)
        assert printed["tests_made"] == k
        assert json.loads((out / "health.json").read_text())["drifted"] == printed["drifted"]
        assert "Health of" in (out / "health.html").read_text()
    assert set(printed["drifted"]) == {"x.kiA", "x.kiB"}
    assert run(["health", "trend", str(baseline), "--json"]) == 0
    trend = json.loads(capsys.readouterr().out)
    assert trend["checks"] == 3
    assert trend["series"]["x.kiA"]["drifted"] == [False, False, True]


def test_a_trend_is_asked_for_as_the_checks_were_made(baseline, tmp_path, capsys):
    """By the commissioning's folder, in which the history lies, or by the file, as an argument or an option."""
    history = baseline / "history.jsonl"
    found = experiment(tmp_path / "e.h5")
    command = ["health", "compare", found, "--baseline", baseline, "--out", tmp_path / "o", "--history", history]
    assert run([str(c) for c in command]) == 0
    capsys.readouterr()
    for named in ([history], [baseline], ["--baseline", baseline], ["--history", history]):
        assert run(["health", "trend", *map(str, named), "--json"]) == 0, named
        assert json.loads(capsys.readouterr().out)["checks"] == 1
    for more, allowed in (([], 0.2), (["--false-alarms-per-year", "0.01"], 0.01)):
        assert run(["health", "trend", str(history), *more, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["false_alarms_per_year"] == allowed
    for named in ([], [history, "--baseline", baseline]):
        assert run(["health", "trend", *map(str, named)]) == 2
        assert "--baseline" in capsys.readouterr().err
    (baseline / "history.jsonl").unlink()
    assert run(["health", "trend", "--baseline", str(baseline)]) == 1
    assert f"{history} holds no check" in capsys.readouterr().err


def test_the_service_compares_with_the_allowance_of_its_job(baseline, tmp_path):
    """An option of a check and of a schedule, as of ambit health check."""
    assert checked_options("health", {"false_alarms_per_year": 0.01}) == {"false_alarms_per_year": 0.01}
    with pytest.raises(UnprocessableError, match="false_alarms_per_year"):
        checked_options("health", {"false_alarms_per_year": 2})
    where = {"baseline": baseline / "result.json", "rig": baseline / "rig.toml", "out": tmp_path / "o"}
    where |= {"experiment": experiment(tmp_path / "e.h5"), "history": tmp_path / "h.jsonl"}
    arguments = {k: str(v) for k, v in where.items()} | {"at": "2026-01-01T06:00:00+00:00"}
    for asked, allowed in ((None, 0.2), (0.01, 0.01)):
        (tmp_path / "h.jsonl").unlink(missing_ok=True)
        found = health_compare(**arguments, false_alarms_per_year=asked)
        assert found["false_alarms_per_year"] == allowed


@pytest.mark.parametrize("kept", [b'{"format": "amb-heal', '{"rig": "Prü'.encode()[:-1], b"\0\0\0\0"])
def test_a_history_that_a_crash_cut_short_goes_on(baseline, tmp_path, capsys, kept):
    """Wherever it was cut, within a letter of two bytes, too."""
    history, found = tmp_path / "history.jsonl", experiment(tmp_path / "e.h5")
    command = ["health", "compare", found, "--baseline", baseline, "--out", tmp_path / "o", "--history", history]
    arguments = [str(c) for c in (*command, "--json")]
    assert run(arguments) == 0
    with history.open("ab") as log:
        log.write(kept)
    assert run(["health", "trend", str(history), "--json"]) == 0
    assert run(arguments) == 0
    capsys.readouterr()
    assert len(history.read_text().splitlines()) == 2
    assert run(["health", "trend", str(history), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["checks"] == 2


def test_a_check_whose_line_has_lost_its_end_stays_in_the_history(baseline, tmp_path, capsys):
    """As an editor or a copy leaves it: it has been counted, and shares the allowance of the checks after it."""
    history, found = tmp_path / "history.jsonl", experiment(tmp_path / "e.h5")
    command = ["health", "compare", found, "--baseline", baseline, "--out", tmp_path / "o", "--history", history]
    arguments = [str(c) for c in (*command, "--json")]
    for made in range(3):
        capsys.readouterr()
        assert run(arguments) == 0
        assert json.loads(capsys.readouterr().out)["tests_made"] == made
        assert history.read_bytes().count(b"\n") == made + 1
        history.write_bytes(history.read_bytes().removesuffix(b"\n"))


def test_a_check_that_could_not_be_added_to_the_history_moves_no_rotor(baseline, tmp_path, capsys):
    """Missing there it would not count among those that share the allowance of false alarms."""
    (folder := tmp_path / "history.jsonl").mkdir()
    check = ["health", "check", "--controller", "simulated://", "--baseline", baseline]
    for history in (folder, tmp_path / "nowhere" / "h.jsonl"):
        assert run([*map(str, check), "--out", str(tmp_path / "o"), "--history", str(history)]) == 1
        told = capsys.readouterr().err
        assert f"cannot add to the history {history}" in told
        assert "nothing was started: name another one by --history" in told
    assert sorted(tmp_path.iterdir()) == [baseline, folder], "nothing is left behind"


def test_a_history_with_something_else_in_it_is_refused_by_line(tmp_path, capsys):
    (tmp_path / "history.jsonl").write_text('{"a": 1}\n{"b": 2}\n')
    assert run(["health", "trend", str(tmp_path / "history.jsonl")]) == 1
    assert "line 1" in capsys.readouterr().err


def test_a_line_of_a_history_that_is_whole_and_no_check_is_refused_by_line(baseline, tmp_path, capsys):
    """Also the last one: passed over, it would stand in the middle after the next check, and end the history there."""
    history, found = tmp_path / "history.jsonl", experiment(tmp_path / "e.h5")
    command = ["health", "compare", found, "--baseline", baseline, "--out", tmp_path / "o", "--history", history]
    assert run([str(c) for c in command]) == 0
    for damage in (b'{"format": "amb-heal\n', "{'rig': 'Prüfstand'}\n".encode("latin-1")):
        kept = history.read_bytes()
        history.write_bytes(kept + damage)
        assert run([str(c) for c in command]) == 1
        assert f"line 2 of {history}" in capsys.readouterr().err
        assert history.read_bytes() == kept + damage, "nothing is added to it, or taken away"
        history.write_bytes(kept)


def test_a_person_reads_the_alarm_its_figures_and_how_they_went(baseline, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    out, history = tmp_path / "out", tmp_path / "history.jsonl"
    found = experiment(tmp_path / "e.h5", 0.97)
    command = ["health", "compare", found, "--baseline", baseline, "--out", out, "--history", history]
    assert run([str(c) for c in command]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("ALARM: reference")
    (changed,) = (line for line in said if line.startswith(" x.kiA"))
    assert "drifted" in changed
    assert " x.kiA, N/A " in changed
    (mode,) = (line for line in said if line.startswith(" x.wn1, rad/s "))
    assert float(mode.split("±")[1].split()[0]) > 0, "as many digits as the deviation asks for"
    assert float(changed.split("±")[0].split()[-1]) == pytest.approx(-3.0, abs=0.3)
    assert f"report: {out / 'health.html'}" in said
    assert run(["health", "trend", str(history)]) == 0
    (went,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith(" x.kiA"))
    assert float(went.split()[1]) == pytest.approx(-3.0, abs=0.3)
    assert float(went.split()[3]) == pytest.approx(0.05, abs=0.04), "and how well that is known"
    assert run(["health", "plan", "--baseline", str(baseline)]) == 0
    planned = capsys.readouterr().out
    assert "Hz, every axis; about" in planned
    assert "x.kiA" in planned


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("health", "trend", "nothing.jsonl"), "run ambit health check first"),
        (("health", "plan", "--baseline", "nowhere"), "result.json"),
        (("health", "compare", "nothing.h5", "--baseline", "base", "--out", "out"), "nothing.h5"),
        (("gap", "diagnose", "nothing.h5", "--rig", "base/rig.toml", "--out", "out"), "nothing.h5"),
        (("gap", "apply", "base/result.json", "--rig", "base/rig.toml", "--out", "twin.toml"), "amb-gap-report"),
    ],
)
def test_what_cannot_be_done_is_one_line_that_says_what_to_give(
    baseline, tmp_path, capsys, monkeypatch, arguments, said
):
    monkeypatch.chdir(tmp_path)
    assert run(list(arguments)) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert said in line


def test_the_catalogue_of_effects_for_a_person(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert run(["effects"]) == 0
    listed = capsys.readouterr().out
    for name in CATALOGUE:
        assert f" {name} " in listed
    assert run(["effects", "loop_delay"]) == 0
    assert "delay_s: " in capsys.readouterr().out


def test_plan_and_secret(baseline, capsys):
    assert run(["health", "plan", "--baseline", str(baseline), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["frequencies_hz"]) > 8
    assert run(["health", "secret"]) == 0
    assert capsys.readouterr().out.startswith("whsec_")
    assert run(["health", "secret", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["secret"].startswith("whsec_")


def test_a_controller_is_refused_with_a_reason_and_accepted_with_another_table(baseline, tmp_path, capsys):
    sheet = str(baseline / "rig.toml")
    assert run(["check-controller", sheet, "--baseline", str(baseline), "--json"]) == 1
    refused = capsys.readouterr()
    assert json.loads(refused.out)["verdict"] == "unsafe"
    assert len(refused.err.splitlines()) == 1
    accepted = ["check-controller", sheet, "--baseline", str(baseline), "--zones", "ok=20,bad", "--accept", "ok"]
    assert run(accepted) == 0
    assert "verdict: safe at standstill; at speed it is not known" in capsys.readouterr().out
    (tmp_path / "c.toml").write_text("[controller]\nnumerator = 3\n")
    assert run(["check-controller", str(tmp_path / "c.toml"), "--baseline", str(baseline)]) == 1
    assert "numerator and denominator" in capsys.readouterr().err


def test_a_controller_of_which_nothing_is_known_is_not_let_pass(baseline, tmp_path, capsys):
    """A model that does not describe the rig, and a plane without one: exit status 1, with the reason."""
    sheet = str(baseline / "rig.toml")
    command = ["check-controller", sheet, "--baseline", str(baseline), "--zones", "ok=20,bad", "--accept", "ok"]
    poor = json.loads(json.dumps(result()))
    poor["planes"]["x"]["residuals"] |= {"model_adequate": False, "rms_over_sigma": 85.0}
    (baseline / "result.json").write_text(json.dumps(poor))
    assert run([*command, "--json"]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["verdict"] == "not known"
    (line,) = printed.err.splitlines()
    assert "is not known: plane x: the model leaves residuals 85 times the noise" in line
    (baseline / "result.json").write_text(json.dumps(result()))
    (baseline / "rig.toml").write_text(to_toml(SHEET))
    assert run(command) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "verdict: not known" in shown
    assert "no model of yA, yB" in shown


def test_exports_and_what_they_hold(baseline, tmp_path, capsys):
    (plane,) = result()["planes"].values()
    other = json.loads(json.dumps(plane).replace("xA", "yA").replace("xB", "yB"))
    (baseline / "result.json").write_text(json.dumps(result() | {"planes": {"x": plane, "y": other}}))
    out = tmp_path / "x" / "plant.mat"
    assert run(["export", "model", str(baseline / "result.json"), str(out), "--plane", "y"]) == 0
    assert run(["export", "show", str(out)]) == 0
    assert "i_yA [A]" in capsys.readouterr().out
    frf = tmp_path / "frf.uff"
    assert run(["export", "responses", str(experiment(tmp_path / "e.h5")), str(frf), "--path", "r->u"]) == 0
    assert run(["export", "show", str(frf)]) == 0
    assert "u_xA, u_xB per r_xA, r_xB" in capsys.readouterr().out
    assert run(["export", "model", str(baseline / "result.json"), str(out), "--json"]) == 0
    model = json.loads(capsys.readouterr().out)
    assert model.pop("files") == {"model": str(out)}
    assert model["outputs"] == ["y_xA", "y_xB"]
    assert model["output_units"] == ["m", "m"]
    assert run(["export", "show", str(out), "--json"]) == 0
    read_back = json.loads(capsys.readouterr().out)
    assert {k: read_back[k] for k in model if k != "comment"} == {k: model[k] for k in model if k != "comment"}
    assert run(["export", "responses", str(tmp_path / "e.h5"), str(frf), "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)
    assert measured.pop("files") == {"x": str(frf)}
    assert run(["export", "show", str(frf), "--json"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)["responses"]
    assert shown["frequencies"] == len(frequencies())
    assert shown["inputs"] == measured["responses"][0]["inputs"] == ["u_xA", "u_xB"]
    assert run(["export", "model", str(baseline / "result.json"), str(tmp_path / "x.xls")]) == 2
    assert run(["export", "model", str(baseline / "result.json"), str(out), "--part", "rotor"]) == 2


@pytest.mark.parametrize("command", [("plan",), ("check", "--controller", "simulated://", "--out", "out")])
def test_a_budget_that_holds_no_check_is_told_with_the_option_and_the_least(baseline, tmp_path, capsys, command):
    words = [str(tmp_path / word) if word == "out" else word for word in command]
    assert run(["health", *words, "--baseline", str(baseline), "--budget-s", "20"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "--budget-s" in told
    assert "20 s of rig time hold no health check" in told
    assert not (tmp_path / "out").exists()
