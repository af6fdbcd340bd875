"""What is no request, or cannot be done, is refused at once as a problem."""

import errno
import os
import sqlite3

import h5py
import pytest
from sqlalchemy.exc import OperationalError

from service.api.resources import experiments
from service.experiment import file
from service.identification.fit import identify
from service.storage import rigs
from sim.errors import AmbError
from sim.rig_file import parse
from tests.support.api import assert_problem
from tests.support.service import reference_sheet
from tests.support.uploads import good

SHEET = reference_sheet()


@pytest.mark.parametrize(
    ("body", "status", "word"),
    [
        ({"kind": "identification"}, 422, "give the field experiment"),
        ({"kind": "experiment", "experiment": "exp_1"}, 422, "leave the field experiment out"),
        ({"kind": "experiment", "options": {"profile": {"points": 0}}}, 422, "points"),
        ({"kind": "experiment", "options": {"speed": 1}}, 422, "speed"),
        ({"kind": "experiment", "options": {"excitation": "chirp"}}, 422, "options.excitation"),
        ({"kind": "experiment", "options": {"excitation": "multisine", "profile": {"points": 9}}}, 422, "points"),
        ({"kind": "experiment", "options": {"profile": {"realisations": 4}}}, 422, "realisations"),
        ({"kind": "gap", "experiment": "exp_1"}, 404, "exp_1"),
        ({"kind": "magic"}, 422, "kind"),
        ({"kind": "experiment", "priority": 0}, 422, "priority"),
    ],
)
def test_a_job_that_cannot_be_done_is_refused_at_once(api, rig, body, status, word):
    assert_problem(api.post("/jobs", json={"rig": rig, **body}), status, word)


@pytest.mark.parametrize(
    ("url", "word"),
    [
        ("ftp://host", "begins with one of"),
        ("replay:///etc/passwd", "begins with one of"),
        ("modbus://host:1?transcript=/tmp/x", "transcript"),
        ("modbuss://host:1?ca=/etc/ssl/key.pem", "controllers"),
        ("simulated://?rig=/etc/passwd", "controllers"),
        ("modbus+rtu:///etc/passwd", "/dev"),
        ("modbus+rtu:///dev/../etc/passwd", "/dev"),
    ],
)
def test_a_controllers_url_reaches_no_file_of_the_service(api, url, word):
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "controller_url": url, "name": "x"}), 422, word)


@pytest.mark.parametrize(
    ("url", "word"),
    [
        ("modbus://", "names no host"),
        ("modbus://host?units=1", "unknown option 'units'"),
        ("modbus+rtu:///dev/ttyUSB0?baud=0", "baud is 300 to 4000000"),
        ("canopen://socketcan/can0?node=128", "node is 1 to 127"),
        ("canopen://socketcan/can0?node=5&bitrate=0", "bitrate is 10000 to 1000000"),
        ("canopen://can0?node=5", "cannot read the CAN bus"),
        ("modbus://pump..plant:502?unit=1", "a part of the host 'pump..plant' is empty"),
        ("modbus://host:0", "has the port 0"),
    ],
)
def test_a_controllers_url_that_no_bus_can_have_is_refused_when_it_is_given(api, url, word):
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "controller_url": url, "name": "x"}), 422, word)


def test_a_disk_that_is_full_is_no_defect_of_the_service(api, rig, monkeypatch):
    async def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(experiments, "_received", full)
    answer = api.post(f"/rigs/{rig}/experiments", content=b"x", headers={"content-type": "application/x-hdf5"})
    assert_problem(answer, 503, "No space left on device; free space")
    assert int(answer.headers["retry-after"]) >= 1


def test_a_database_whose_disk_is_full_says_so(api, monkeypatch):
    full = OperationalError("INSERT", {}, sqlite3.OperationalError("database or disk is full"))
    monkeypatch.setattr(rigs, "create", lambda *_: (_ for _ in ()).throw(full))
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "name": "full"}), 503, "disk is full; free space")


@pytest.mark.parametrize("depth", [20, 600, 5000, 200_000])
def test_a_body_that_is_nested_without_end_is_no_defect(api, rig, depth):
    for whole in ('{"datasheet": %s}', '{"kind": "experiment", "rig": "r", "options": {"a": %s}}'):
        body = whole % ("[" * depth + "]" * depth)
        path = "/rigs" if "datasheet" in whole else "/jobs"
        answer = api.post(path, content=body, headers={"content-type": "application/json"})
        assert answer.status_code in (400, 422), answer.text


