"""What is exported comes back, number for number and name for name, in every format."""

import string

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.exports import control as control_objects
from service.exports import files, linear
from service.exports.linear import Linear
from service.exports.responses import Responses

FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64, min_value=-1e12, max_value=1e12)
NAME = st.text(string.ascii_letters + string.digits + "_", min_size=1, max_size=8)
TEXT = st.text(string.ascii_letters + string.digits + ' ,;"-+.()/', min_size=1, max_size=30).map(str.strip).filter(bool)
UNIT = st.sampled_from(["A", "m", "N/A", "1", "rad/s"])
QUICK = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def names(n, of=NAME):
    return st.lists(of, min_size=n, max_size=n, unique=True).map(tuple)


def numbers(draw, *shape):
    size = int(np.prod(shape))
    return np.array(draw(st.lists(FINITE, min_size=size, max_size=size)), dtype=float).reshape(shape)


@st.composite
def models(draw):
    n, m, p = draw(st.integers(1, 5)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    signals = draw(names(m + p))
    return Linear(
        draw(TEXT),
        numbers(draw, n, n),
        numbers(draw, n, m),
        numbers(draw, p, n),
        numbers(draw, p, m),
        draw(names(n, TEXT)),
        signals[:m],
        signals[m:],
        tuple(draw(st.lists(UNIT, min_size=m, max_size=m))),
        tuple(draw(st.lists(UNIT, min_size=p, max_size=p))),
        draw(TEXT),
    )


@st.composite
def measured(draw):
    n, m, p = draw(st.integers(2, 6)), draw(st.integers(1, 2)), draw(st.integers(1, 2))
    signals = draw(names(m + p))
    steps = draw(st.lists(st.floats(1e-6, 1e3), min_size=n, max_size=n))
    has_std = draw(st.booleans())
    value = numbers(draw, n, p, m) + 1j * numbers(draw, n, p, m)
    return Responses(
        draw(TEXT),
        np.cumsum(steps),
        value,
        np.abs(numbers(draw, n, p, m)) if has_std else None,
        signals[:m],
        signals[m:],
        tuple(draw(st.lists(UNIT, min_size=m, max_size=m))),
        tuple(draw(st.lists(UNIT, min_size=p, max_size=p))),
    )


def assert_same_model(one: Linear, other: Linear, comment: bool = True) -> None:
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    fields = ["name", "states", "inputs", "outputs", "input_units", "output_units"] + ["comment"] * comment
    assert [getattr(one, f) for f in fields] == [getattr(other, f) for f in fields]


def assert_same_responses(one: Responses, other: Responses) -> None:
    np.testing.assert_array_equal(one.frequency_hz, other.frequency_hz)
    np.testing.assert_array_equal(one.value, other.value)
    assert (one.std is None) == (other.std is None)
    if one.std is not None:
        np.testing.assert_array_equal(one.std, other.std)
    for f in ("name", "inputs", "outputs", "input_units", "output_units"):
        assert getattr(one, f) == getattr(other, f)


@pytest.mark.parametrize("ending", files.LINEAR_ENDINGS)
@QUICK
@given(model=models())
def test_models_come_back(ending, model, tmp_path):
    path = files.write_linear(tmp_path / f"model{ending}", model)
    assert_same_model(model, files.read_linear(path))


@QUICK
@given(model=models())
def test_models_come_back_from_python_control(model):
    assert_same_model(model, control_objects.from_control(control_objects.to_control(model)), comment=False)


@QUICK
@given(model=models())
def test_models_come_back_from_their_document(model):
    assert_same_model(model, linear.from_document(linear.document(model)))


@pytest.mark.parametrize("ending", files.RESPONSE_ENDINGS)
@QUICK
@given(found=measured())
def test_responses_come_back(ending, found, tmp_path):
    path = tmp_path / f"response{ending}"
    path.unlink(missing_ok=True)
    (written,) = files.write_responses(path, [found])
    (back,) = files.read_responses(written)
    assert_same_responses(found, back)
