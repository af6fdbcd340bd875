"""The journal: every whole line survives, a torn end is cut off, another campaign is refused."""

import json
import subprocess
import sys

import numpy as np
import pytest

from service.campaign.journal import Journal, entries, line, read
from service.experiment.errors import ExperimentFileError, JournalError

HEADER = {"rig": "r", "profile": {"points": 200, "blocks": 4}}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "experiment.journal"


def entry(k):
    return {"phase": "main", "k": k, "Y": np.arange(6).reshape(2, 3) * (1 + 1j * k), "f": 0.1 + k}


def filled(path, n=3):
    journal = Journal(path, HEADER)
    for k in range(n):
        journal.append(entry(k))
    journal.close()


def assert_same(found, n):
    assert [e["k"] for e in found] == list(range(n))
    for k, e in enumerate(found):
        np.testing.assert_array_equal(e["Y"], entry(k)["Y"])
        assert e["f"] == entry(k)["f"]


def test_entries_come_back_exactly(path):
    filled(path)
    journal = Journal(path, HEADER)
    assert_same(journal.found, 3)
    journal.append(entry(3))
    journal.close()
    assert_same(read(path)[1], 4)


def test_a_file_cut_anywhere_keeps_every_whole_entry(path):
    filled(path)
    whole = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(0, len(whole) + 1, 7):
        path.write_bytes(whole[:cut])
        journal = Journal(path, HEADER)
        n = max(0, sum(e <= cut for e in ends) - 1)
        assert_same(journal.found, n)
        journal.append(entry(n))
        journal.close()
        assert_same(read(path)[1], n + 1)


def test_a_changed_byte_ends_what_is_believed(path):
    filled(path)
    content = bytearray(path.read_bytes())
    second = content.index(b"\n", content.index(b"\n") + 1) + 30
    content[second] ^= 1
    path.write_bytes(content)
    assert_same(read(path)[1], 1)


def test_nothing_after_a_damaged_line_comes_back(path):
    filled(path, 4)
    content = bytearray(path.read_bytes())
    second = content.index(b"\n", content.index(b"\n") + 1) + 30
    content[second] ^= 1
    path.write_bytes(content)
    journal = Journal(path, HEADER)
    journal.append(entry(1))  # as long as the damaged one: what followed would fit on behind it
    journal.close()
    assert_same(read(path)[1], 2)


def test_another_campaign_is_refused_and_left_alone(path):
    filled(path)
    before = path.read_bytes()
    told = r"profile\.points was 200, now it is 100; .* give what it had; .* folder, or .* ambit commission --no-resume"
    with pytest.raises(JournalError, match=told):
        Journal(path, HEADER | {"profile": {"points": 100, "blocks": 4}})
    assert path.read_bytes() == before


