"""The terminal tells the explanations of a gap as the report does."""

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from typer.testing import CliRunner

from service.cli.gap import _candidates, _proposal, app
from service.gap.document import likeliest, parameters_used
from sim.effects import CATALOGUE
from sim.reference import reference_datasheet
from sim.rig_file import to_toml


def told(*found: dict[str, Any], kind: str = "effect") -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(_candidates(list(found), kind))
    return capture.get()


def explanation(**fields: Any) -> dict[str, Any]:
    parameters = {"delay_s": {"value": 3e-5, "std": 1e-6}}
    return {"effect": "loop_delay", "probability": 0.9, "closure": 0.98, "parameters": parameters} | fields


def test_a_value_at_an_end_of_its_range_is_told_as_that() -> None:
    stopped = {"delay_s": {"value": 5e-4, "std": 1e-6, "at_bound": "high"}}
    assert "delay_s 0.0005 (high end of its range)" in told(explanation(parameters=stopped))
    assert "range" not in told(explanation())


def test_where_nothing_explains_a_gap_no_effect_seems_to_be_named() -> None:
    """The likeliest of what was tried is no verdict, nor is its share a probability that it is there."""
    assert "rejected explanation" in told(explanation(), kind="none_of_these")
    assert "probability" not in told(explanation(), kind="none_of_these")
    assert "rejected" not in told(explanation())
    assert "probability" in told(explanation())


def test_what_closes_nothing_closes_no_less_than_nothing() -> None:
    assert " 0 %" in told(explanation(closure=-0.002))
    assert "-0 %" not in told(explanation(closure=-0.002))


def test_an_effect_that_the_data_do_not_show_has_no_closure() -> None:
    assert "not shown" in told(explanation(closure=None, open_strength=["loop_delay"]))
    assert "not shown" not in told(explanation(closure=None, open_strength=[]))


def test_a_twin_with_a_value_that_was_not_measured_is_written_with_a_note(tmp_path: Path) -> None:
    sheet = reference_datasheet()
    stopped = {"delay_s": {"value": 3e-4, "std": 1e-6, "at_bound": "high"}}
    verdict = {"kind": "effect", "effects": ["loop_delay"]}
    report = {"format": "amb-gap-report", "version": 1, "rig": sheet.name, "verdict": verdict}
    report["of"] = {"datasheet_sha256": "another one's"}
    found = report | {"candidates": [{"effect": "loop_delay", "parameters": stopped}]}
    (tmp_path / "rig.toml").write_text(to_toml(sheet))
    (tmp_path / "gap.json").write_text(json.dumps(found))
    paths = ["--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "twin.toml")]
    printed = CliRunner().invoke(app, ["apply", str(tmp_path / "gap.json"), *paths])
    assert "note: delay of loop delay is at the high end of its range" in printed.stdout
    told = json.loads(CliRunner().invoke(app, ["apply", str(tmp_path / "gap.json"), *paths, "--json"]).stdout)
    assert told["added"] == [{"effect": "loop_delay", "parameters": {"delay_s": 3e-4}}]
    assert told["files"] == {"twin": str(tmp_path / "twin.toml")}
    assert told["ends_reached"] == [
        "delay of loop delay is at the high end of its range, where the fit had to stop: not measured"
    ]
    assert told["removed"] == told["datasheet_off"] == []
    (warning,) = told["warnings"]
    assert printed.stderr == f"warning: {warning}\n", "the same words"


def test_a_datasheet_that_is_far_off_is_said_to_stay_so_in_the_twin(tmp_path: Path) -> None:
    sheet = reference_datasheet()
    report = {
        "format": "amb-gap-report", "version": 1, "rig": sheet.name, "candidates": [],
        "verdict": {"kind": "no_gap", "effects": []}, "datasheet_off": ["current stiffness yB +88 %"],
    }  # fmt: skip
    (tmp_path / "rig.toml").write_text(to_toml(sheet))
    (tmp_path / "gap.json").write_text(json.dumps(report))
    paths = ["--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "twin.toml")]
    printed = CliRunner().invoke(app, ["apply", str(tmp_path / "gap.json"), *paths])
    assert "values stay, far off as they are (current stiffness yB +88 %); identify measures them" in printed.stdout


def test_the_named_explanation_comes_first_and_then_the_likeliest() -> None:
    of = {"runout": 0.2, "loop_delay": 0.1, "sensor_lag": 0.001, "loop_delay+runout": 0.002, "eddy_currents": 0.03}
    candidates = [explanation(effect=name, probability=p) for name, p in of.items()]
    found = likeliest({"verdict": {"effects": ["loop_delay"]}, "candidates": candidates})
    assert [c["effect"] for c in found] == ["loop_delay", "runout", "eddy_currents", "sensor_lag", "loop_delay+runout"]


def test_what_to_measure_next_is_told_with_its_price_and_the_command_that_asks_for_it() -> None:
    proposed = {
        "description": "each axis from 1 kHz up to 3 kHz", "rig_seconds": 754.0, "odds_of_telling_apart": 0.96,
        "command": "ambit submit experiment --rig bench", "separates": ["loop_delay", "eddy_currents+runout"],
    }  # fmt: skip
    assert _proposal(proposed) == (
        "next: each axis from 1 kHz up to 3 kHz; 13 min on the rig, 96 % likely to tell loop delay from "
        "eddy currents + runout: ambit submit experiment --rig bench"
    )


def test_what_has_to_be_done_by_hand_is_told_before_the_command_that_needs_it() -> None:
    """The command alone would measure the rotor as it stands, and what it was proposed for would not show."""
    before, after = ("bring the rotor to 30 rev/s and hold it",), ("tell the diagnosis of it",)
    proposed = {
        "description": "the same band at 30 rev/s", "rig_seconds": 754.0, "odds_of_telling_apart": 0.96,
        "command": "ambit submit experiment --rig bench", "separates": ["loop_delay", "eddy_currents"],
        "by_hand": [*before, *after],
    }  # fmt: skip
    first, *steps, command = _proposal(proposed).splitlines()
    assert first.startswith("next: the same band at 30 rev/s; 13 min on the rig")
    assert steps == [f"by hand: {step}" for step in (*before, *after)]
    assert command.endswith("ambit submit experiment --rig bench")


def test_parameters_of_wider_laws_that_an_explanation_does_without_are_not_listed():
    null = {effect: CATALOGUE[effect].null() for effect in ("loop_delay", "sensor_lag")}
    delayed = {**null["loop_delay"], "delay_s": 2e-5}
    alone = {"effect": "loop_delay", "parameters": {name: {"value": v} for name, v in delayed.items()}}
    assert list(parameters_used(alone)) == ["delay_s"]
    values = {f"{effect}.{name}": v for effect in null for name, v in null[effect].items()}
    both = {**values, "loop_delay.plane_imbalance": 1.0, "sensor_lag.delay_s": 1e-5}
    mixture = {"effect": "loop_delay+sensor_lag", "parameters": {name: {"value": v} for name, v in both.items()}}
    assert set(parameters_used(mixture)) >= {"loop_delay.delay_s", "loop_delay.plane_imbalance", "sensor_lag.delay_s"}
    assert "loop_delay.end_imbalance" not in parameters_used(mixture)
