"""A gap report that does not say what to add is refused in words; one that does is added as it was fitted."""

import copy
import json
import re
from dataclasses import replace

import pytest

from service.cli import run
from service.gap.apply import applied, cannot_run, not_told_apart
from service.gap.measured.observation import GapError
from service.gap.origin import datasheet_digest
from sim.reference import reference_datasheet
from sim.rig_file import parse, to_toml

SHEET = reference_datasheet()
MIXTURE = {
    "format": "amb-gap-report",
    "version": 1,
    "rig": SHEET.name,
    "verdict": {"kind": "effects", "effects": ["loop_delay", "sensor_lag"]},
    "candidates": [
        {"effect": "loop_delay", "parameters": {"delay_s": {"value": 9e-5, "std": 1e-6}}},
        {
            "effect": "loop_delay+sensor_lag",
            "parameters": {
                "loop_delay.delay_s": {"value": 3e-5, "std": 1e-6},
                "sensor_lag.time_constant_s": {"value": 2e-5, "std": 1e-6},
                "sensor_lag.delay_s": {"value": 1e-6, "std": 1e-7},
            },
        },
    ],
}


def changed(path: list[str | int], value: object) -> dict:
    """The report with one place changed; without it when the value is None."""
    report = copy.deepcopy(MIXTURE)
    place = report
    for key in path[:-1]:
        place = place[key]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return report


def test_every_effect_of_a_mixture_is_added_at_the_mixtures_values():
    assert applied(SHEET, MIXTURE).effects == (
        ("loop_delay", (("delay_s", 3e-5),)),
        ("sensor_lag", (("time_constant_s", 2e-5), ("delay_s", 1e-6))),
    )


def test_what_a_report_does_not_say_of_a_wider_law_is_where_the_law_is_plainest():
    """It may be older than that law."""
    told = {name: {"value": 0.02, "std": 1e-4} for name in ("gain_change", "derivative_change", "lag_samples")}
    report = MIXTURE | {"verdict": {"kind": "effect", "effects": ["controller_mismatch"]}}
    report["candidates"] = [{"effect": "controller_mismatch", "parameters": told}]
    assert applied(SHEET, report).effects == (("controller_mismatch", tuple((name, 0.02) for name in told)),)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["verdict"], None, 'no "verdict"; diagnose again'),
        (["verdict", "effects"], None, r'no "verdict\.effects"; diagnose again'),
        (["verdict", "effects"], [], "verdict is effects: there is no effect to add"),
        (["verdict"], {"kind": "none_of_these", "effects": []}, "verdict is none of these: there is no effect to add"),
        (["verdict"], "loop_delay", 'wrong "verdict"'),
        (["candidates"], None, r"no parameters of loop_delay \+ sensor_lag"),
        (["candidates", 1, "parameters"], None, r'no "candidates\.1\.parameters"; diagnose again'),
        (["candidates", 1, "parameters", "sensor_lag.time_constant_s"], None, "gives sensor_lag no time_constant_s"),
        (["candidates", 1, "parameters", "loop_delay.delay_s", "value"], "much", 'wrong "candidates.1.parameters'),
        (["rig"], "another", "is of rig 'another'"),
        (["format"], "amb-experiment", "is no gap report"),
    ],
)
def test_a_report_that_does_not_say_what_to_add_is_refused(path, value, said):
    with pytest.raises(GapError, match=said):
        applied(SHEET, changed(path, value))


def test_without_a_gap_the_twin_is_the_datasheet_and_what_takes_it_goes_on(tmp_path, capsys):
    report = changed(["verdict"], {"kind": "no_gap", "effects": []})
    (tmp_path / "gap.json").write_text(json.dumps(report))
    (tmp_path / "rig.toml").write_text(to_toml(SHEET))
    out = tmp_path / "twin.toml"
    words = ["gap", "apply", str(tmp_path / "gap.json"), "--rig", str(tmp_path / "rig.toml"), "--out", str(out)]
    assert run(words) == 0
    assert parse(out.read_text()) == SHEET
    assert "found no gap, so there is no effect to add" in capsys.readouterr().out
    (tmp_path / "gap.json").write_text(json.dumps(report | {"rig": "another"}))
    assert run(words) == 1


SATURATED = (("saturation_inverse_per_a", 2.0), ("flux_share", 1.2), ("flux_power", 4.0))


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ((), None),
        ((("logging_offset", (("samples", 0.98),)),), None),
        ((("magnetic_saturation", SATURATED),), r"^its controller does not levitate the rotor, .* a sample$"),
        ((("internal_damping", (("damping_ratio", 0.01),)),), "needs a flexible mode"),
    ],
)
def test_a_twin_that_nothing_can_simulate_is_told(effects, said):
    found = cannot_run(replace(SHEET, effects=effects))
    assert found is None if said is None else re.search(said, found)


