"""The zone of a commissioning is that of the loop, not of a point that had not settled or of noise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.identification.fit import identify
from service.identification.loop.margins import SURE, above
from service.identification.measured.etfe import FrequencyResponse
from service.identification.result.commissioning import PlaneResult
from sim.reference import reference_rig
from tests.support.commissioned import LAW, SHEET
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.two_axes import sheet_of_one_plane

ONE = sheet_of_one_plane(SHEET)
MODEL = plane_model_of(reference_rig(), "x")


@cache
def sweep(to_hz: float = 1000.0, comment: str = "main") -> Sweep:
    """One plane of the reference rig from 10 Hz on, with lines about its modes."""
    lines = 60 if comment == "main" else 20
    near = [m[0] / (2 * np.pi) + np.linspace(-3, 3, 7) for m in MODEL.modes if comment == "main"]
    hz = np.unique(np.concatenate([np.geomspace(10 if near else 11, to_hz, lines), *near]))
    noise = {"relative_noise": 1e-3, "current_noise_a": 1e-6, "displacement_noise_m": 1e-12}
    return synthetic_sweep({"x": MODEL}, ONE.axes, LAW, hz[hz <= to_hz], 0.05, seed=lines, comment=comment, **noise)


def identified(main: Sweep, to_hz: float = 1000.0) -> PlaneResult:
    sweeps = main, sweep(0.97 * to_hz, "validation")
    return identify(synthetic_experiment(*sweeps, axes=ONE.axes, rig="reference"), ONE).planes["x"]


@cache
def usual() -> PlaneResult:
    return identified(sweep())


def test_a_point_that_had_not_settled_moves_no_zone():
    """Its flag says that its mean is off by more than its noise: seven times, as of a tone that still rang."""
    main = sweep()
    at = int(np.flatnonzero((main.axis == 0) & (main.frequency_hz > 45))[0])
    loud = {name: getattr(main, name).copy() for name in "UIY"}
    for signal in loud.values():
        signal[at] *= 7
    flags = ["not settled" if k == at else "" for k in range(main.n_points)]
    found = identified(replace(main, flags=tuple(flags), **loud))
    assert found.document()["margins"]["iso_14839_3_zone"] == usual().document()["margins"]["iso_14839_3_zone"] == "C"
    assert found.margins["A"].measured_peak == pytest.approx(usual().margins["A"].measured_peak, rel=0.01)


@pytest.mark.parametrize(("deviations", "counts"), [(SURE - 1, False), (SURE + 1, True)])
def test_a_measured_peak_counts_once_noise_does_not_explain_that_it_is_above_the_models(deviations, counts):
    std = 0.1
    peak = 4.0 + deviations * std
    value = np.array([1.0, peak, 2.0])[:, None, None] * np.eye(2)
    measured = FrequencyResponse(np.arange(1.0, 4.0), value + 0j, np.full((3, 2, 2), std * np.sqrt(2)))
    assert above(measured, 0, 4.0) == (pytest.approx(peak) if counts else None)


def test_a_loud_and_uncertain_line_does_not_count_before_a_sure_one():
    value = np.array([9.0, 5.0])[:, None, None] * np.eye(2) + 0j
    std = np.array([3.0, 0.01])[:, None, None] * np.ones((2, 2))
    assert above(FrequencyResponse(np.array([1.0, 2.0]), value, std), 1, 4.0) == 5.0
