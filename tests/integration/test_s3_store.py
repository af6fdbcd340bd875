"""A store at s3://, against a real server: what is kept is there for every machine, and every failure has a remedy."""

import hashlib
import os
from contextlib import contextmanager
from datetime import timedelta

import httpx
import pytest

from service.backup.create import create
from service.backup.restore import restore
from service.config import Settings
from service.errors import NotFoundError, StorageError
from service.storage.blobs import Blobs
from tests.support.s3 import Server
from tests.support.service import reference_sheet
from tests.support.serving import serving
from tests.support.uploads import good

s3fs = pytest.importorskip("s3fs")
pytest.importorskip("moto")

ABSENT = "0" * 64


@pytest.fixture(scope="module")
def server():
    server = Server()
    yield server
    server.end()


@pytest.fixture(autouse=True)
def environment(monkeypatch, tmp_path):
    """Nothing of this machine's own settings."""
    for name in [n for n in os.environ if n.startswith(("AWS_", "FSSPEC_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    s3fs.S3FileSystem.clear_instance_cache()
    yield
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def endpoint(server, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.url)


@pytest.fixture
def url(server, endpoint, request):
    return server.bucket(hashlib.sha256(request.node.name.encode()).hexdigest()[:20])


def told(failing, *arguments):
    """The one line of a failure."""
    with pytest.raises(StorageError) as found:
        failing(*arguments)
    assert "\n" not in str(found.value)
    return str(found.value)


def test_what_one_machine_keeps_another_one_reads(url, tmp_path):
    here, there = Blobs(url), Blobs(url + "?region=us-east-1")
    here.check()  # an empty bucket is a store
    assert list(here.names()) == []
    large = os.urandom(12 << 20)  # in several parts
    (tmp_path / "large").write_bytes(large)
    kept = {here.put(b"content"): b"content", here.put(b""): b"", here.put_file(tmp_path / "large"): large}
    assert here.put(b"content") in kept
    assert set(there.names()) == set(kept)
    for sha256, content in kept.items():
        assert there.has(sha256)
        assert there.size(sha256) == len(content)
        assert there.read(sha256) == content == b"".join(there.chunks(sha256))
        assert there.fetch(sha256, tmp_path / "copies" / sha256).read_bytes() == content
    # seen before it was there, and there now
    later = hashlib.sha256(b"later").hexdigest()
    assert not there.has(later)
    here.put(b"later")
    assert there.has(later)
    assert later in set(there.names())


def test_what_is_not_there_is_told_as_that(url):
    blobs = Blobs(url)
    assert not blobs.has(ABSENT)
    for asked in (blobs.read, blobs.size, lambda s: list(blobs.chunks(s))):
        with pytest.raises(NotFoundError, match="restore it from the backup"):
            asked(ABSENT)


def test_a_damaged_file_is_not_given_out_and_a_restore_repairs_it(server, url, tmp_path):
    blobs = Blobs(url)
    sha256 = blobs.put(b"content")
    server.overwrite(f"{url}/{sha256[:2]}/{sha256}", b"c0ntent")
    assert "damaged; restore it from the backup" in told(Blobs(url).read, sha256)
    assert "damaged" in told(blobs.fetch, sha256, tmp_path / "copy")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "whole").write_bytes(b"content")
    blobs.put_file(tmp_path / "whole", repair=True)
    assert blobs.read(sha256) == b"content"


def test_what_a_killed_writer_left_goes(server, url):
    blobs = Blobs(url)
    blobs.tidy(timedelta(days=1))
    kept = blobs.put(b"content")
    server.overwrite(f"{url}/incoming/{kept}.0123", b"cont")
    blobs.tidy(timedelta(days=1))
    assert len(s3fs.S3FileSystem(use_listings_cache=False).ls(f"{url}/incoming")) == 1
    blobs.tidy(timedelta(0))
    assert s3fs.S3FileSystem(use_listings_cache=False).find(f"{url}/incoming") == []
    assert list(blobs.names()) == [kept]


def test_a_bucket_that_is_missing_is_told_and_never_made(server, url):
    misspelt = Blobs("s3://misspelt/ambit")
    assert "there is no bucket misspelt; make the bucket, or correct store_url" in told(misspelt.check)
    assert "make the bucket" in told(misspelt.put, b"content")
    assert "misspelt" not in s3fs.S3FileSystem().ls("")


def test_the_endpoint_may_be_in_the_url(server, tmp_path):
    url = server.bucket("in-the-url")
    blobs = Blobs(f"{url}?endpoint_url={server.url}&region=eu-central-1")
    assert blobs.read(blobs.put(b"content")) == b"content"
    assert "no option 'key'; there are endpoint_url, profile, region" in told(Blobs, f"{url}?key=AKIA")


@pytest.mark.parametrize("missing", [True, False])
def test_wrong_credentials_are_told_with_what_to_set(server, url, monkeypatch, missing):
    if missing:
        monkeypatch.delenv("AWS_ACCESS_KEY_ID")
        monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    blobs = Blobs(url)
    remedy = "set AWS_ACCESS_KEY_ID" if missing else "check the credentials"
    with server.guarded():
        for asked in (
            blobs.check,
            lambda: blobs.read(ABSENT),
            lambda: blobs.put(b"content"),
            lambda: blobs.has(ABSENT),
        ):
            assert remedy in told(asked)


def test_a_server_that_is_away_is_told(endpoint, monkeypatch, tmp_path):
    gone = Server()
    monkeypatch.setenv("AWS_ENDPOINT_URL", gone.url)
    url = gone.bucket("away")
    blobs = Blobs(url)
    sha256 = blobs.put(b"content")
    with _api(Settings(home=tmp_path, port=0, store_url=url, requests_per_s=10_000)) as api:
        rig = api.post("/rigs", json={"datasheet": reference_sheet()}).json()["id"]
        gone.end()
        for asked in (
            blobs.check,
            lambda: blobs.read(sha256),
            lambda: blobs.put(b"more"),
            lambda: blobs.has(sha256),
            lambda: blobs.size(sha256),
            lambda: list(blobs.names()),
            lambda: list(blobs.chunks(sha256)),
        ):
            assert "see that the server runs, and check store_url and AWS_ENDPOINT_URL" in told(asked)
        answer = _uploaded(api, rig, tmp_path)
        assert answer.status_code == 503
        assert "see that the server runs" in answer.json()["detail"]
        ready = api.get("/../../readyz")
        assert ready.status_code == 503
        assert ready.json()["store"] == "does not answer"


def test_the_service_keeps_its_files_there_and_comes_back_from_a_backup(server, url, tmp_path):
    settings = Settings(home=tmp_path / "home", port=0, store_url=url, requests_per_s=10_000)
    with _api(settings) as api:
        rig = api.post("/rigs", json={"datasheet": reference_sheet(), "name": "on s3"}).json()["id"]
        experiment = _uploaded(api, rig, tmp_path).json()["id"]
        content = api.get(f"/experiments/{experiment}/file").content
    assert hashlib.sha256(content).hexdigest() in set(Blobs(url).names())
    assert not (settings.home / "store").exists()

    path, written = create(settings, tmp_path / "backups")
    assert (written.blobs, written.missing) == (1, ())
    elsewhere = Settings(home=tmp_path / "new", port=0, store_url=server.bucket("elsewhere"), requests_per_s=10_000)
    restore(elsewhere, path)
    assert set(Blobs(elsewhere.store_url).names()) == set(Blobs(url).names())
    with _api(elsewhere) as api:
        assert api.get(f"/experiments/{experiment}/file").content == content


@contextmanager
def _api(settings):
    with serving(settings) as service, httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as api:
        yield api


def _uploaded(api, rig, folder):
    return api.post(
        f"/rigs/{rig}/experiments",
        content=good(folder / "experiment.h5").read_bytes(),
        params={"filename": "experiment.h5"},
        headers={"content-type": "application/x-hdf5"},
    )
