"""A whole campaign on the simulated rig: what it measures, how well, and what it tells meanwhile."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from service.experiment.file import read
from sim.reference import reference_rig
from sim.twin import linear_model
from tests.support.campaigns import PEAKS, SHEET, SMALL, assert_same, campaign, relative_error


def test_all_sweeps_are_there_and_the_file_has_them(whole):
    folder, experiment, _ = whole
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise", "preliminary"]
    assert [s.kind for s in experiment.sweeps].count("noise") == 1
    assert {p.name for p in folder.iterdir()} == {"experiment.h5"}
    assert_same(read(folder / "experiment.h5"), experiment)


def test_the_plant_is_measured_as_accurately_as_asked(whole):
    _, experiment, _ = whole
    for name in ("main", "validation"):
        _, error = relative_error(experiment.named(name), reference_rig())
        assert np.median(error) < SMALL.accuracy
        assert np.max(error) < 8 * SMALL.accuracy


def test_validation_is_on_other_frequencies_at_another_amplitude(whole):
    _, experiment, _ = whole
    main, other = experiment.named("main"), experiment.named("validation")
    assert not set(main.frequency_hz) & set(other.frequency_hz)
    ratio = []
    for f, axis, a in zip(other.frequency_hz, other.axis, other.amplitude_a, strict=True):
        near = np.argmin(np.abs(main.frequency_hz[main.axis == axis] - f))
        ratio.append(a / main.amplitude_a[main.axis == axis][near])
    assert np.mean(np.abs(np.log(ratio)) > np.log(1.3)) > 0.7  # a neighbour is not quite the same frequency


def test_amplifiers_are_measured_to_three_kilohertz(whole):
    _, experiment, _ = whole
    sweep = experiment.named("amplifier")
    assert sweep.frequency_hz.max() == pytest.approx(3000, rel=0.02)
    k = np.arange(sweep.n_points)
    measured = sweep.I[k, :, 1, sweep.axis].mean(axis=1) / sweep.U[k, :, 1, sweep.axis].mean(axis=1)
    truth = linear_model(reference_rig(), sweep.frequency_hz).i_per_u[k, sweep.axis, sweep.axis]
    assert np.median(np.abs(measured / truth - 1)) < 2 * SMALL.accuracy


def test_displacement_stays_within_its_share_of_the_linear_range(whole):
    _, experiment, _ = whole
    main = experiment.named("main")
    assert np.max(np.abs(main.Y[:, :, 1])) < 1.6 * SMALL.displacement_share * SHEET.linear_range_m


def test_progress_counts_up_to_its_total(whole):
    _, experiment, reports = whole
    assert [r.done for r in reports] == list(range(1, len(reports) + 1))
    assert reports[-1].done == reports[-1].total
    assert all(r.total >= r.done and r.seconds_left >= 0 for r in reports)
    assert reports[-1].rig_seconds == pytest.approx(float(experiment.attributes["rig_seconds"]), abs=1e-3)
    assert {"noise", "preliminary", "main", "validation", "amplifier"} <= {r.phase for r in reports}
    assert "Hz axis" in reports[-1].last
    assert sum(r.seconds_left > 0 for r in reports) > len(reports) / 2


def test_the_same_seed_gives_the_same_experiment(whole, tmp_path):
    assert_same(campaign(reference_rig(), tmp_path), whole[1])


@pytest.mark.slow
@pytest.mark.parametrize("frequencies_hz", [None, (430.0, 850.0)])
def test_peaks_are_found_and_resolved_wherever_the_rig_has_them(tmp_path, frequencies_hz):
    rig = reference_rig()
    if frequencies_hz:
        modes = tuple(
            tuple(replace(m, natural_frequency_rad_s=2 * np.pi * f) for m, f in zip(plane, frequencies_hz, strict=True))
            for plane in rig.rotor.modes
        )
        rig = replace(rig, rotor=replace(rig.rotor, modes=modes))
    reports = []
    experiment = campaign(rig, tmp_path, PEAKS, progress=reports.append)
    assert "peaks" in {r.phase for r in reports}
    f = np.unique(experiment.main.frequency_hz)
    dense = np.linspace(390, 990, 60_001)
    G = linear_model(rig, dense).y_per_u
    for plane in (slice(0, 2), slice(2, 4)):
        size = np.linalg.norm(G[:, plane, plane], axis=(1, 2))
        tops = [k for k in range(1, len(size) - 1) if size[k - 1] < size[k] > size[k + 1] and size[k] > 1e-6]
        assert len(tops) == 2
        for top in tops:
            wide = np.abs(dense - dense[top]) < 5
            wide &= size > size[top] / np.sqrt(2)
            low, high = dense[wide][0], dense[wide][-1]
            slack = 0.1 * (high - low)
            assert np.sum((f >= low - slack) & (f <= high + slack)) >= PEAKS.peak_points, dense[top]


def test_progress_is_plain_data(whole):
    assert json.loads(json.dumps(asdict(whole[2][-1])))["phase"] == "amplifier"
