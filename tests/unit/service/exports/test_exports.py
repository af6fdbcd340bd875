"""Exports as other programs read them: scipy, pyuff, python-control, csv; and files that are no exports."""

import csv
import json
from dataclasses import replace

import control
import numpy as np
import pytest
import pyuff
from scipy.io import loadmat, savemat

from service.cli import run
from service.errors import DocumentError
from service.experiment.file import write as write_experiment
from service.exports import files, linear, responses
from service.exports.control import control_of, from_control, to_control
from service.exports.errors import ExportError
from service.exports.matlab import linear_variables
from service.identification.result.saved import saved_planes
from service.output import json_text, write_text
from sim.errors import AmbError
from sim.reference import reference_rig
from tests.support.commissioned import AXES, LAW, SHEET, result
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

ONE = np.ones(1)


@pytest.fixture(scope="module")
def plant():
    return linear.of_result(result(), "x")


@pytest.fixture(scope="module")
def experiment():
    models = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    f = np.concatenate([np.geomspace(10.0, 480.0, 12), [492.1234567, 492.1334567, 900.0]])
    return synthetic_experiment(synthetic_sweep(models, AXES, LAW, f, 0.05, seed=1), axes=AXES, rig="reference")


def test_the_same_content_is_the_same_file_whenever_it_is_written(plant, experiment, tmp_path, monkeypatch):
    """Its digest is the ETag by which a program asks whether there is anything new."""
    written = []
    for at in ("Mon Nov 30 10:00:00 2026", "Mon Nov 30 10:00:01 2026"):
        monkeypatch.setattr("time.asctime", lambda *_, at=at: at)
        (measured,) = files.write_responses(tmp_path / "r.mat", [responses.of_experiment(experiment, plane="x")["x"]])
        model = files.write_linear(tmp_path / "m.mat", plant)
        written.append((measured.read_bytes(), model.read_bytes()))
    assert written[0] == written[1]
    assert written[0][0].startswith(b"MATLAB 5.0 MAT-file")


def test_python_control_has_the_response_of_the_identified_plant(plant):
    system = to_control(plant)
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == ["i_xA", "i_xB"]
    assert system.output_labels == ["y_xA", "y_xB"]
    omega = 2 * np.pi * np.array([11.0, 130.0, 492.0, 800.0])
    theirs = np.moveaxis(system(1j * omega), -1, 0)
    ours = saved_planes(result(), SHEET)["x"].model.plant_response(omega)
    np.testing.assert_allclose(theirs, ours, rtol=1e-8)
    assert np.sum(system.poles().real > 0) == 2  # both rigid modes fall to the magnets


@pytest.mark.parametrize("default", [None, True, 1e-3])
def test_the_system_is_in_continuous_time_whatever_a_user_has_set(plant, default):
    try:
        control.set_defaults("control", default_dt=default)
        assert to_control(plant).dt == 0
    finally:
        control.reset_defaults()


@pytest.mark.parametrize("ending", [".json", ".mat"])
def test_a_model_that_somebody_put_into_discrete_time_is_not_taken_for_a_continuous_one(plant, tmp_path, ending):
    path = tmp_path / f"model{ending}"
    if ending == ".json":
        write_text(path, json_text(linear.document(plant) | {"sample_time_s": 1e-4}))
    else:
        savemat(path, linear_variables(plant) | {"sample_time_s": 1e-4})
    with pytest.raises(ExportError, match=r"discrete time \(0\.0001 s\)"):
        files.read_linear(path)


def test_whole_is_amplifiers_and_plant_in_series(plant):
    whole = to_control(linear.of_result(result(), "x", "whole"))
    amplifiers = to_control(linear.of_result(result(), "x", "amplifiers"))
    s = 2j * np.pi * 300.0
    np.testing.assert_allclose(whole(s), to_control(plant)(s) @ amplifiers(s), rtol=1e-9)
    assert whole.params["units"] == {"inputs": ["A", "A"], "outputs": ["m", "m"]}


@pytest.fixture(scope="module")
def result_json(tmp_path_factory):
    return write_text(tmp_path_factory.mktemp("rig1") / "result.json", json_text(result()))


def test_a_result_file_is_one_call_from_python_control(result_json):
    """What an engineer does next: close the loop around the identified plant, and look at its poles."""
    plant = control_of(str(result_json), "y")
    assert (plant.input_labels, plant.output_labels) == (["i_yA", "i_yB"], ["y_yA", "y_yB"])
    s = 2j * np.pi * 120.0
    np.testing.assert_allclose(plant(s), saved_planes(result(), SHEET)["y"].model.plant_response(s.imag * ONE)[0])
    spring = control.ss([], [], [], 3e4 * np.eye(2), inputs=["y_yA", "y_yB"], outputs=["i_yA", "i_yB"])
    stiffer = control.feedback(plant, spring)
    assert np.sum(plant.poles().real > 1) == 2
    assert np.sum(stiffer.poles().real > 1) == 0  # a stiff current law lifts both rigid modes
    np.testing.assert_allclose(
        control_of(result_json, "x", "whole")(s),
        control_of(result_json, "x")(s) @ control_of(result_json, "x", "amplifiers")(s),
        rtol=1e-9,
    )


