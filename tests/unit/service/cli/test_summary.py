"""What a terminal says of a commissioning agrees with the report and with result.json."""

from typing import Any

import pytest
from rich.console import Console

from service.cli import summary
from service.experiment.data import Experiment

AXES = ("xA", "xB")


def document() -> dict[str, Any]:
    """As of result.json, of one plane."""
    ki = {"value": 181.0, "std": 0.03, "unit": "N/A", "nominal": 340.0, "error_percent": 87.845}
    names = ("kiA", "kiB", "ksA", "ksB")
    margins = {
        "sensitivity_peak": {"A": 4.231, "B": 5.118},
        "iso_14839_3_zone": "D",
        "zone_limits_db": {"A": 9.5, "B": 12.0, "C": 14.0},
    }
    return {"planes": {"x": {"stiffness": dict.fromkeys(names, ki), "rotor_modes": [], "margins": margins}}}


def test_the_datasheet_is_off_by_what_the_report_and_the_result_say() -> None:
    found = list(summary.rows(document(), AXES))
    assert {row["error_percent"] for row in summary.compared(found)} == {87.845}
    console = Console(width=120)
    with console.capture() as capture:
        console.print(summary.table(found, "datasheet"))
    assert "datasheet off by, %" in capture.get()
    assert "+87.8" in capture.get()


@pytest.mark.parametrize("told", ["1503.2 s", "nan", "inf", "-1"])
def test_a_time_on_the_rig_that_is_no_number_is_not_told(told: str) -> None:
    """As of a file that another program wrote: the identification has been done by then."""
    assert summary.times({"fit": 2.0}, Experiment("r", AXES, (), {"rig_seconds": told})) == "2.0 s (fit 2.0 s)"


def test_a_share_of_what_may_be_zero_is_a_dash() -> None:
    found = document()
    nothing = found["planes"]["x"]["stiffness"]["ksB"] | {"value": 0.0, "std": 19000.0, "error_percent": None}
    found["planes"]["x"]["stiffness"] |= {"ksB": nothing}
    console = Console(width=120)
    with console.capture() as capture:
        console.print(summary.table(list(summary.rows(found, AXES)), "datasheet"))
    (row,) = [line for line in capture.get().splitlines() if "ksB" in line]
    assert row.split()[-1] == "–"


def test_the_zone_of_the_sensitivity_peak_is_told() -> None:
    (told,) = summary.margins(document())
    assert told == "x-plane: sensitivity peak A 4.23 (12.5 dB), B 5.12 (14.2 dB), zone D of ISO 14839-3"
