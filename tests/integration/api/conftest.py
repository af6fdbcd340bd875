"""A service behind a real socket, without a worker: a test decides what becomes of a job."""

import httpx
import pytest

from service.config import Settings
from tests.support.api import commissioned
from tests.support.service import reference_sheet
from tests.support.serving import serving


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    home, address = tmp_path_factory.mktemp("home"), "https://rotor.example.org/"
    with serving(Settings(home=home, port=0, requests_per_s=10_000, public_url=address)) as found:
        yield found


@pytest.fixture(scope="module")
def api(service):
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=30) as client:
        yield client


@pytest.fixture
def rig(api, request):
    body = {"datasheet": reference_sheet(), "controller_url": "modbus://127.0.0.1:9", "name": request.node.name[:200]}
    return api.post("/rigs", json=body).json()["id"]


@pytest.fixture
def experiment(service, rig):
    """Of this rig; its file does not matter here."""
    return commissioned(service, rig)
