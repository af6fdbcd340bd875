"""A transcript that was damaged is told with file, line and what to do, when it is opened and not on the way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.errors import ControllerError
from drivers.transcript_lines import checked_lines
from drivers.url import connect
from sim.reference import reference_rig

HEAD = {"format": "amb-transcript", "version": 1, "controller": "modbus://rig:502?unit=1"}


def _told(group: str) -> dict[str, Any]:
    """What a device tells of a group."""
    device = RigDevice(reference_rig(), seed=1)
    front = DeviceFront(device, "big")
    try:
        return front.read(group)
    finally:
        front.close()
        device.close()


IDENTITY = {"read": "identity", "order": "big", "answer": _told("identity")}
STATUS = {"read": "status", "order": "big", "answer": _told("status")}
WHOLE: list[Any] = [
    IDENTITY,
    STATUS,
    {"read": "status", "order": "big", "bus_error": "no answer"},
    {"write": "lease", "values": {"token": 7, "seconds": 5.0, "holder": "job"}, "order": "big", "answer": None},
    {
        "write": "stop",
        "values": {"token": 7},
        "order": "little",
        "refused": "LEASE",
        "message": "Modbus exception 6",
    },
    {"done": 3},
    {"lockin": 4, "order": "big", "answer": {"base64": "AAAAAA=="}},
    {"raw": 4, "result": 1, "order": "big", "answer": {"base64": "AAAAAA=="}},
]


def _file(folder: Path, lines: list[Any]) -> Path:
    path = folder / "session.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def _without(line: dict[str, Any], name: str) -> dict[str, Any]:
    return {k: v for k, v in line.items() if k != name}


def _answering(line: dict[str, Any], **values: Any) -> dict[str, Any]:
    return line | {"answer": line["answer"] | values}


def test_whatever_a_session_records_is_read(tmp_path: Path) -> None:
    assert len(checked_lines(_file(tmp_path, [HEAD, *WHOLE]))) == len(WHOLE)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ([1], "it is no object"),
        (3, "it is no object"),
        ({}, "none of read, write, lockin, raw or done"),
        ({"done": "soon"}, "done is 'soon' and no number"),
        (_without(IDENTITY, "order"), "its order is neither big nor little"),
        (_without(IDENTITY, "answer"), "it has no answer"),
        (IDENTITY | {"answer": None}, "it has no values of identity"),
        (IDENTITY | {"answer": {}}, "identity.axis_count is missing"),
        (IDENTITY | {"answer": _without(IDENTITY["answer"], "axes")}, "identity.axes is missing"),
        (_answering(IDENTITY, sample_rate_hz="fast"), "identity.sample_rate_hz cannot be 'fast'"),
        (_answering(IDENTITY, sample_rate_hz=[1e4]), "identity.sample_rate_hz cannot be"),
        (_answering(IDENTITY, axes=4), "identity.axes cannot be 4"),
        (_answering(IDENTITY, max_samples=1999), "the CRC of identity does not fit"),
        (_answering(STATUS, state=9), "status.state cannot be 9"),
        (_answering(STATUS, state=None), "status.state cannot be None"),
        (_answering(STATUS, displacement_m=[0.0]), "status.displacement_m cannot be"),
        (_answering(STATUS, speed_rad_s=1e300), "status.speed_rad_s cannot be 1e"),
        (IDENTITY | {"read": "lease"}, "'lease' is nothing that one can read"),
        (IDENTITY | {"read": ["status"]}, "is nothing that one can read"),
        (WHOLE[3] | {"values": None}, "it has no values of lease"),
        (WHOLE[3] | {"values": {"token": 7}}, "lease.seconds is missing"),
        (WHOLE[2] | {"bus_error": None}, "its bus_error is no text"),
        (WHOLE[4] | {"refused": "WHY"}, "'WHY' is no refusal"),
        (WHOLE[4] | {"refused": ["LEASE"]}, "is no refusal"),
        (_without(WHOLE[4], "message"), "'LEASE' is no refusal"),
        (WHOLE[6] | {"lockin": "all"}, "lockin is 'all' and no number of bytes"),
        (WHOLE[6] | {"answer": None}, "its answer is no base64"),
        (WHOLE[7] | {"answer": {"base64": "AA"}}, "its answer is no base64"),
        (WHOLE[7] | {"answer": {"base64": 3}}, "its answer is no base64"),
    ],
)
def test_a_damaged_line_is_told_with_its_number(line: Any, said: str, tmp_path: Path) -> None:
    path = _file(tmp_path, [HEAD, IDENTITY, line])
    with pytest.raises(ControllerError) as told:
        connect(f"replay://{path}")
    assert str(told.value).startswith(f"{path}, line 3: ")
    assert said in str(told.value)
    assert "record the session anew with transcript=" in str(told.value)


def test_a_line_that_was_cut_short_is_told_with_its_number(tmp_path: Path) -> None:
    path = _file(tmp_path, [HEAD, IDENTITY])
    path.write_text(path.read_text()[:-20])
    with pytest.raises(ControllerError, match=r"session\.jsonl, line 2: it is no JSON; .* take a whole copy"):
        connect(f"replay://{path}")


@pytest.mark.parametrize("first", ["[1]", "3", "null", "{}", '{"format": "amb-transcript", "version": 2}'])
def test_what_begins_otherwise_is_no_transcript(first: str, tmp_path: Path) -> None:
    path = tmp_path / "session.jsonl"
    path.write_text(first)
    with pytest.raises(ControllerError, match=r"session\.jsonl is not a transcript of version 1; give a file"):
        connect(f"replay://{path}")