def test_a_plane_or_a_file_that_is_not_there_is_named(result_json, tmp_path):
    with pytest.raises(ExportError, match="no plane 'z'; it has x, y"):
        control_of(result_json, "z")
    with pytest.raises(DocumentError, match=r"nowhere\.json"):
        control_of(tmp_path / "nowhere.json", "x")
    with pytest.raises(DocumentError, match="amb-commissioning-result"):
        control_of(write_text(tmp_path / "other.json", '{"format": "amb-gap-report", "version": 1}'), "x")


def test_a_model_whose_figures_say_nothing_is_not_exported(tmp_path):
    nothing = write_text(tmp_path / "nothing.json", json_text(result() | {"identified": False}))
    with pytest.raises(ExportError, match="'reference' is not identified"):
        control_of(nothing, "x")
    with pytest.raises(AmbError, match="'reference' is not identified"):  # nor checked with, nor a controller on it
        saved_planes(json.loads(nothing.read_text()), SHEET)


def test_scipy_reads_the_matlab_file(plant, tmp_path):
    found = loadmat(files.write_linear(tmp_path / "x.mat", plant))
    np.testing.assert_array_equal(found["A"], plant.A)
    np.testing.assert_array_equal(found["D"], np.zeros((2, 2)))
    assert [str(c[0][0]) for c in found["inputs"]] == ["i_xA", "i_xB"]
    assert [str(c[0][0]) for c in found["output_units"]] == ["m", "m"]
    assert found["sample_time_s"].item() == 0.0


def test_a_spreadsheet_reads_the_table(plant, tmp_path):
    with files.write_linear(tmp_path / "x.csv", plant).open(newline="") as file:
        lines = list(csv.DictReader(file.readlines()[2:]))
    b = [line for line in lines if line["matrix"] == "B"]
    assert len(b) == plant.B.size
    assert float(b[1]["value"]) == plant.B[0, 1]
    assert (b[1]["column_name"], b[1]["column_unit"]) == ("i_xB", "A")


def test_pyuff_reads_dataset_58_with_nodes_units_and_every_digit_of_frequency(experiment, tmp_path):
    found = responses.of_experiment(experiment)
    (path,) = files.write_responses(tmp_path / "frf.uff", list(found.values()))
    file = pyuff.UFF(str(path))
    assert list(file.get_set_types()) == [164] + [58] * 16  # two planes, 2 x 2 entries, each with its deviation
    sets = [file.read_sets(k) for k in range(1, 17)]
    frfs = [d for d in sets if d["func_type"] == 4]
    second = frfs[1]  # yA per uB of plane x
    np.testing.assert_array_equal(second["x"], found["x"].frequency_hz)
    np.testing.assert_array_equal(second["data"], found["x"].value[:, 0, 1])
    assert (second["rsp_node"], second["rsp_dir"], second["ref_node"], second["ref_dir"]) == (1, 1, 2, 1)
    assert second["ordinate_axis_units_lab"].strip() == "m"
    assert second["orddenom_axis_units_lab"].strip() == "A"
    assert {d["rsp_dir"] for d in frfs} == {1, 2}


def test_a_universal_file_says_first_that_it_is_in_si(experiment, tmp_path):
    """Dataset 164, in the columns of its format: a tool whose model is in millimetres knows by what to multiply."""
    found = responses.of_experiment(experiment)
    (path,) = files.write_responses(tmp_path / "frf.uff", list(found.values()))
    units = pyuff.UFF(str(path)).read_sets(0)
    assert (units["type"], units["units_code"], units["temp_mode"]) == (164, 1, 2)
    assert [units[k] for k in ("length", "force", "temp", "temp_offset")] == [1.0, 1.0, 1.0, 273.15]
    head = path.read_bytes().split(b"\n    -1\n")[0].decode("ascii").splitlines()
    assert head[:3] == ["    -1", "   164", "         1SI: Meter (newton)           2"]
    factors = [float(head[3][k : k + 25].replace("D", "E")) for k in (0, 25, 50)]
    assert (factors, len(head[3]), len(head[4])) == ([1.0, 1.0, 1.0], 75, 25)


def test_headers_of_a_universal_file_say_how_many_bytes_follow(experiment, tmp_path):
    found = responses.of_experiment(experiment)
    (path,) = files.write_responses(tmp_path / "frf.uff", list(found.values()))
    content = path.read_bytes()
    head = content.index(b"    58b")
    size = int(content[head + 31 : head + 43])
    start = head
    for _ in range(12):  # the header has eleven lines beside its own
        start = content.index(b"\n", start) + 1
    assert content[start + size :].lstrip(b"\r\n").startswith(b"    -1")
    assert size == 24 * len(found["x"].frequency_hz)


