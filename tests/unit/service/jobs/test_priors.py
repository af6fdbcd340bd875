"""The wish for priors goes all the way from a job's options to the fit."""

import json

import pytest

from service.api.problems import UnprocessableError
from service.api.resources.options import checked_options
from service.experiment import file
from service.jobs import calculations
from tests.support.measured import small_experiment
from tests.support.service import reference_sheet


def test_the_option_is_known_and_checked():
    assert checked_options("identification", {"priors": True}) == {"priors": True}
    assert checked_options("experiment", {"priors": True, "excitation": "multisine"})["priors"] is True
    with pytest.raises(UnprocessableError, match="priors"):
        checked_options("identification", {"priors": "perhaps"})
    with pytest.raises(UnprocessableError, match="priors"):
        checked_options("gap", {"priors": True})


def test_a_datasheet_that_is_sure_of_its_magnets_is_believed_only_when_asked(tmp_path):
    """The sheet says 340 N/A to a hundred-thousandth, the rig has some 185: the prior wins where it is asked for."""
    file.write(tmp_path / "e.h5", small_experiment("x")[0])
    sheet = reference_sheet() + "\n[tolerance]\ncurrent_stiffness = 1e-8\n"
    assert sheet.count("[tolerance]") == 1
    (tmp_path / "rig.toml").write_text(sheet)
    where = {"experiment": str(tmp_path / "e.h5"), "rig": str(tmp_path / "rig.toml"), "name": "e"}
    found = {}
    for priors in (False, True):
        calculations.identification(**where, out=str(tmp_path / str(priors)), priors=priors)
        result = json.loads((tmp_path / str(priors) / "result.json").read_text())
        assert result["provenance"]["priors"] is priors
        found[priors] = result["planes"]["x"]["stiffness"]["kiA"]["value"]
    assert found[False] < 190
    assert found[True] == pytest.approx(340, rel=1e-3)
