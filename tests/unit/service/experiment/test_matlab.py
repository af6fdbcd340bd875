"""The same arrays in MATLAB files, v5 as scipy writes them and v7.3 as MATLAB lays them out in HDF5."""

import h5py
import numpy as np
import pytest
import scipy.io

from service.experiment.errors import ExperimentFileError
from service.experiment.file import read

TOP = {"format": "amb-experiment", "version": 1, "rig": "r", "axes": '["xA", "xB", "yA", "yB"]'}
OWN = {"kind": "stepped-sine", "sample_rate_hz": 10_000.0, "speed_rad_s": 5.0, "comment": "main"}


@pytest.fixture
def fields(demodulated):
    return OWN | demodulated


def assert_same(sweep, demodulated):
    for name in ("frequency_hz", "axis", "amplitude_a", "U", "I", "Y"):
        np.testing.assert_allclose(getattr(sweep, name), demodulated[name], err_msg=name)
    assert (sweep.kind, sweep.speed_rad_s, sweep.comment) == ("stepped-sine", 5.0, "main")


def struct_array(*sweeps):
    array = np.empty(len(sweeps), dtype=object)
    array[:] = sweeps
    return np.array([tuple(s.values()) for s in sweeps], dtype=[(k, object) for k in sweeps[0]])


@pytest.mark.parametrize("form", ["struct of structs", "struct array", "cell", "one sweep", "one struct"])
def test_version_5(tmp_path, fields, demodulated, form):
    other = fields | {"comment": "validation"}
    cell = np.empty(2, dtype=object)
    cell[:] = [fields, other]
    content = {
        "struct of structs": {"sweeps": {"s0": fields, "s1": other}},
        "struct array": {"sweeps": struct_array(fields, other)},
        "cell": {"sweeps": cell},
        "one sweep": fields,
        "one struct": {"sweeps": fields},
    }[form]
    scipy.io.savemat(tmp_path / "e.mat", TOP | content)
    experiment = read(tmp_path / "e.mat")
    assert (experiment.rig, experiment.axes) == ("r", ("xA", "xB", "yA", "yB"))
    assert_same(experiment.main, demodulated)
    assert len(experiment.sweeps) == (1 if form.startswith("one") else 2)


def test_version_5_with_bare_arrays_and_a_cell_of_axes(tmp_path, demodulated):
    content = demodulated | {"sample_rate_hz": 10_000.0, "axes": np.array(["xA", "xB", "yA", "yB"], dtype=object)}
    scipy.io.savemat(tmp_path / "bare.mat", content)
    experiment = read(tmp_path / "bare.mat")
    assert (experiment.rig, experiment.axes) == ("bare", ("xA", "xB", "yA", "yB"))
    assert experiment.main.kind == "stepped-sine"


def test_version_5_records(tmp_path, recorded):
    scipy.io.savemat(tmp_path / "e.mat", TOP | OWN | recorded)
    sweep = read(tmp_path / "e.mat").main
    k = np.arange(4)
    np.testing.assert_allclose(sweep.R[k, :, 1, k], 0.2, rtol=1e-9)


def test_one_point_loses_no_dimension(tmp_path, demodulated):
    one = {k: v if k == "harmonics" else v[:1] for k, v in demodulated.items()}
    scipy.io.savemat(tmp_path / "e.mat", TOP | OWN | one)
    assert read(tmp_path / "e.mat").main.Y.shape == (1, 4, 4, 4)


