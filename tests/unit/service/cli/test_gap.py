"""The terminal tells the explanations of a gap as the report does."""

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from typer.testing import CliRunner

from service.cli.gap import _candidates, app
from sim.reference import reference_datasheet
from sim.rig_file import to_toml


def told(*found: dict[str, Any]) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(_candidates(list(found)))
    return capture.get()


def explanation(**fields: Any) -> dict[str, Any]:
    parameters = {"delay_s": {"value": 3e-5, "std": 1e-6}}
    return {"effect": "loop_delay", "probability": 0.9, "closure": 0.98, "parameters": parameters} | fields


def test_a_value_at_an_end_of_its_range_is_told_as_that() -> None:
    stopped = {"delay_s": {"value": 5e-4, "std": 1e-6, "at_bound": "high"}}
    assert "delay_s 0.0005 (high end of its range)" in told(explanation(parameters=stopped))
    assert "range" not in told(explanation())


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
    found = report | {"candidates": [{"effect": "loop_delay", "parameters": stopped}]}
    (tmp_path / "rig.toml").write_text(to_toml(sheet))
    (tmp_path / "gap.json").write_text(json.dumps(found))
    paths = ["--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "twin.toml")]
    printed = CliRunner().invoke(app, ["apply", str(tmp_path / "gap.json"), *paths])
    assert "note: delay of loop delay is at the high end of its range" in printed.stdout
