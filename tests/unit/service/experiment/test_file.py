"""Experiment files: what the contract allows is read, everything else gets one line that names the place."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from service.experiment.errors import ExperimentFileError
from service.experiment.file import read, write

PRACTICE = Path(__file__).parents[5] / "shared" / "practice"


def refused(path) -> str:
    with pytest.raises(ExperimentFileError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_what_is_written_is_read_back(tmp_path, experiment):
    write(tmp_path / "e.h5", experiment)
    again = read(tmp_path / "e.h5")
    assert (again.rig, again.axes, again.attributes) == (experiment.rig, experiment.axes, experiment.attributes)
    for old, new in zip(experiment.sweeps, again.sweeps, strict=True):
        per_point = ("frequency_hz", "axis", "amplitude_a", "block_samples", "time_s", "point_speed_rad_s")
        for name in (*per_point, "R", "U", "I", "Y"):
            np.testing.assert_array_equal(getattr(new, name), getattr(old, name), err_msg=name)
        assert (new.kind, new.comment, new.flags, new.harmonics) == (old.kind, old.comment, old.flags, old.harmonics)


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (3, 2, 1, 0), (0, 2, 1, 3)])
def test_harmonics_in_another_order_are_the_same_experiment(tmp_path, experiment, order):
    """The twin answers in ascending order: as they came, a rig without a gap differed by 82 %."""
    sweep = experiment.main
    assert sweep.harmonics == (0, 1, 2, 3)
    signals = {name: getattr(sweep, name)[:, :, list(order)] for name in ("R", "U", "I", "Y")}
    write(tmp_path / "e.h5", replace(experiment, sweeps=(replace(sweep, harmonics=order, **signals),)))
    again = read(tmp_path / "e.h5").main
    assert again.harmonics == (0, 1, 2, 3)
    for name in signals:
        np.testing.assert_allclose(getattr(again, name), getattr(sweep, name), rtol=1e-12, err_msg=name)


def test_writing_leaves_no_other_file(tmp_path, experiment):
    write(tmp_path / "e.h5", experiment)
    write(tmp_path / "e.h5", experiment)
    assert [p.name for p in tmp_path.iterdir()] == ["e.h5"]


def test_records_become_whole_period_blocks(write_hdf5, recorded):
    sweep = read(write_hdf5(recorded)).main
    assert sweep.Y.shape == (4, 6, 4, 4)
    k = np.arange(4)
    np.testing.assert_allclose(sweep.R[k, :, 1, k], 0.2, rtol=1e-9)
    np.testing.assert_allclose(sweep.U[k, :, 0, k], 0.01, rtol=1e-6)
    np.testing.assert_allclose(sweep.I[k, :, 1, k], 0.18, rtol=1e-6)
    np.testing.assert_allclose(sweep.Y[k, :, 1, k], 4e-7, rtol=1e-3)


def test_a_noise_record_becomes_spectral_lines(write_hdf5, recorded):
    rng = np.random.default_rng(0)
    rest = {k: rng.standard_normal((6000, 4)) for k in "ruiy"}
    one = {"frequency_hz": [0.0], "axis": [0], "amplitude_a": [0.0], "sample_start": [0, 6000]}
    path = write_hdf5(recorded)
    with h5py.File(path, "a") as file:
        group = file.create_group("sweeps/1")
        group.attrs.update(kind="noise", speed_rad_s=0.0, sample_rate_hz=10_000.0, comment="noise")
        for k, v in (rest | one).items():
            group[k] = v
    noise = read(path).sweeps[1]
    assert noise.kind == "noise"
    assert noise.Y.shape[1:] == (6, 4, 4)
    # white noise of variance 1 in blocks of 1000 samples: E|Y|^2 = 4 / 1000
    assert np.mean(np.abs(noise.Y[5:, :, 1]) ** 2) == pytest.approx(4e-3, rel=0.1)


def test_no_logged_current_is_allowed(write_hdf5, demodulated, recorded):
    del demodulated["I"], recorded["i"]
    assert read(write_hdf5(demodulated)).main.I is None
    assert read(write_hdf5(recorded)).main.I is None


def test_sweeps_are_in_order_of_their_number(tmp_path, experiment, write_hdf5, demodulated):
    path = write_hdf5(demodulated)
    with h5py.File(path, "a") as file:
        for k in (10, 2):
            file.copy("sweeps/0", f"sweeps/{k}")
            file[f"sweeps/{k}"].attrs["comment"] = str(k)
    assert [s.comment for s in read(path).sweeps] == ["main", "2", "10"]


@pytest.mark.parametrize("name", ["²", "9" * 5000])
def test_a_sweep_may_have_any_name(write_hdf5, demodulated, name):
    path = write_hdf5(demodulated)
    with h5py.File(path, "a") as file:
        file.move("sweeps/0", f"sweeps/{name}")
    assert [s.comment for s in read(path).sweeps] == ["main"]


def test_a_text_in_another_encoding_can_be_written_again(tmp_path, write_hdf5, demodulated):
    path = write_hdf5(demodulated, {"comment": b"f\xfcr \xb5m"}, {"rig": b"Pr\xfcfstand"})
    found = read(path)
    assert (found.rig, found.sweeps[0].comment) == ("Pr\ufffdfstand", "f\ufffdr \ufffdm")
    write(tmp_path / "again.h5", found)
    assert read(tmp_path / "again.h5").rig == found.rig


def test_a_text_that_a_terminal_would_obey_is_marked_and_others_are_kept(write_hdf5, demodulated):
    """What is read is told on terminals: the name of the rig in a note of a diagnosis."""
    found = read(write_hdf5(demodulated, {"comment": "up\u00a0to\t900\u202fHz, 20 °C"}, {"rig": "a\x1b]0;title\x07"}))
    assert (found.rig, found.main.comment) == ("a\ufffd]0;title\ufffd", "up\u00a0to\t900\u202fHz, 20 °C")


def test_another_time_origin_is_moved(write_hdf5, demodulated):
    turn = np.exp(0.7j * np.arange(4))[None, None, :, None]
    turned = {k: v * turn if k in "RUIY" else v for k, v in demodulated.items()}
    sweep = read(write_hdf5(turned)).main
    np.testing.assert_allclose(sweep.Y, demodulated["Y"], atol=1e-12)
    np.testing.assert_allclose(sweep.R, demodulated["R"], atol=1e-12)


@pytest.mark.skipif(not PRACTICE.is_dir(), reason="the practice cases are not beside the repository")
def test_every_practice_file_is_read():
    paths = sorted(PRACTICE.glob("*/experiment.h5"))
    assert paths
    for path in paths:
        experiment = read(path)
        assert experiment.main.comment == "main"
        assert experiment.main.I is not None
        first = experiment.main.R[np.arange(experiment.main.n_points), :, 1, experiment.main.axis]
        assert np.all(first.real > 0)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.97])
def test_a_truncated_file(tmp_path, experiment, share):
    path = tmp_path / "e.h5"
    write(path, experiment)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    assert "copy it again" in refused(path)


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_file_never_ends_in_another_error(tmp_path, experiment, seed):
    path = tmp_path / "e.h5"
    write(path, experiment)
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    for k in rng.integers(0, len(data), 200):
        data[k] = rng.integers(0, 256)
    path.write_bytes(data)
    found, told = None, ""
    try:
        found = read(path)
    except ExperimentFileError as error:
        told = str(error)
    # what is read after all was struck where nothing has a meaning, or in a number that no sum of the file holds
    assert str(path) in told if found is None else found.main.Y.shape == experiment.main.Y.shape


def test_a_name_in_the_file_that_is_damaged(tmp_path):
    path = tmp_path / "e.h5"
    with h5py.File(path, "w") as file:  # of the oldest format, which has no check sums of its names
        file.attrs.update(format="amb-experiment", version=1, rig="r", axes='["xA", "xB", "yA", "yB"]')
        group = file.create_group("sweeps/0")
        for name in ("axis", "frequency_hz", "harmonics"):
            group[name] = [1.0]
    data = path.read_bytes()
    assert data.count(b"frequency_hz") == 1
    path.write_bytes(data.replace(b"frequency_hz", b"\xabrequency_hz"))  # is not where its order would have it
    assert "copy it again" in refused(path)


def test_a_dataset_that_states_to_be_larger_than_any_memory(tmp_path):
    path = tmp_path / "e.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update(format="amb-experiment", version=1, rig="r", axes='["xA", "xB", "yA", "yB"]')
        group = file.create_group("sweeps/0")
        group.create_dataset("frequency_hz", shape=(10**13,), dtype="f8", chunks=(10**6,))
    assert "memory" in refused(path)


def test_a_file_that_does_not_exist(tmp_path):
    assert "does not exist" in refused(tmp_path / "nothing.h5")


def test_an_interrupted_campaign_is_pointed_out(tmp_path):
    (tmp_path / "experiment.journal").write_text("")
    assert "resume" in refused(tmp_path / "experiment.h5")


def test_a_folder_in_place_of_a_file(tmp_path):
    assert "cannot be read" in refused(tmp_path)


def test_a_text_file(tmp_path):
    (tmp_path / "e.h5").write_text("frequency_hz,axis\n")
    assert "no HDF5 or MATLAB file" in refused(tmp_path / "e.h5")


@pytest.mark.parametrize("name", ["format", "version", "rig", "axes"])
def test_a_missing_attribute_of_the_file(write_hdf5, demodulated, name):
    assert f"attribute {name}" in refused(write_hdf5(demodulated, root={name: None}))


@pytest.mark.parametrize("name", ["kind", "speed_rad_s", "sample_rate_hz"])
def test_a_missing_attribute_of_a_sweep(write_hdf5, demodulated, name):
    assert f"/sweeps/0: attribute {name}" in refused(write_hdf5(demodulated, {name: None}))


@pytest.mark.parametrize(
    ("root", "said"),
    [
        ({"format": "other"}, "format"),
        ({"version": 2}, "version 2 is unknown"),
        ({"version": "new"}, "version"),
        ({"axes": "xA, xB"}, "JSON list"),
        ({"axes": "[]"}, "JSON list"),
        ({"axes": '["xA", "xA", "yA", "yB"]'}, "twice"),
    ],
)
def test_a_wrong_attribute_of_the_file(write_hdf5, demodulated, root, said):
    assert said in refused(write_hdf5(demodulated, root=root))


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({"kind": "sweep"}, "kind is 'sweep'"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz"),
        ({"sample_rate_hz": float("nan")}, "sample_rate_hz"),
        ({"speed_rad_s": "fast"}, "speed_rad_s"),
        ({"speed_rad_s": -1e9}, "attribute speed_rad_s is -1e+09 rad/s, and no rotor turns beyond 6e+04 rad/s"),
        ({"sample_rate_hz": 39.0}, "Nyquist"),
        ({"kind": "noise"}, "no excited sweep"),
    ],
)
def test_a_wrong_attribute_of_a_sweep(write_hdf5, demodulated, attributes, said):
    assert said in refused(write_hdf5(demodulated, attributes))


def test_a_point_at_a_speed_at_which_no_rotor_turns_is_named(write_hdf5, demodulated):
    speeds = np.zeros(len(demodulated["frequency_hz"]))
    speeds[1] = 3e9
    told = refused(write_hdf5(demodulated | {"point_speed_rad_s": speeds}))
    assert "point_speed_rad_s of point 1 is 3e+09 rad/s" in told


def test_a_number_is_shown_as_one(write_hdf5, demodulated):
    assert "one finite number, not nan" in refused(write_hdf5(demodulated, {"speed_rad_s": np.float64("nan")}))


@pytest.mark.parametrize("name", ["frequency_hz", "axis", "amplitude_a", "harmonics", "R", "U", "Y"])
def test_a_missing_dataset(write_hdf5, demodulated, name):
    del demodulated[name]
    told = refused(write_hdf5(demodulated))
    assert f"/sweeps/0/{name} is missing; write it as docs/experiment-file.md says" in told


@pytest.mark.parametrize("name", ["sample_start", "r", "u", "y"])
def test_a_missing_dataset_of_records(write_hdf5, recorded, name):
    del recorded[name]
    assert f"/sweeps/0/{name} is missing" in refused(write_hdf5(recorded))


def test_a_sweep_without_signals(write_hdf5, demodulated):
    kept = {k: demodulated[k] for k in ("frequency_hz", "axis", "amplitude_a")}
    assert "neither records" in refused(write_hdf5(kept))


def test_a_file_without_sweeps(write_hdf5, demodulated):
    path = write_hdf5(demodulated)
    with h5py.File(path, "a") as file:
        del file["sweeps/0"]
    assert "no sweep" in refused(path)
    with h5py.File(path, "a") as file:
        del file["sweeps"]
    assert "/sweeps is missing" in refused(path)


@pytest.mark.parametrize("name", ["frequency_hz", "amplitude_a", "R", "U", "I", "Y"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite(write_hdf5, demodulated, name, value):
    demodulated[name] = np.array(demodulated[name])
    demodulated[name].flat[-1] = value
    assert f"/sweeps/0/{name} has 1 values that are not finite" in refused(write_hdf5(demodulated))


@pytest.mark.parametrize("name", ["u", "i", "y"])
def test_a_record_that_is_not_finite(write_hdf5, recorded, name):
    recorded[name][1234, 2] = np.nan
    message = refused(write_hdf5(recorded))
    assert f"/sweeps/0/{name}" in message
    assert "(1234, 2)" in message


@pytest.mark.parametrize("name", ["axis", "amplitude_a", "R", "U", "I", "Y"])
def test_a_shape_that_does_not_match(write_hdf5, demodulated, name):
    demodulated[name] = demodulated[name][:-1]
    assert f"/sweeps/0/{name} has shape" in refused(write_hdf5(demodulated))


@pytest.mark.parametrize("name", ["u", "i", "y"])
def test_records_of_unequal_length(write_hdf5, recorded, name):
    recorded[name] = recorded[name][:-5]
    assert f"/sweeps/0/{name} has shape" in refused(write_hdf5(recorded))


def test_another_number_of_axes(write_hdf5, demodulated, recorded):
    two = {"axes": '["xA", "xB"]'}
    assert "axis holds 2" in refused(write_hdf5(demodulated, root=two))
    demodulated["axis"] = np.zeros(3)
    assert "/R has shape" in refused(write_hdf5(demodulated, root=two))
    recorded["axis"] = np.zeros(4)
    assert "/r has shape" in refused(write_hdf5(recorded, root=two))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("frequency_hz", [10.0, -15.0, 20.0], "must be positive"),
        ("frequency_hz", [10.0, 0.0, 20.0], "must be positive"),
        ("frequency_hz", [10.0, 15.0, 5000.0], "Nyquist"),
        ("frequency_hz", [], "no points"),
        ("frequency_hz", [[10.0, 15.0, 20.0]], "has shape"),
        ("axis", [0, 1, 4], "axis holds 4"),
        ("axis", [0, -1, 2], "axis holds -1"),
        ("axis", [0, 0.5, 2], "whole numbers"),
        ("amplitude_a", [0.1, -0.1, 0.1], "must not be negative"),
        ("harmonics", [0, 2, 3, 4], "must hold 1"),
        ("harmonics", [0, 1, 1, 2], "twice"),
        ("harmonics", [0, 1, 2], "/R has shape"),
        ("flags", ["", "x"], "flags has 2 values"),
        ("frequency_hz", [b"a", b"b", b"c"], "must hold numbers"),
        ("block_samples", [1000, 0, 1000], "no period of 15 Hz"),
        ("block_samples", [1000, 1000, -5], "no period of 20 Hz"),
        ("block_samples", [0.1, 0.1, 0.1], "whole numbers"),
        ("block_samples", [1, 1, 1], "check its unit"),
    ],
)
def test_a_value_out_of_range(write_hdf5, demodulated, name, value, said):
    demodulated[name] = value
    assert said in refused(write_hdf5(demodulated))


def test_too_few_blocks(write_hdf5, demodulated):
    for name in "RUIY":
        demodulated[name] = demodulated[name][:, :1]
    assert "1 block" in refused(write_hdf5(demodulated))


def test_records_with_too_few_periods(write_hdf5, recorded):
    recorded["frequency_hz"] = np.array([3.0, 33.3, 100.0, 251.7])
    message = refused(write_hdf5(recorded))
    assert "1 whole periods of 3 Hz" in message
    assert "record longer" in message


def test_records_that_are_cut_short(write_hdf5, recorded):
    for name in "ruiy":
        recorded[name] = recorded[name][:-100]
    assert "cut short" in refused(write_hdf5(recorded))


def test_offsets_that_do_not_rise(write_hdf5, recorded):
    recorded["sample_start"] = np.array([0, 5000, 5000, 15000, 20000])
    assert "sample_start does not rise from point 1 to 2" in refused(write_hdf5(recorded))


def test_offsets_of_another_length(write_hdf5, recorded):
    recorded["sample_start"] = recorded["sample_start"][:-1]
    assert "sample_start has shape" in refused(write_hdf5(recorded))


def test_an_amplitude_without_excitation(write_hdf5, demodulated):
    demodulated["R"] = np.zeros_like(demodulated["R"])
    assert "/R is zero in the excited axis of point 0" in refused(write_hdf5(demodulated))


def test_an_unmeasured_point_is_read(write_hdf5, demodulated):
    for name in "RUIY":
        demodulated[name] = np.array(demodulated[name])
        demodulated[name][1] = 0
    demodulated["amplitude_a"] = np.array([0.1, 0.0, 0.3])
    assert read(write_hdf5(demodulated)).main.amplitude_a[1] == 0


def test_a_folder_that_cannot_be_written(tmp_path, experiment):
    (tmp_path / "file").write_text("")
    with pytest.raises(ExperimentFileError, match="cannot write"):
        write(tmp_path / "file" / "e.h5", experiment)


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from service.experiment.errors import ExperimentFileError
from service.experiment.file import read, write

source, target = map(Path, sys.argv[1:])
experiment = read(source)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for room in (2_000, 20_000, 100_000, 500_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    try:
        write(target, experiment)
    except ExperimentFileError as error:
        print(error)
"""


def test_a_full_disk_is_told_and_leaves_nothing_behind(tmp_path, write_hdf5, demodulated):
    """In a process of its own: the HDF5 library, let to write to a full disk, ends the whole process."""
    rng = np.random.default_rng(0)
    points = 400
    for name in ("frequency_hz", "axis", "amplitude_a"):
        demodulated[name] = np.resize(demodulated[name], points)
    for name in "RUIY":
        shape = (points, *np.shape(demodulated[name])[1:])
        demodulated[name] = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    source, folder = write_hdf5(demodulated), tmp_path / "full"
    folder.mkdir()
    write(folder / "e.h5", read(source))
    before = (folder / "e.h5").read_bytes()
    assert len(before) > 500_000
    run = subprocess.run(
        [sys.executable, "-c", FULL_DISK, source, folder / "e.h5"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    told = run.stdout.splitlines()
    assert len(told) == 4
    assert all(line.startswith(f"cannot write {folder / 'e.h5'}: ") for line in told)
    assert [p.name for p in folder.iterdir()] == ["e.h5"]
    assert (folder / "e.h5").read_bytes() == before
