"""What the README shows can be typed, and what it points at is there."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.address import _OPTIONS
from service.cli import app
from tests.support.commands_of import assert_understood

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text()


def commands() -> list[str]:
    blocks = "\n".join(re.findall(r"```sh\n(.*?)```", README, re.DOTALL))
    typed = ";".join(line.split(" #")[0] for line in blocks.splitlines()).split(";")
    return [command.split(">")[0].strip() for command in typed if command.strip().startswith("ambit ")]


@pytest.mark.parametrize("line", commands())
def test_every_command_is_understood(line):
    assert_understood(shlex.split(line)[1:])


def test_every_command_of_make_and_every_benchmark_is_there():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    shown = set(re.findall(r"(?:^|`)make ([a-z]+)", README, re.MULTILINE))
    assert {"demo", "test"} <= shown <= set(targets)
    for script in re.findall(r"`python (benchmarks/\w+\.py)`", README):
        assert (ROOT / script).is_file(), script


@pytest.mark.parametrize("page", ["README.md", "deploy/README.md", "docs/decisions/README.md"])
def test_every_link_leads_somewhere(page):
    path = ROOT / page
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", path.read_text()) if "://" not in link]
    assert links
    for link in links:
        assert (path.parent / link).exists(), link


def test_every_kind_of_controller_is_named_in_the_readme_and_in_the_help():
    for scheme in _OPTIONS:
        assert f"| `{scheme}://" in README, scheme
    for words in (("commission",), ("health", "check")):
        told = " ".join(CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "400"}).output.split())
        assert all(f"{scheme}://" in told for scheme in _OPTIONS), words
    assert "transcript=" in README
