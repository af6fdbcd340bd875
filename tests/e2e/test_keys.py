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


@pytest.mark.parametrize("name", ["a\x1b]0;title\x07", "two\nlines", "dear\u202eelbatrops", "n" * 201])
def test_a_name_that_would_not_be_shown_as_it_is_is_refused(ambit, name):
    done = ambit("keys", "create", "--name", name)
    assert done.returncode == 2
    assert "at most 200 characters, none of which is a control character" in " ".join(done.stderr.split())
    assert json.loads(ambit("keys", "list", "--json").stdout)["keys"] == []


def test_a_name_that_an_older_version_took_is_marked_where_it_is_listed(ambit, tmp_path):
    ambit("keys", "create", "--name", "bench")
    with closing(sqlite3.connect(tmp_path / "home" / "ambit.db")) as connection, connection:
        connection.execute("UPDATE api_keys SET name = 'a' || char(27) || '[31mred' || char(10) || 'key'")
    assert "a\ufffd[31mred key" in ambit("keys", "list").stdout


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
