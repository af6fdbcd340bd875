"""Who gets in: from an open service on one machine to keys on the network, as an operator takes it there."""

import json
import re
import shlex
import socket

import httpx
import pytest

from tests.support import command
from tests.support.service import service


def own_address() -> str | None:
    """An address of this machine that is not the loopback's."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return None
        address = probe.getsockname()[0]
    return None if address.startswith("127.") else address


def answers(url: str, **how: object) -> int:
    return httpx.get(f"{url}/api/v1/rigs", trust_env=False, timeout=10, **how).status_code


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


@pytest.mark.slow
def test_from_one_machine_to_keys_on_the_network(tmp_path):
    home = tmp_path / "a home"
    with service(home, "sqlite", "--no-worker", host="0.0.0.0", log_level="debug") as running:
        url = running.api.said
        assert url.startswith("http://127.0.0.1:")
        advice = re.search(r"no API key exists.* with ambit (.*)", running.logs())
        assert answers(url) == 200
        assert answers(url, headers={"Host": "rotor.example.org"}) == 401
        assert answers(url, headers={"Origin": "https://example.org"}) == 401
        outside = own_address()
        if outside:
            with pytest.raises(httpx.ConnectError):
                answers(url.replace("127.0.0.1", outside))

        admin = command.ambit(*shlex.split(advice[1])).stdout.strip()  # as it stands there, for this very service
        assert answers(url) == 401  # at once, without a restart
        assert answers(url, headers=bearer(admin)) == 200

        running.api.interrupt()
        running.api.start()
        everywhere = running.api.said.replace("0.0.0.0", outside or "127.0.0.1")
        assert "0.0.0.0" in running.api.said
        assert answers(everywhere) == 401
        assert answers(everywhere, headers=bearer(admin)) == 200

        viewer = json.loads(command.ambit("keys", "create", "--home", home, "--json").stdout)
        assert answers(everywhere, headers=bearer(viewer["key"])) == 200
        refused = httpx.post(f"{everywhere}/api/v1/rigs", json={}, headers=bearer(viewer["key"]), trust_env=False)
        assert refused.status_code == 403
        assert refused.headers["content-type"] == "application/problem+json"
        command.ambit("keys", "revoke", viewer["id"], "--home", home)
        gone = httpx.get(f"{everywhere}/api/v1/rigs", headers=bearer(viewer["key"]), trust_env=False)
        assert (gone.status_code, "revoked" in gone.json()["detail"]) == (401, True)
        assert gone.headers["www-authenticate"].startswith("Bearer")

        told = running.logs()
        for key in (admin, viewer["key"]):
            assert key.rsplit("_", 1)[1] not in told
        log = httpx.get(f"{everywhere}/api/v1/audit", headers=bearer(admin), trust_env=False).json()["items"]
        actions = [line["action"] for line in log]
        assert [a for a in actions if a != "access.refused"] == ["key.revoked", "key.created", "key.created"]
        assert "access.refused" in actions  # those who came without a key, or with one that did not do, left a trace


@pytest.mark.pg
def test_the_password_of_the_database_is_in_no_log(tmp_path):
    from sqlalchemy import make_url

    from tests.support.postgres import empty_database

    with empty_database() as url:
        secret = make_url(url).set(password="hushhush").render_as_string(hide_password=False)
        assert "hushhush" in secret
        settings = {"database_url": secret, "log_level": "debug"}
        with service(tmp_path / "home", "sqlite", "--no-worker", **settings) as running:
            assert answers(running.api.said) == 200
            import psycopg

            from tests.support.postgres import server

            with psycopg.connect(server(), autocommit=True) as admin:  # the database goes away under it
                admin.execute(
                    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s",
                    (make_url(url).database,),
                )
                admin.execute(f'ALTER DATABASE "{make_url(url).database}" ALLOW_CONNECTIONS false')
            assert answers(running.api.said) == 503
            assert "does not answer" in running.logs()
            assert "hushhush" not in running.logs()
