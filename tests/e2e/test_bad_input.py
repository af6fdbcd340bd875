"""What bad input gets: one line that names the thing and the remedy, status 1, and nothing half written."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from service.experiment import file
from sim.rig_file import to_toml
from tests.support.command import refusal
from tests.support.measured import small_experiment


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Folder with a small experiment and its datasheet."""
    folder = tmp_path_factory.mktemp("good")
    experiment, datasheet = small_experiment()
    file.write(folder / "experiment.h5", experiment)
    (folder / "rig.toml").write_text(to_toml(datasheet))
    return folder


@pytest.fixture
def damaged(good, tmp_path):
    """A copy of the experiment that a test spoils; refused when it is identified."""
    path = tmp_path / "experiment.h5"
    path.write_bytes((good / "experiment.h5").read_bytes())

    def refused() -> str:
        line = refusal("identify", path, "--rig", good / "rig.toml", "--out", tmp_path / "out")
        assert not (tmp_path / "out" / "result.json").exists()
        return line

    return path, refused


DATASHEETS = {
    "a missing value": ("mass_kg = 280.0\n", "", "rotor.mass_kg"),
    "a negative value": ("mass_kg = 280.0", "mass_kg = -280.0", "rotor.mass_kg"),
    "not a number": ("mass_kg = 280.0", "mass_kg = nan", "rotor.mass_kg"),
    "a wrong type": ("mass_kg = 280.0", 'mass_kg = "heavy"', "rotor.mass_kg"),
    "a wrong count": ("bias_current_a = [2.75, 2.75, 2.75, 2.75]", "bias_current_a = [2.75, 2.75]", "bias_current_a"),
    "an unknown value": ("mass_kg = 280.0", "mass_kg = 280.0\nwheels = 4.0", "wheels"),
    "no TOML": ("[rig]", "[rig", "TOML"),
}


@pytest.mark.parametrize("case", DATASHEETS)
def test_a_datasheet_with(case, good, tmp_path):
    old, new, said = DATASHEETS[case]
    text = (good / "rig.toml").read_text()
    assert old in text
    (tmp_path / "rig.toml").write_text(text.replace(old, new))
    line = refusal("identify", good / "experiment.h5", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "out")
    assert said in line
    assert "rig.toml" in line


def test_a_datasheet_that_is_not_there(good, tmp_path):
    line = refusal("identify", good / "experiment.h5", "--rig", tmp_path / "none.toml", "--out", tmp_path)
    assert "none.toml" in line


def test_a_rig_that_its_controller_cannot_levitate(good, tmp_path):
    text = (good / "rig.toml").read_text()
    start = text.index("numerator = ")
    (tmp_path / "rig.toml").write_text(
        text[:start] + "numerator = [1.0, 0.0]\ndenominator = [1.0, -0.5]\n\n" + text[text.index("[limits]") :]
    )
    rig = ("--rig", tmp_path / "rig.toml")
    assert "levitate" in refusal("rig", "serve", *rig)
    url = f"simulated://?rig={tmp_path / 'rig.toml'}"
    assert "levitate" in refusal("commission", "--controller", url, *rig, "--out", tmp_path / "out")


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_a_truncated_experiment(share, damaged):
    path, refused = damaged
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    line = refused()
    assert "experiment.h5" in line
    assert "truncated" in line or "damaged" in line or "cut off" in line


def test_an_experiment_with_a_value_that_is_no_number(damaged):
    path, refused = damaged
    with h5py.File(path, "a") as f:
        f["sweeps/0/Y"][3, 0, 0, 0] = np.nan
    assert "/sweeps/0/Y" in refused()


def test_an_experiment_with_shapes_that_do_not_match(damaged):
    path, refused = damaged
    with h5py.File(path, "a") as f:
        y = f["sweeps/0/Y"][:-1]
        del f["sweeps/0/Y"]
        f["sweeps/0/Y"] = y
    assert "/sweeps/0" in refused()


def test_an_experiment_of_another_version(damaged):
    path, refused = damaged
    with h5py.File(path, "a") as f:
        f.attrs["version"] = 7
    assert "version" in refused()


def test_an_experiment_with_too_few_blocks(damaged):
    path, refused = damaged
    with h5py.File(path, "a") as f:
        for name in ("R", "U", "I", "Y"):
            one = f[f"sweeps/0/{name}"][:, :1]
            del f[f"sweeps/0/{name}"]
            f[f"sweeps/0/{name}"] = one
    assert "block" in refused()


def test_an_experiment_whose_inputs_cannot_be_told_apart(damaged):
    path, refused = damaged
    with h5py.File(path, "a") as f:
        sweep = f["sweeps/0"]
        hz, axis = sweep["frequency_hz"][()], sweep["axis"][()]
        one, other = (np.flatnonzero((axis == k) & (hz == hz[20]))[0] for k in (0, 1))
        for name in ("U", "I", "Y"):
            sweep[name][other] = sweep[name][one]
    line = refused()
    assert "singular" in line
    assert "Hz" in line


def test_an_experiment_that_excites_one_input_only(good, tmp_path):
    experiment = file.read(good / "experiment.h5")
    only = replace(experiment, sweeps=tuple(s.select(s.axis == 0) for s in experiment.sweeps))
    file.write(tmp_path / "one.h5", only)
    line = refusal("identify", tmp_path / "one.h5", "--rig", good / "rig.toml", "--out", tmp_path / "out")
    assert "xB" in line


def test_an_experiment_that_is_not_there(good, tmp_path):
    line = refusal("identify", tmp_path / "none.h5", "--rig", good / "rig.toml", "--out", tmp_path / "out")
    assert "none.h5" in line


def test_a_folder_that_cannot_be_written_is_found_before_anything_moves(good, tmp_path):
    (tmp_path / "taken").write_text("a file")
    out, rig = ("--out", tmp_path / "taken"), ("--rig", good / "rig.toml")
    assert "taken" in refusal("demo", *out)
    assert "taken" in refusal("demo", "--out", tmp_path / "taken" / "below")
    assert "taken" in refusal("identify", good / "experiment.h5", *rig, *out)
    # nobody answers at that address: that would be the complaint if the link were tried first
    assert "taken" in refusal("commission", "--controller", "modbus://127.0.0.1:9", *rig, *out)


def test_a_controller_that_does_not_answer(good, tmp_path):
    line = refusal(
        "commission", "--controller", "modbus://127.0.0.1:9", "--rig", good / "rig.toml", "--out", tmp_path / "out"
    )
    assert "127.0.0.1" in line


def test_a_controller_of_no_known_kind(good, tmp_path):
    words = ("--controller", "carrier-pigeon://loft", "--rig", good / "rig.toml", "--out", tmp_path)
    line = refusal("commission", *words, status=2)
    assert "--controller" in line
    assert "modbus://" in line


def test_the_datasheet_of_another_rig(good, tmp_path):
    text = (good / "rig.toml").read_text().replace("sample_time_s = 0.0001", "sample_time_s = 0.0002")
    (tmp_path / "other.toml").write_text(text)
    line = refusal(
        "commission", "--controller", "simulated://", "--rig", tmp_path / "other.toml", "--out", tmp_path / "out"
    )
    assert "Hz" in line