@pytest.mark.parametrize("name", ["a\x1b]0;title\x07", "two\nlines", "dear\u202eelbatrops"])
def test_a_name_that_a_terminal_would_obey_is_refused(api, name):
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "name": name}), 422, "control character")


@pytest.mark.parametrize("name", ["a\x7f.h5", "dear\u202eelbatrops.h5", "a\x9b31m.h5"])
def test_a_file_name_that_a_terminal_would_obey_is_refused(api, rig, name, tmp_path):
    kind = {"content-type": "application/x-hdf5"}
    content = good(tmp_path / "e.h5").read_bytes()
    answer = api.post(f"/rigs/{rig}/experiments", content=content, headers=kind, params={"filename": name})
    assert_problem(answer, 422, "a terminal would obey")


def test_a_name_is_the_same_however_its_accents_are_written(api):
    made = api.post("/rigs", json={"datasheet": SHEET, "name": "caf\N{LATIN SMALL LETTER E WITH ACUTE}"}).json()
    accent = "cafe\N{COMBINING ACUTE ACCENT}"
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "name": accent}), 409, made["id"])
    seen = api.get(f"/rigs/{made['id']}")
    same = {"datasheet": SHEET, "name": accent, "note": "renamed"}
    changed = api.put(f"/rigs/{made['id']}", json=same, headers={"if-match": seen.headers["etag"]})
    assert changed.json()["name"] == made["name"]


@pytest.mark.parametrize("name", ["   ", "compressor 3 ", " pump"])
def test_a_name_that_looks_like_another_or_none_is_refused(api, name):
    assert_problem(api.post("/rigs", json={"datasheet": SHEET, "name": name}), 422, "begins or ends with a space")


def test_requests_that_are_no_requests(api):
    assert_problem(api.get("/nothing"), 404, "/openapi.json")
    assert_problem(api.patch("/jobs"), 405, "PATCH", "/openapi.json")
    assert_problem(api.post("/jobs", content=b"{", headers={"content-type": "application/json"}), 422, "JSON")
    assert_problem(api.post("/rigs", content=b"x" * 2_000_000), 413, "1,000,000")
    assert_problem(api.post("/rigs", content=iter([b"x" * 600_000] * 3)), 413, "1,000,000")
    assert_problem(api.get("/rigs/bench/status"), 404, "there is no rig 'bench'; list them at /api/v1/rigs")
    assert_problem(api.get("/jobs", params={"after": "';--"}), 422, "after")


def test_a_damaged_file_of_an_experiment_is_not_sent_as_that_experiment(api, service, rig, tmp_path):
    content = good(tmp_path / "e.h5").read_bytes()
    headers = {"content-type": "application/x-hdf5"}
    kept = api.post(f"/rigs/{rig}/experiments", content=content, headers=headers).json()
    file = service.services.settings.home / "store" / kept["file_sha256"][:2] / kept["file_sha256"]
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 2] ^= 1
    file.write_bytes(raw)
    answer = api.get(f"/experiments/{kept['id']}/file")
    assert_problem(answer, 503, "damaged; restore it from the backup")

    again = api.post(f"/rigs/{rig}/experiments", content=content, headers=headers).json()
    assert again["file_sha256"] == kept["file_sha256"]
    for one in (kept, again):  # whoever still has the file brings both back
        answer = api.get(f"/experiments/{one['id']}/file")
        assert (answer.status_code, len(answer.content)) == (200, kept["file_bytes"])


def test_an_upload_in_another_unit_is_refused_as_a_job_on_it_would_be(api, rig, tmp_path):
    path = good(tmp_path / "e.h5")
    headers = {"content-type": "application/x-hdf5"}
    assert api.post(f"/rigs/{rig}/experiments", content=path.read_bytes(), headers=headers).status_code == 201
    with h5py.File(path, "a") as opened:
        opened["sweeps/0/Y"][...] *= 1e6
    with pytest.raises(AmbError, match=r"Y reaches .* is it in µm\?") as told:
        identify(file.read(path), parse(SHEET))
    answer = api.post(f"/rigs/{rig}/experiments", content=path.read_bytes(), headers=headers)
    assert_problem(answer, 422, str(told.value))
