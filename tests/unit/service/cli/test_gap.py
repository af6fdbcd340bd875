"""The terminal tells the explanations of a gap as the report does."""

from typing import Any

from rich.console import Console

from service.cli.gap import _candidates


def told(*found: dict[str, Any]) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(_candidates(list(found)))
    return capture.get()


def explanation(**fields: Any) -> dict[str, Any]:
    parameters = {"delay_s": {"value": 3e-5, "std": 1e-6}}
    return {"effect": "loop_delay", "probability": 0.9, "closure": 0.98, "parameters": parameters} | fields


def test_what_closes_nothing_closes_no_less_than_nothing() -> None:
    assert " 0 %" in told(explanation(closure=-0.002))
    assert "-0 %" not in told(explanation(closure=-0.002))