def write_matlab_73(path, variables):
    """HDF5 as MATLAB writes it: dimensions reversed, chars as uint16, complex as pairs, classes as attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        references = file.create_group("#refs#")

        def put(parent, name, value):
            if isinstance(value, dict):
                group = parent.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for k, v in value.items():
                    put(group, k, v)
                return
            if isinstance(value, list) and value and isinstance(value[0], dict):
                group = parent.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for k in value[0]:
                    refs = []
                    for v in value:
                        label = f"r{len(references)}"
                        put(references, label, v[k])
                        refs.append(references[label].ref)
                    group.create_dataset(k, data=np.array([refs], dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
                return
            if isinstance(value, str):
                codes = np.array([[ord(c)] for c in value], dtype=np.uint16)
                parent[name] = codes if value else np.zeros(2, dtype=np.uint64)
                parent[name].attrs["MATLAB_class"] = np.bytes_("char")
                if not value:
                    parent[name].attrs["MATLAB_empty"] = np.uint8(1)
                return
            array = np.atleast_2d(np.asarray(value))
            if np.iscomplexobj(array):
                pairs = np.zeros(array.T.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
                pairs["real"], pairs["imag"] = array.T.real, array.T.imag
                parent[name] = pairs
            else:
                parent[name] = array.T.astype(float)
            parent[name].attrs["MATLAB_class"] = np.bytes_("double")

        for k, v in variables.items():
            put(file, k, v)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + b"\x00\x02IM")


@pytest.mark.parametrize("form", ["struct of structs", "struct array", "one sweep"])
def test_version_73(tmp_path, fields, demodulated, form):
    other = fields | {"comment": ""}
    content = {
        "struct of structs": {"sweeps": {"s0": fields, "s1": other}},
        "struct array": {"sweeps": [fields, other]},
        "one sweep": fields,
    }[form]
    write_matlab_73(tmp_path / "e.mat", TOP | content)
    experiment = read(tmp_path / "e.mat")
    assert (experiment.rig, experiment.axes) == ("r", ("xA", "xB", "yA", "yB"))
    assert_same(experiment.main, demodulated)
    if form != "one sweep":
        assert experiment.sweeps[1].comment == ""


def test_version_73_with_as_many_points_as_axes(tmp_path, fields, demodulated):
    four = {k: v if k == "harmonics" else np.concatenate([v, v[:1]]) for k, v in demodulated.items()}
    write_matlab_73(tmp_path / "e.mat", TOP | OWN | four)
    assert_same(read(tmp_path / "e.mat").main, four)


def test_version_73_records(tmp_path, recorded):
    write_matlab_73(tmp_path / "e.mat", TOP | OWN | recorded)
    sweep = read(tmp_path / "e.mat").main
    k = np.arange(4)
    np.testing.assert_allclose(sweep.Y[k, :, 1, k], 4e-7, rtol=1e-3)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_what_a_file_may_tell_beside_its_points_is_read_from_both_versions(tmp_path, fields, version):
    """MATLAB has no vectors: each comes as a matrix of one row or column."""
    points, blocks = fields["R"].shape[:2]
    more = {
        "kind": "multisine",
        "block_samples": np.full(points, 2000.0),
        "time_s": np.arange(points) + 1.5,
        "point_speed_rad_s": np.linspace(4.5, 5.5, points),
        "phase_rad": np.arange(points * blocks).reshape(points, blocks) / 10,
        "kurtosis": np.array([1.0, 1.1, 1.2, 1.3]),
    }
    write = scipy.io.savemat if version == "5" else write_matlab_73
    write(tmp_path / "e.mat", TOP | {"sweeps": fields | more})
    found = read(tmp_path / "e.mat").main
    for name, told in more.items():
        np.testing.assert_array_equal(getattr(found, name), told, err_msg=name)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.99])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_a_truncated_file(tmp_path, fields, share, version):
    path = tmp_path / "e.mat"
    if version == "5":
        scipy.io.savemat(path, TOP | fields)
    else:
        write_matlab_73(path, TOP | fields)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ExperimentFileError, match=r"e\.mat"):
        read(path)


def test_an_error_names_the_dataset(tmp_path, fields):
    fields["Y"] = fields["Y"].copy()
    fields["Y"][0, 0, 0, 0] = np.nan
    scipy.io.savemat(tmp_path / "e.mat", TOP | {"sweeps": {"s0": fields}})
    with pytest.raises(ExperimentFileError, match="/sweeps/s0/Y has 1 values that are not finite"):
        read(tmp_path / "e.mat")


def test_axes_counted_from_one_are_refused(tmp_path, fields):
    fields["axis"] = np.array([1, 2, 4])
    scipy.io.savemat(tmp_path / "e.mat", TOP | fields)
    with pytest.raises(ExperimentFileError, match=r"axis holds 4; it must index the 4 axes, 0 to 3"):
        read(tmp_path / "e.mat")


def test_a_file_of_something_else(tmp_path):
    scipy.io.savemat(tmp_path / "e.mat", {"a": np.eye(3)})
    with pytest.raises(ExperimentFileError, match="axes"):
        read(tmp_path / "e.mat")


@pytest.mark.parametrize("turned", [False, True])
def test_a_mat_file_in_the_layout_of_the_contract(tmp_path, demodulated, turned):
    with h5py.File(tmp_path / "e.mat", "w", userblock_size=512) as file:
        file.attrs.update(TOP)
        group = file.create_group("sweeps/0")
        group.attrs.update(OWN)
        for k, v in demodulated.items():
            group[k] = v.T if turned else v
    with (tmp_path / "e.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\0" * 8 + b"\x00\x02IM")
    assert_same(read(tmp_path / "e.mat").main, demodulated)
