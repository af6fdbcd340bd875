"""What an installation relies on beyond one process: the health check under TLS, and one store for all machines."""

import httpx
import pytest

from service import probe
from service.config import Settings
from service.errors import ConfigurationError
from service.jobs.worker import Worker
from service.storage import workers
from service.storage.database import Database
from service.storage.migrate import upgrade
from service.storage.tables import WorkerRow
from tests.support.certificates import make_authority
from tests.support.service import free_port
from tests.support.serving import serving


@pytest.mark.parametrize("tls", [False, True])
def test_the_health_check_asks_as_the_api_answers(tmp_path, monkeypatch, tls):
    monkeypatch.setattr(probe, "TIMEOUT_S", 60.0)  # a machine may stall for longer than a container may wait
    more = {}
    if tls:
        server = make_authority(tmp_path).server
        more = {"tls_certificate": server.certificate, "tls_key": server.key}
    settings = Settings(home=tmp_path / "home", port=free_port(), **more)
    assert not probe.ready(settings)
    with serving(settings):
        assert probe.ready(settings)


def on_another_machine(database: Database) -> None:
    upgrade(database)
    with database.write() as session:
        workers.sign_on(session, "w9", "wrk_9")
        session.flush()
        session.get(WorkerRow, "w9").machine = "other"


@pytest.mark.pg
def test_workers_of_two_machines_do_not_begin_with_a_store_each(tmp_path):
    from tests.support.postgres import empty_database

    with empty_database() as url:
        settings = Settings(home=tmp_path / "home", database_url=url, worker_name="w1", port=0)
        database = Database(url)
        on_another_machine(database)
        worker = Worker(settings)
        with pytest.raises(ConfigurationError, match="AMBIT_STORE_URL"):
            worker._sign_on()
        worker.context.database.close()
        shared = Worker(settings.model_copy(update={"store_url": str(tmp_path / "shared")}))
        shared._sign_on()
        shared.context.database.close()
        with serving(settings) as service:
            answer = httpx.get(f"{service.url}/readyz")
        assert (answer.status_code, "runs on other" in answer.json()["store"]) == (503, True)
        database.close()


def test_a_store_whose_library_is_missing_names_what_to_install(tmp_path, monkeypatch):
    import sys
    from importlib import import_module

    from service.errors import StorageError
    from service.storage.blobs import Blobs

    monkeypatch.setitem(sys.modules, "s3fs", None)
    opened = import_module("fsspec.registry")._registry  # fsspec.registry itself is a view of it
    monkeypatch.delitem(opened, "s3", raising=False)
    with pytest.raises(StorageError, match=r"amb-commissioning\[s3\]"):
        Blobs("s3://bucket/ambit")
