"""Whatever is missing or of another type in a document that a command reads, it says so in one line and names the file.

Each document is damaged in every field that is read, one at a time: without it, and with values of other types.
"""

import copy
import json
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.backup import manifest
from service.checkup import read_baseline, read_history
from service.cli import export, gap
from service.exports import linear, responses
from service.exports.files import write_linear, write_responses
from service.health.compare import s_freedom
from service.health.monitored import plane_figures
from service.health.trend import trend
from service.identification.fit import identify
from service.identification.result.saved import saved_planes, saved_rotor
from service.identification.result.shape import ResultModel, ResultSpaces
from service.output import whole
from sim.errors import AmbError
from sim.reference import reference_datasheet
from sim.rig_file import to_toml
from sim.withheld.case import draw
from sim.withheld.seal import seal
from tests.support.command import refusal
from tests.support.commissioned import LAW
from tests.support.measured import small_experiment
from tests.support.two_axes import one_plane

OTHERS: tuple[Any, ...] = (None, True, -3, "x", [], {})
GAP = {
    "format": "amb-gap-report",
    "version": 1,
    "rig": reference_datasheet().name,
    "of": {"datasheet_sha256": "0", "controller": "rig"},
    "verdict": {
        "kind": "effect",
        "effects": ["loop_delay"],
        "outdated": [],
        "indistinguishable": [["loop_delay", "sensor_lag"]],
        "probability": 0.9,
    },
    "candidates": [
        {
            "effect": "loop_delay",
            "effects": ["loop_delay"],
            "parameters": {"delay_s": {"value": 3e-5, "std": 1e-6, "at_bound": "high"}},
        }
    ],
    "datasheet_off": ["mass"],
}
FIGURE = {"baseline": {"value": 180.0, "std": 0.1}, "now": {"value": 181.0, "std": 0.2}}
CHECK = {
    "checked_at": "2026-01-01T00:00:00Z",
    "parameters": {"x.kiA": FIGURE | {"change_percent": 0.5, "drifted": False}},
    "false_alarms_per_year": 0.2,
    "speed_rad_s": 0.0,
}