SHEET = """
[rotor]
mass_kg = 280.0
[sensor]
bandwidth_hz = [9e3, 9e3]
[[modes]]
frequency_hz = 90.0
[limits]
displacement_m = 8e-05
"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("mass_kg = 280.0", "mass_kg = 281.0", r"rotor\.mass_kg of the datasheet was 280\.0, now it is 281\.0; "),
        ("m = 8e-05", "m = 0.0001", r"limits\.displacement_m of the datasheet was 8e-05, now it is 0\.0001; "),
        ("frequency_hz = 90.0", "frequency_hz = 91.0", r"modes\.0\.frequency_hz of the datasheet was 90\.0, now"),
        (
            "[sensor]",
            "[sensor]\ngain = 2.0",
            r"sensor\.gain of the datasheet was not given, now it is 2\.0; ",
        ),
    ],
)
def test_a_changed_setting_is_told_by_its_key_in_the_datasheet(path, old, new, told):
    def header(sheet: str) -> dict:
        limits = {"displacement_limit_m": len(sheet), "gap_m": len(sheet)}  # what is made of it is not told
        return {"limits": limits, "datasheet_sha256": sheet, "profile": {}, "about": {"datasheet": sheet}}

    Journal(path, header(SHEET)).close()
    with pytest.raises(JournalError, match=told) as error:
        Journal(path, header(SHEET.replace(old, new)))
    assert "gap_m" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"profile": {"multisine": {"periods": 4}}}, "the excitation was stepped-sine, now it is multisine"),
        (
            {"profile": dict.fromkeys("abcde", 1)},
            r"profile\.points was 200, now it is not given; .*; and 4 more differ",
        ),
        ({"controller": "two"}, 'the controller was "one", now it is "two"'),
        ({"limits": {"max_samples": 2}}, "the controller's longest tone in samples was 1, now it is 2"),
    ],
)
def test_whatever_else_has_changed_is_told_in_words(path, changed, told):
    header = HEADER | {"controller": "one", "limits": {"max_samples": 1}, "datasheet_sha256": "x"}
    Journal(path, header).close()
    with pytest.raises(JournalError, match=told):
        Journal(path, header | changed)


def test_what_a_header_tells_about_is_not_compared(path):
    Journal(path, HEADER | {"about": {"speed": 1.0}}).close()
    Journal(path, HEADER | {"about": {"speed": 2.0}}).close()
    assert read(path)[0]["about"] == {"speed": 1.0}


def test_another_file_is_refused_and_left_alone(path):
    path.write_text("my notes\nof the day\n")
    with pytest.raises(JournalError, match="not a campaign journal"):
        Journal(path, HEADER)
    assert path.read_text() == "my notes\nof the day\n"


def test_another_version_is_refused(path):
    path.write_bytes(line({"format": "amb-campaign-journal", "version": 99}))
    with pytest.raises(JournalError, match="version"):
        read(path)


def test_a_journal_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(JournalError, match="cannot read"):
        read(tmp_path / "nothing")
    (tmp_path / "file").write_text("")
    with pytest.raises(ExperimentFileError, match="cannot write"):
        Journal(tmp_path / "file" / "journal", HEADER)


def test_a_value_that_is_not_finite_is_not_written():
    with pytest.raises(ValueError, match="JSON"):
        line({"f": float("nan")})


def test_a_line_is_plain_text():
    text = line(entry(1)).decode("ascii")
    assert json.loads(text[9:])["k"] == 1
    assert entries(text.encode())[1] == len(text)


INTERRUPTED_EVERYWHERE = """
import itertools, sys
from pathlib import Path
from service.campaign.journal import Journal, read

def interrupted(journal, at):
    # whether Ctrl-C came, at the given instruction of Python code
    passed = 0

    def trace(frame, event, argument):
        nonlocal passed
        frame.f_trace_opcodes = True
        passed += event == "opcode"
        if passed == at:
            raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        journal.append({"phase": "main"})
        journal.append({"phase": "main"})
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    return False

for at in itertools.count(1):
    path = Path(sys.argv[1], f"{at}.journal")
    journal = Journal(path, {"rig": "r"})
    came = interrupted(journal, at)
    journal.close()
    assert read(path)[1] in ([{"phase": "main"}] * n for n in range(3)), path.read_bytes()
    path.unlink()
    if not came:
        break
print(at)
"""


def test_an_interruption_at_any_instant_leaves_a_journal_that_closes_and_reads(tmp_path):
    command = [sys.executable, "-c", INTERRUPTED_EVERYWHERE, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


def test_settings_that_differ_by_their_last_digits_are_the_same_campaign(path):
    """As those of a plan that another processor calculated; the journal keeps what it began with."""
    began = {"profile": {"settle_s": [0.1, 0.25], "points": 2, "accuracy": 1e-3}}
    Journal(path, HEADER | began).close()
    other = {"profile": {"settle_s": [0.1 * (1 + 1e-12), 0.25], "points": 2, "accuracy": 1e-3 * (1 - 1e-12)}}
    journal = Journal(path, HEADER | other)
    journal.close()
    assert journal.header["profile"] == began["profile"]
    for changed in ({"settle_s": [0.1, 0.26]}, {"settle_s": [0.1]}, {"points": 3}, {"accuracy": 1.01e-3}):
        with pytest.raises(JournalError, match="profile"):
            Journal(path, HEADER | {"profile": began["profile"] | changed})
