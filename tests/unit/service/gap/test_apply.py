"""A gap report that does not say what to add is refused in words; one that does is added as it was fitted."""

import copy

import pytest

from service.gap.apply import applied
from service.gap.measured.observation import GapError
from sim.reference import reference_datasheet

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


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (["verdict"], None, 'no "verdict"; diagnose again'),
        (["verdict", "effects"], None, r'no "verdict\.effects"; diagnose again'),
        (["verdict", "effects"], [], "verdict is effects: there is no effect to add"),
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