def test_measured_responses_have_matlabs_order_of_dimensions(experiment, tmp_path):
    r = responses.of_experiment(experiment, "r->u")["y"]
    (path,) = files.write_responses(tmp_path / "s.mat", [r])
    found = loadmat(path)
    assert found["response"].shape == (2, 2, len(r.frequency_hz))
    np.testing.assert_array_equal(found["response"][1, 0], r.value[:, 1, 0])
    assert r.inputs == ("r_yA", "r_yB")


def test_a_plane_is_exported_whatever_the_other_lacks(experiment, tmp_path, capsys):
    """One axis of y alone is excited: there is no response of that plane, and nothing amiss with x."""
    (whole,) = experiment.sweeps
    lacking = replace(experiment, sweeps=(whole.select(whole.axis != 3),))
    path, out = tmp_path / "e.h5", tmp_path / "frf.json"
    write_experiment(path, lacking)
    assert run(["export", "responses", str(path), str(out), "--plane", "x"]) == 0
    (back,) = files.read_responses(out)
    np.testing.assert_array_equal(back.value, responses.of_experiment(experiment)["x"].value)
    capsys.readouterr()
    assert run(["export", "responses", str(path), str(out), "--plane", "y"]) == 1
    assert "plane y: u->y needs every one of yA, yB" in capsys.readouterr().err
    with pytest.raises(ExportError, match="excites no plane 'y'; it excites x"):
        responses.of_experiment(replace(experiment, sweeps=(whole.select(whole.axis < 2),)), plane="y")


def test_several_planes_in_a_format_of_one_are_several_files(experiment, tmp_path):
    written = files.write_responses(tmp_path / "frf.json", list(responses.of_experiment(experiment).values()))
    assert [p.name for p in written] == ["frf-1.json", "frf-2.json"]
    assert json.loads(written[1].read_text())["outputs"] == ["y_yA", "y_yB"]


@pytest.mark.parametrize("rig", ["compressor " * 9, "two\nlines", "Verdichter Süd"])
def test_planes_of_a_rig_of_any_name_are_told_apart_in_a_universal_file(experiment, tmp_path, rig):
    found = responses.of_experiment(replace(experiment, rig=rig))
    (path,) = files.write_responses(tmp_path / "frf.uff", list(found.values()))
    back = files.read_responses(path)
    assert len(back) == 2
    for ours, theirs in zip(found.values(), back, strict=True):
        assert theirs.outputs == ours.outputs
        np.testing.assert_array_equal(theirs.value, ours.value)
        assert theirs.name.endswith(ours.name[-7:])


@pytest.mark.parametrize("name", ["x.mat", "x.csv", "x.json", "x.uff", "x.txt"])
def test_what_is_no_export_is_refused_in_one_line(name, tmp_path):
    path = tmp_path / name
    for content in (b"", b"no export\n", b"name,x\r\ncomment,y\r\nmatrix\r\n", b'{"format": "x"}', b"[1]"):
        path.write_bytes(content)
        with pytest.raises(ExportError) as error:
            files.read_responses(path)
        assert "\n" not in str(error.value)
        if path.suffix != ".uff":
            with pytest.raises(ExportError):
                files.read_linear(path)
    path.unlink()
    with pytest.raises(ExportError):
        files.read_responses(path)


def test_files_that_lack_a_part_are_refused(plant, tmp_path):
    text = files.write_linear(tmp_path / "x.csv", plant).read_text().splitlines(keepends=True)
    (tmp_path / "x.csv").write_text("".join(text[:-1]))
    with pytest.raises(ExportError, match="lacks entries of D"):
        files.read_linear(tmp_path / "x.csv")
    document = linear.document(plant)
    document["A"][0][0] = float("nan")
    with pytest.raises(ExportError, match="not finite"):
        linear.from_document(document)
    del document["B"]
    with pytest.raises(ExportError, match="not whole"):
        linear.from_document(document)


def test_what_cannot_be_exported_is_refused(plant, experiment, tmp_path):
    with pytest.raises(ExportError, match="no plane 'z'"):
        linear.of_result(result(), "z")
    with pytest.raises(ExportError, match="no sweep 'other'"):
        responses.of_experiment(experiment, sweep="other")
    with pytest.raises(ExportError, match="ending"):
        files.write_linear(tmp_path / "x.xls", plant)
    with pytest.raises(ExportError, match="discrete"):
        from_control(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1e-4))
    with pytest.raises(ExportError, match="r->i"):
        responses.of_experiment(experiment, "r->i")


def test_a_system_made_elsewhere_comes_in_without_units():
    found = from_control(control.ss([[-2.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert found.input_units == ("1",)
    assert found.A.tolist() == [[-2.0]]
