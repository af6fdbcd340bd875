"""The diagnosis can know no truth: it imports nothing that does, and the rule that says so names all of it."""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[4]
KNOWING = ("service.gap.trial", "service.trial", "sim.withheld", "drivers")


def test_the_diagnosis_imports_nothing_that_knows_a_truth() -> None:
    code = "import sys, service.gap.diagnose, service.gap.document; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "service.gap.diagnose" in found
    assert not [m for m in found if m.startswith(KNOWING)]


def test_the_rule_names_every_part_of_the_diagnosis_and_all_that_knows_a_truth() -> None:
    """A new file of the diagnosis must not be outside it."""
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    blind = next(r for r in rules if r["id"] == "blind")
    parts = {p.stem for p in (ROOT / "service" / "gap").iterdir() if not p.name.startswith("__")} - {"trial"}
    assert set(blind["source_modules"]) == {f"service.gap.{part}" for part in parts}
    assert set(blind["forbidden_modules"]) >= set(KNOWING) - {"drivers"}  # which another rule forbids
