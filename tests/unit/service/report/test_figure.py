"""Figures: panels where they should be, axes that can be read, arrays that plotly reads back."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.report.figure import Figure, band, line, log_frequency, log_magnitude, points


def domains(figure: Figure, key: str) -> list[list[float]]:
    return [v["domain"] for k, v in figure.layout.items() if k.startswith(key)]


@given(rows=st.integers(1, 4), columns=st.integers(1, 4), every=st.booleans(), height=st.integers(380, 1500))
def test_panels_never_overlap_and_stay_inside(rows, columns, every, height):
    titles = [f"t{k}" for k in range(rows * columns if every else columns)]
    figure = Figure("f", rows, columns, height, titles=titles)
    boxes = list(zip(domains(figure, "xaxis"), domains(figure, "yaxis"), strict=True))
    assert len(boxes) == rows * columns
    for (x0, x1), (y0, y1) in boxes:
        assert 0 <= x0 < x1 <= 1
        assert 0 <= y0 < y1 <= 1
    for i, (xa, ya) in enumerate(boxes):
        for xb, yb in boxes[:i]:
            apart_x = xa[1] <= xb[0] + 1e-6 or xb[1] <= xa[0] + 1e-6
            apart_y = ya[1] <= yb[0] + 1e-6 or yb[1] <= ya[0] + 1e-6
            assert apart_x or apart_y
    assert len(figure.layout["annotations"]) == len(titles)


def test_a_name_is_in_the_legend_once():
    figure = Figure("f", 1, 2, 400)
    x = np.arange(3.0)
    for column in (0, 1):
        figure.add(0, column, line(x, x, "model"))
        figure.add(0, column, points(x, x, "measured"))
    shown = [t["name"] for t in figure.data if t.get("showlegend") is not False]
    assert shown == ["model", "measured"]


@given(low=st.floats(0.5, 100), ratio=st.floats(3, 1e4))
def test_frequency_ticks_are_inside_and_plain(low, ratio):
    axis = log_frequency(low, low * ratio)
    assert axis["tickvals"]
    for value, text in zip(axis["tickvals"], axis["ticktext"], strict=True):
        assert axis["range"][0] <= np.log10(value) <= axis["range"][1]
        assert "e" not in text
        assert float(text) == pytest.approx(value)


@given(st.lists(st.floats(1e-9, 1e9), min_size=1, max_size=20))
def test_every_value_is_inside_a_logarithmic_axis(values):
    low, high = log_magnitude([np.array(values)])["range"]
    assert low <= np.log10(min(values))
    assert np.log10(max(values)) <= high


def test_an_axis_without_values_is_still_an_axis():
    assert log_magnitude([np.array([np.nan, 0.0])]) == {"type": "log"}


def unpacked(value) -> np.ndarray:
    kind = np.dtype(value["dtype"]).newbyteorder("<")
    return np.frombuffer(base64.b64decode(value["bdata"]), dtype=kind)


def test_long_arrays_keep_the_digits_that_show():
    figure = Figure("f", 1, 1, 400)
    wide, narrow = np.geomspace(1e-9, 1e3, 100), 5700.0 + np.linspace(-1e-4, 1e-4, 100)
    figure.add(0, 0, line(wide, narrow, "a"))
    trace = figure.document()["data"][0]
    assert unpacked(trace["x"]) == pytest.approx(wide, rel=1e-6)
    assert unpacked(trace["y"]) == pytest.approx(narrow, rel=1e-12)


def test_what_is_not_finite_becomes_a_gap():
    figure = Figure("f", 1, 1, 400)
    figure.add(0, 0, line(np.arange(3.0), np.array([1.0, np.nan, np.inf]), "a"))
    assert figure.document()["data"][0]["y"] == [1.0, None, None]


def shown_alone(*y: float) -> list[bool]:
    """Which points of a curve have a marker."""
    trace = line(np.arange(1.0, 1 + len(y)), np.array(y), "a")
    assert ("markers" in trace["mode"]) == ("marker" in trace)
    return (trace["marker"]["size"] > 0).tolist() if "marker" in trace else [False] * len(y)


def test_a_curve_of_one_point_is_seen():
    assert shown_alone(1.0) == [True]
    assert shown_alone(1.0, 2.0) == [False, False]
    assert shown_alone(1.0, np.nan, 2.0, 3.0, np.nan, 4.0) == [True, False, False, False, False, True]


def test_one_frequency_alone_is_in_the_middle_of_its_axis():
    axis = log_frequency(70.0, 70.0)
    low, high = axis["range"]
    assert low < np.log10(70.0) < high
    assert "tickvals" not in axis, "none of 1, 2 and 5 is there: the drawing finds its own"


def test_a_band_goes_forth_above_and_back_below():
    b = band(np.array([1.0, 2.0]), np.array([0.0, 0.1]), np.array([1.0, 1.1]), "region")
    assert b["x"].tolist() == [1.0, 2.0, 2.0, 1.0]
    assert b["y"].tolist() == [1.0, 1.1, 0.1, 0.0]
