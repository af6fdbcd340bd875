"""Behind a proxy callers are who the proxy saw, whatever they write into X-Forwarded-For themselves."""

import httpx
import pytest

from service.access import keys
from service.access.keys import Scope
from service.api.access import FAILURES
from service.api.server import prepared
from service.config import Settings, load
from service.errors import ConfigurationError
from service.storage import keys as key_rows
from service.storage import migrate
from service.storage.database import Database
from service.storage.ids import new_id
from tests.support.service import reference_sheet
from tests.support.serving import serving


def with_key(settings: Settings) -> str:
    """The operator's key of a service that has not been started yet."""
    database = Database(settings.database)
    migrate.upgrade(database)
    record, key = keys.issue(new_id("key"), "laptop", Scope.operator)
    with database.write() as session:
        key_rows.add(session, key_rows.row(record, "test"))
    database.close()
    return key


@pytest.mark.parametrize(
    ("proxies", "forwarded", "seen"),
    [
        ("127.0.0.1", "127.0.0.1, 203.0.113.9", "203.0.113.9"),
        ("127.0.0.1, 192.0.2.0/30", "127.0.0.1, 203.0.113.9, 192.0.2.1", "203.0.113.9"),
        ("192.0.2.1", "203.0.113.9", "127.0.0.1"),
    ],
    ids=["what the caller wrote", "a chain of proxies", "no proxy of ours"],
)
def test_the_audit_log_has_the_address_that_the_nearest_proxy_saw(tmp_path, proxies, forwarded, seen):
    settings = Settings(home=tmp_path / "home", port=0, behind_proxy=True, trusted_proxies=proxies)
    header = {"Authorization": f"Bearer {with_key(settings)}", "X-Forwarded-For": forwarded}
    with serving(settings) as service, httpx.Client(base_url=f"{service.url}/api/v1", headers=header) as api:
        assert api.post("/rigs", json={"datasheet": reference_sheet()}).status_code == 201
        (line,) = api.get("/audit").json()["items"]
    assert line["detail"]["address"] == seen


def test_who_guesses_keys_is_slowed_down_under_whatever_name(tmp_path):
    settings = Settings(home=tmp_path / "home", port=0, behind_proxy=True)
    with_key(settings)
    guess = {"Authorization": f"Bearer ambit_{'0' * 26}_{'0' * 48}"}
    with serving(settings) as service, httpx.Client(base_url=f"{service.url}/api/v1", headers=guess) as api:
        forged = [{"X-Forwarded-For": f"198.51.100.{k}, 203.0.113.9"} for k in range(5 * FAILURES.burst)]
        answers = [api.get("/rigs", headers=header).status_code for header in forged]
    assert answers[0] == 401
    assert 429 in answers


def test_a_service_without_keys_does_not_start_behind_a_proxy(tmp_path):
    with pytest.raises(ConfigurationError, match="ambit keys create"):
        prepared(Settings(home=tmp_path / "home", port=0, behind_proxy=True))


def test_a_service_without_keys_serves_nobody_whom_a_proxy_passes_on(tmp_path):
    with serving(Settings(home=tmp_path / "home", port=0)) as service:
        refused = httpx.get(f"{service.url}/api/v1/rigs", headers={"X-Forwarded-For": "203.0.113.9"})
        assert httpx.get(f"{service.url}/api/v1/rigs").status_code == 200
    assert refused.status_code == 401
    for word in ("x-forwarded-for", "ambit keys create"):
        assert word in refused.json()["detail"]


@pytest.mark.parametrize("proxies", ["*", "proxy.example.org", "10.0.0.1/8", "", "127.0.0.1,"])
def test_proxies_are_addresses_and_networks_and_nothing_else(proxies):
    with pytest.raises(ConfigurationError, match=r"trusted_proxies: .* is no address or network"):
        load(None, {"AMBIT_TRUSTED_PROXIES": proxies})
