"""What the experiment did: every sweep told from the others, whatever a file may hold."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.report.measurement import amplitude_figure, noise_figure
from sim.reference import reference_datasheet

AXES = ("xA", "xB", "yA", "yB")


def sweep(comment: str, hz: list[float], kind: str = "stepped-sine") -> Sweep:
    """One point of axis xA a line, of 0.1 A and 1 um."""
    there = np.full((len(hz), 2, 1, 4), 0.1 + 0j)
    n = len(hz)
    return Sweep(
        kind, np.array(hz), np.zeros(n, int), np.full(n, 0.1), (1,), there, there, there, 1e-5 * there, comment=comment
    )


def of(*sweeps: Sweep) -> Experiment:
    return Experiment("a rig", AXES, sweeps)


@pytest.mark.parametrize("first", [[], ["main", "validation", "amplifier"]])
def test_many_speeds_each_have_a_look_of_their_own_in_the_legend(first):
    comments = [*first, *(f"{k} Hz" for k in range(0, 160, 10))]
    figure = amplitude_figure(of(*(sweep(c, [10.0, 20.0]) for c in comments)), reference_datasheet())
    legend = [t for t in figure.data if t.get("showlegend") is not False]
    assert len({t["name"] for t in legend}) == len(comments)
    assert len({(t["marker"]["color"], t["marker"]["symbol"]) for t in legend}) == len(comments)


def test_more_sweeps_than_there_are_looks_are_all_drawn():
    figure = amplitude_figure(of(*(sweep(f"{k} Hz", [10.0, 20.0]) for k in range(60))), reference_datasheet())
    assert {t["name"] for t in figure.data} == {f"{k} Hz" for k in range(60)}


def test_a_campaign_that_was_stopped_in_its_first_look_has_a_report():
    figure = amplitude_figure(of(sweep("preliminary", [10.0, 20.0])), reference_datasheet())
    assert not figure.data


def noise(*hz: float) -> Experiment:
    """Lines of 0.1 A over a second."""
    whole = sweep("", list(hz), "noise")
    return of(replace(whole, block_samples=np.full(len(hz), 10_000), sample_rate_hz=1e4, amplitude_a=0 * np.array(hz)))


def test_a_line_at_0_hz_is_left_out_of_the_noise_and_the_others_are_drawn():
    figure = noise_figure(noise(10.0, 0.0, 5.0))
    assert figure is not None
    for panel, size in (("x", 1e3), ("x2", 1e2)):  # nm and mA
        (axis,) = (t for t in figure.data if t["xaxis"] == panel and t["name"] == "xA")
        assert axis["x"].tolist() == [5.0, 10.0]
        # E|X|^2 = 2 S / T for one second
        np.testing.assert_allclose(axis["y"], size / np.sqrt(2))
    low, high = figure.layout["xaxis"]["range"]
    assert 10**low < 5.0 < 10.0 < 10**high < 11.0


def test_a_record_of_means_alone_shows_no_noise():
    assert noise_figure(noise(0.0)) is None