def places(document: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place of every field; of a list's elements, and of many fields alike, the first."""
    keys = list(document) if isinstance(document, dict) else list(range(len(document)))
    for key in keys[: len(keys) if isinstance(document, dict) and len(keys) < 16 else 1]:
        yield (*at, key)
        if isinstance(document[key], dict | list):
            yield from places(document[key], (*at, key))


def damages(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for place in places(document):
        found = document
        for key in place:
            found = found[key]
        for value in (..., *(v for v in OTHERS if type(v) is not type(found))):
            damaged = copy.deepcopy(document)
            holder: Any = damaged
            for key in place[:-1]:
                holder = holder[key]
            if value is ...:
                del holder[place[-1]]
            else:
                holder[place[-1]] = value
            yield f"{'.'.join(map(str, place))}: {value}", damaged


def told(path: Path, document: dict[str, Any], command: Callable[[], object]) -> int:
    """How many damages to a document's file a command refused; `service.cli.run` makes one line of an AmbError.

    Any other error is a traceback, and fails the test.
    """
    refused = 0
    for name, damaged in damages(document):
        path.write_text(json.dumps(damaged))
        said = refusal_of(command, name)
        refused += said is not None
        assert said is None or path.name in said or said.startswith(("the ", "effect ")), (name, said)
    return refused


def refusal_of(command: Callable[[], object], name: str) -> str | None:
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            command()
    except AmbError as error:
        return str(error)
    except Exception as error:
        raise AssertionError(f"{name}: {type(error).__name__} {error}") from error
    return None


@cache
def result() -> tuple[dict[str, Any], str]:
    experiment, datasheet = one_plane(*small_experiment())
    return identify(experiment, datasheet).document(), to_toml(datasheet)


def test_of_a_result_that_is_exported(tmp_path):
    path, out = tmp_path / "result.json", tmp_path / "plant.json"
    good = whole(result()[0], ResultSpaces, "it")
    assert told(path, good, lambda: export.model(path, out, part=export.Part.whole)) > 100
    del good["rig"]
    path.write_text(json.dumps(good))
    line = refusal("export", "model", path, out)
    assert line == f'ambit: {path} is damaged, it has no "rig"; give it as ambit wrote it'


def test_of_a_baseline(tmp_path):
    """What is accepted goes into a model all the same; a check of each would take too long here."""
    path, sheet = tmp_path / "result.json", one_plane(*small_experiment())[1]
    (tmp_path / "rig.toml").write_text(result()[1])

    def read() -> None:
        document = read_baseline(tmp_path)[0].document
        for plane, saved in saved_planes(document, sheet).items():
            assert s_freedom(document, plane) >= 30
            plane_figures(saved, LAW).of(saved.model)
        saved_rotor(document, sheet)

    good = whole(result()[0], ResultModel, "it")
    assert told(path, good, read) > 150
    good["planes"]["x"]["mode_evidence"][0].pop("data")
    path.write_text(json.dumps(good))
    for command in (
        ("health", "plan", "--baseline", tmp_path),
        ("health", "compare", tmp_path / "no.h5", "--baseline", tmp_path, "--out", tmp_path / "out"),
        ("check-controller", tmp_path / "rig.toml", "--baseline", tmp_path),
    ):
        assert f'{path} is damaged, it has no "planes.x.mode_evidence.0.data"' in refusal(*command)


@pytest.mark.parametrize("kind", ["effect", "no_gap"])
def test_of_a_gap_report_that_is_applied(tmp_path, kind):
    path, sheet = tmp_path / "gap.json", tmp_path / "rig.toml"
    sheet.write_text(to_toml(reference_datasheet()))
    good = GAP if kind == "effect" else GAP | {"verdict": {"kind": "no_gap", "effects": []}, "candidates": []}
    assert told(path, good, lambda: gap.apply(path, sheet, tmp_path / "twin.toml")) > 20


def test_of_a_gap_report_that_is_scored(tmp_path):
    path, sealed = tmp_path / "gap.json", tmp_path / "sealed.json"
    kept = seal(draw(0, 0).truth())
    sealed.write_text(json.dumps(kept.document()))
    good = GAP | {"rig": "withheld", "of": {}}
    assert told(path, good, lambda: gap.open_sealed(sealed, kept.commitment, path)) > 30
    path.write_text(json.dumps(good))
    assert told(sealed, kept.document(), lambda: gap.open_sealed(sealed, kept.commitment, path)) > 20


def test_of_a_history(tmp_path):
    path, whole_line = tmp_path / "history.jsonl", json.dumps(CHECK)
    refused = 0
    for name, damaged in damages(CHECK):
        path.write_text(f"{whole_line}\n{json.dumps(damaged)}\n{whole_line}\n")
        said = refusal_of(lambda: trend(read_history(path)), name)
        refused += said is not None
        assert said is None or f"line 2 of {path}" in said, name
    assert refused > 50


def exported_model(folder: Path) -> Path:
    return write_linear(folder / "m.json", linear.of_result(result()[0], "x"))


def exported_responses(folder: Path) -> Path:
    found = responses.of_experiment(one_plane(*small_experiment())[0], "u->y", "")["x"]
    few = np.arange(3)
    kept = {k: v[few] for k, v in vars(found).items() if isinstance(v, np.ndarray)}
    return write_responses(folder / "r.json", [responses.Responses(**vars(found) | kept)])[0]


@pytest.mark.parametrize("write", [exported_model, exported_responses])
def test_of_an_export_that_is_read_back(tmp_path, write: Callable[[Path], Path]):
    path = write(tmp_path)
    assert told(path, json.loads(path.read_text()), lambda: export.show(path)) > 50


def test_of_the_list_of_a_backup(tmp_path):
    good = manifest.Manifest("2026-01-01T00:00:00Z", "1", "1", "sqlite", "sqlite", "0001", {"rigs": 1}, {}, 0, 0, ())
    manifest.write(tmp_path, good)
    path = tmp_path / manifest.NAME
    assert manifest.read(tmp_path) == good
    for _, damaged in damages(json.loads(path.read_text())):
        path.write_text(json.dumps(damaged))
        with suppress(AmbError):
            manifest.read(tmp_path)
