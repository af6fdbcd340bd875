"""A service in which there is nothing yet: its lists say so, and what makes the first of them."""

import json

import pytest

from service.cli import run
from service.config import Settings
from tests.support.serving import serving


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    with serving(Settings(home=tmp_path_factory.mktemp("home"), port=0)) as service:
        yield service.url


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["schedules"], "no schedules: no rig is checked by itself; POST /api/v1/schedules makes one"),
        (["rigs"], "no rigs: ambit submit experiment --rig rig.toml --controller URL makes one known"),
        (["jobs"], "no jobs: ambit submit makes one"),
        (["jobs", "--state", "failed"], "no such jobs"),
    ],
)
def test_a_list_with_nothing_in_it_says_so_and_has_no_heading(url, capsys, words, told):
    assert run([*words, "--url", url]) == 0
    assert capsys.readouterr().out == f"{told}\n"
    assert run([*words, "--url", url, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {words[0]: []}