def test_apply_warns_of_a_twin_that_does_not_levitate(tmp_path, capsys):
    """It is written all the same: identification works on it, and gives what it lacks."""
    values = {name: {"value": value, "std": 0.1} for name, value in SATURATED}
    verdict = {"kind": "effect", "effects": ["magnetic_saturation"]}
    candidates = [{"effect": "magnetic_saturation", "parameters": values}]
    (tmp_path / "gap.json").write_text(json.dumps(MIXTURE | {"verdict": verdict, "candidates": candidates}))
    (tmp_path / "rig.toml").write_text(to_toml(SHEET))
    out = tmp_path / "twin.toml"
    assert (
        run(["gap", "apply", str(tmp_path / "gap.json"), "--rig", str(tmp_path / "rig.toml"), "--out", str(out)]) == 0
    )
    (warning,) = capsys.readouterr().err.splitlines()
    assert warning.startswith("warning: this twin cannot be simulated or served as it stands, its controller does not")
    assert "ambit identify" in warning
    assert parse(out.read_text()).effects == (("magnetic_saturation", SATURATED),)


OPEN = {
    "verdict": {
        "kind": "effect",
        "effects": ["sensor_lag"],
        "indistinguishable": [["sensor_lag", "loop_delay", "eddy_currents"]],
        "probability": 0.97,
    },
    "candidates": [
        {"effect": "sensor_lag", "log_evidence": -10.0, "parameters": {"time_constant_s": {"value": 5e-6}}},
        {"effect": "loop_delay", "log_evidence": -10.7, "parameters": {"delay_s": {"value": 3e-5}}},
        {"effect": "eddy_currents", "log_evidence": -90.0, "parameters": {"time_constant_s": {"value": 1e-4}}},
    ],
}


def apply_of(report, tmp_path, *words):
    """Exit status of applying a report of the datasheet."""
    (tmp_path / "gap.json").write_text(json.dumps(MIXTURE | report))
    (tmp_path / "rig.toml").write_text(to_toml(SHEET))
    paths = ["--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "twin.toml")]
    return run(["gap", "apply", str(tmp_path / "gap.json"), *paths, *words])


def test_apply_warns_of_effects_that_the_data_do_not_tell_from_the_added_one(tmp_path, capsys):
    """The twin is written, as the diagnosis named one of them; whoever uses it has to know that it may be another."""
    assert apply_of(OPEN, tmp_path) == 0
    (warning,) = capsys.readouterr().err.splitlines()
    assert warning.startswith("warning: the data do not tell sensor lag from loop delay (")
    assert "one of these 97 %" in warning
    assert "eddy currents" not in warning, "fits as well, but is far less likely"
    assert parse((tmp_path / "twin.toml").read_text()).effects[0][0] == "sensor_lag"
    assert apply_of(OPEN, tmp_path, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["not_told_apart"] == {"sensor_lag": ["loop_delay"]}
    assert told["probability"] == 0.97
    assert told["warnings"] == [warning.removeprefix("warning: ")]


@pytest.mark.parametrize("classes", [[], [["sensor_lag", "eddy_currents"]]])
def test_apply_says_nothing_where_one_effect_is_left(classes, tmp_path, capsys):
    assert apply_of(OPEN | {"verdict": OPEN["verdict"] | {"indistinguishable": classes}}, tmp_path, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["not_told_apart"] == {}
    assert told["warnings"] == []


def test_of_a_mixture_each_effect_has_the_ones_that_may_be_in_its_place():
    """What was not fitted with the mixture's other effects, as an exact alias, is not known to be less likely."""
    classes = [["loop_delay", "amplifier_bandwidth"], ["sensor_lag", "eddy_currents"]]
    fitted = [c | {"log_evidence": -10.0} for c in MIXTURE["candidates"]]
    rival = {"effect": "loop_delay+eddy_currents", "log_evidence": -20.0, "parameters": {}}
    report = MIXTURE | {"verdict": MIXTURE["verdict"] | {"indistinguishable": classes}}
    assert not_told_apart(report | {"candidates": [*fitted, rival]}) == {"loop_delay": ["amplifier_bandwidth"]}
    assert not_told_apart(report) == {"loop_delay": ["amplifier_bandwidth"], "sensor_lag": ["eddy_currents"]}


def test_a_report_of_another_datasheet_is_told_to_be_one(tmp_path, capsys):
    """Its effects were fitted beside that one's values; a report that does not say what it is of is believed."""
    mine, other = (
        changed(["of"], {"datasheet_sha256": datasheet_digest(s)}) for s in (SHEET, replace(SHEET, mass_kg=9.0))
    )
    (tmp_path / "rig.toml").write_text(to_toml(SHEET))
    for report, told in ((mine, False), (other, True), (MIXTURE, False)):
        (tmp_path / "gap.json").write_text(json.dumps(report))
        words = [
            "gap",
            "apply",
            f"{tmp_path}/gap.json",
            "--rig",
            f"{tmp_path}/rig.toml",
            "--out",
            f"{tmp_path}/twin.toml",
        ]
        assert run(words) == 0
        assert ("another datasheet" in capsys.readouterr().err) is told
