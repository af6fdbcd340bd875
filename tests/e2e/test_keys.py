"""``ambit keys``: the first key, the others, and the end of one."""

import json
import sqlite3
from contextlib import closing

import pytest

from tests.support import command


@pytest.fixture
def ambit(tmp_path, monkeypatch):
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_HOME", str(tmp_path / "home"))
    return command.at_once


def kept(tmp_path) -> str:
    """All that the database holds."""
    with closing(sqlite3.connect(tmp_path / "home" / "ambit.db")) as connection:
        return "".join(connection.iterdump())


def test_the_first_key_is_an_admins_and_is_shown_once(ambit, tmp_path):
    made = ambit("keys", "create", "--name", "bench [red] laptop")
    key = made.stdout.strip()
    assert made.returncode == 0
    assert key.startswith("ambit_")
    assert "admin" in made.stderr
    shown = json.loads(ambit("keys", "list", "--json").stdout)["keys"]
    assert [(k["name"], k["scope"], k["state"]) for k in shown] == [("bench [red] laptop", "admin", "valid")]
    assert key.rsplit("_", 1)[1] not in kept(tmp_path)

    second = json.loads(ambit("keys", "create", "--days", "1", "--json").stdout)
    assert second["scope"] == "viewer"
    assert second["expires"]
    assert second["id"] in ambit("keys", "revoke", second["id"]).stderr
    again = json.loads(ambit("keys", "revoke", second["id"], "--json").stdout)
    assert (again["id"], again["state"]) == (second["id"], "revoked")
    assert again["revoked"]
    table = ambit("keys", "list").stdout
    assert "revoked" in table
    assert "bench [red] laptop" in table, "a name is no markup"
    assert "key.revoked" in kept(tmp_path)


def test_a_key_that_does_not_exist_cannot_be_revoked(ambit):
    done = ambit("keys", "revoke", "key_nobody")
    assert done.returncode == 1
    assert "ambit keys list" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_database_that_is_away_is_one_line(ambit, monkeypatch):
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_DATABASE_URL", "postgresql://ambit:hush@127.0.0.1:1/ambit")
    done = ambit("keys", "list")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "database" in done.stderr
    assert "hush" not in done.stderr
