"""What a job found, in its own words and in one line."""

from types import SimpleNamespace

import pytest

from service.cli.verdict import identified, verdict

STIFFNESS = {
    "kiA": {"value": 181.0224, "std": 0.0271, "unit": "N/A"},
    "kiB": {"value": 186.0061, "std": 0.0118, "unit": "N/A"},
    "ksA": {"value": 1680370.0, "std": 290.0, "unit": "N/m"},
    "ksB": {"value": 1729920.0, "std": 210.0, "unit": "N/m"},
}
PLANES = {p: {"stiffness": STIFFNESS, "iso_14839_3_zone": zone} for p, zone in (("x", "A"), ("y", "B"))}
SERVICE = SimpleNamespace(
    models=SimpleNamespace(get=lambda _: SimpleNamespace(summary={"planes": PLANES})),
    gaps=SimpleNamespace(document=lambda _: {"verdict": {"kind": "effect", "sentence": "A further delay of 35 us."}}),
    health=SimpleNamespace(get=lambda _: SimpleNamespace(sentence="bench 3: kiA of plane x drifted by -2.1 %")),
)
PLANE = "kiA 181.022 ± 0.027, kiB 186.006 ± 0.012 N/A, ksA 1680370 ± 290, ksB 1729920 ± 210 N/m"


@pytest.mark.parametrize(
    ("made", "line"),
    [
        ({"experiment": "exp_1", "model": "mod_1"}, f"x: {PLANE}, zone A; y: {PLANE}, zone B"),
        ({"experiment": "exp_1", "gap": "gap_1"}, "A further delay of 35 us."),
        ({"experiment": "exp_1", "health": "chk_1"}, "bench 3: kiA of plane x drifted by -2.1 %"),
        ({"experiment": "exp_1"}, ""),
    ],
)
def test_a_job_s_verdict(made, line):
    assert verdict(SERVICE, SimpleNamespace(result=made)) == line


def test_a_model_that_says_nothing_is_told_as_that():
    """No figure of one that is not identified; one that lacks something has its figures with that reserve."""
    nothing = {"tone": "bad", "sentence": "The rig 'r' is not identified.", "planes": PLANES}
    assert identified(nothing) == "The rig 'r' is not identified."
    wrong = {"tone": "warn", "sentence": "s", "planes": {"x": {**PLANES["x"], "model_adequate": False}}}
    assert identified(wrong) == f"x: {PLANE}, zone A, model not adequate"
