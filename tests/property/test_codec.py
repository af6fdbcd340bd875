"""Whatever a value is, it comes back from the wire as it went in, to half a count; and nothing else comes back."""

import math
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.codec import Progress, beat_bytes, beat_of, progress_bytes, progress_of, stop_bytes, stop_of
from drivers.controller import HARMONICS, PointResult, Tone
from drivers.errors import BusError, LimitError
from drivers.modbus.codec import entry_bytes, entry_value, read_request, read_response, to_bytes, to_registers
from drivers.modbus.map import DEFAULT_MAP, Entry
from drivers.objects import GROUPS, Group, Object, Type
from drivers.packing import Value, decode, encode, pack, unpack
from drivers.payload import decode_lockin, decode_raw, encode_lockin, encode_raw, lockin_bytes, payload_crc

U32 = st.integers(0, 2**32 - 1)
ORDERS = st.sampled_from(["big", "little"])


def values_of(obj: Object) -> st.SearchStrategy[Value]:
    if obj.type is Type.TEXT:
        return st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=obj.count)
    if obj.type is Type.F64:
        one: st.SearchStrategy[float] = st.floats(allow_nan=False, allow_infinity=False)
    elif obj.type is Type.F32:
        one = st.floats(width=32, allow_nan=False, allow_infinity=False)
    else:
        low, high = {Type.U16: (0, 2**16 - 1), Type.U32: (0, 2**32 - 1), Type.I32: (-(2**31), 2**31 - 1)}[obj.type]
        low = low if obj.low is None else max(low, math.ceil(obj.low * obj.per_unit))
        high = high if obj.high is None else min(high, math.floor(obj.high * obj.per_unit))
        one = st.integers(low, high).map(lambda n: n / obj.per_unit if obj.per_unit > 1 else n)
    return one if obj.count == 1 else st.tuples(*[one] * obj.count)


def groups() -> st.SearchStrategy[tuple[Group, dict[str, Value]]]:
    return st.sampled_from(GROUPS).flatmap(
        lambda g: st.tuples(
            st.just(g), st.fixed_dictionaries({o.name: values_of(o) for o in g.objects if o.name != "crc"})
        )
    )


@given(groups(), ORDERS)
def test_group_comes_back_as_it_went(case: tuple[Group, dict[str, Value]], order) -> None:
    group, values = case
    raw = pack(group, values, order)
    assert len(raw) == group.size
    back = unpack(group, raw, order)
    assert {k: v for k, v in back.items() if k != "crc"} == values


@given(groups(), ORDERS, st.data())
def test_flipped_bit_is_seen(case: tuple[Group, dict[str, Value]], order, data: st.DataObject) -> None:
    group, values = case
    if group.objects[-1].name != "crc":
        return  # a stop has none: any frame stops
    raw = bytearray(pack(group, values, order))
    bit = data.draw(st.integers(0, 8 * len(raw) - 1))
    raw[bit // 8] ^= 1 << (bit % 8)
    try:
        back = unpack(group, bytes(raw), order)
    except BusError:
        return
    # a bit behind the end of a text says nothing; then the values are what they were
    assert {k: v for k, v in back.items() if k != "crc"} == values


@given(groups(), st.integers(1, 30), ORDERS)
def test_short_group_is_refused(case: tuple[Group, dict[str, Value]], missing: int, order) -> None:
    group, values = case
    with pytest.raises(BusError, match="cut short"):
        unpack(group, pack(group, values, order)[:-missing], order)


@given(st.sampled_from([e for e in DEFAULT_MAP.entries if e.obj.name != "crc"]), ORDERS, st.data())
def test_registers_hold_a_value_in_either_word_order(entry: Entry, order, data: st.DataObject) -> None:
    value = data.draw(values_of(entry.obj))
    raw = entry_bytes(entry, value, order)
    assert len(raw) == 2 * entry.size
    assert entry_value(entry, to_bytes(to_registers(raw)), order) == value


@given(st.floats(1e-7, 4000))
def test_amplitude_is_rounded_to_half_a_microampere(amplitude: float) -> None:
    obj = next(g for g in GROUPS if g.name == "tone")["amplitude_a"]
    back = decode(obj, encode(obj, amplitude))
    assert isinstance(back, float)
    assert abs(back - amplitude) <= 0.5000001e-6


@given(st.sampled_from([float("nan"), float("inf"), -1.0, 5000.0]))
def test_value_that_does_not_fit_is_refused(value: float) -> None:
    obj = next(g for g in GROUPS if g.name == "tone")["amplitude_a"]
    with pytest.raises(LimitError):
        encode(obj, value)


@given(st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.integers(1, 125), st.data())
def test_read_answer_is_taken_only_for_its_own_request(
    transaction: int, unit: int, count: int, data: st.DataObject
) -> None:
    body = data.draw(st.binary(min_size=2 * count, max_size=2 * count))
    request = read_request(transaction, unit, 7, count)
    answer = request[:4] + (3 + 2 * count).to_bytes(2, "big") + bytes([unit, 4, 2 * count]) + body
    assert read_response(answer, transaction, unit, count) == body
    with pytest.raises(BusError):
        read_response(answer, (transaction + 1) % 0x10000, unit, count)
    with pytest.raises(BusError):
        read_response(answer[:-1], transaction, unit, count)


def points() -> st.SearchStrategy[PointResult]:
    return st.builds(
        _point,
        seed=st.integers(0, 2**32 - 1),
        blocks=st.integers(1, 9),
        axes=st.sampled_from([2, 4]),
        samples=st.integers(2, 40),
        scale=st.floats(1e-9, 1e2),
    )


def _point(seed: int, blocks: int, axes: int, samples: int, scale: float) -> PointResult:
    generator = np.random.default_rng(seed)

    def amplitudes() -> np.ndarray:
        shape = (blocks, len(HARMONICS), axes)
        x = scale * (generator.normal(size=shape) + 1j * generator.normal(size=shape))
        x[:, 0] = x[:, 0].real
        return x

    tone = Tone(
        axis=int(generator.integers(axes)), amplitude_a=0.25, periods=1, samples=samples, blocks=blocks, raw=True
    )
    records = {name: scale * generator.normal(size=(blocks * samples, axes)) for name in "uiy"}
    return PointResult(tone, HARMONICS, amplitudes(), amplitudes(), amplitudes(), amplitudes(), 0, 0, 0, 1, records)


@settings(max_examples=50)
@given(points(), ORDERS)
def test_payload_keeps_what_the_noise_leaves(point: PointResult, order) -> None:
    """32-bit floats of the mean over the blocks, and of each block's difference from it all but 1/130000."""
    axes = point.Y.shape[2]
    payload = encode_lockin(point, order)
    assert len(payload) in lockin_bytes(point.tone, axes)
    r, u, i, y = decode_lockin(payload, point.tone, axes, order)
    for back, truth, floor in ((u, point.U, 1e-10), (i, point.I, 1e-10), (y, point.Y, 1e-16)):
        scatter = np.abs(truth - truth.mean(axis=0)).max()
        assert np.abs(back.mean(axis=0) - truth.mean(axis=0)).max() <= 1e-6 * np.abs(truth).max() + scatter / 65000
        assert np.abs(back - truth).max() <= 1e-7 * np.abs(truth).max() + scatter / 65000 + floor
    assert np.all(r[:, 1, point.tone.axis] == 0.25)
    assert np.count_nonzero(r) == point.tone.blocks
    assert point.records is not None
    records = decode_raw(encode_raw(point, order), point.tone, axes, order)
    for name in "uiy":
        np.testing.assert_allclose(records[name], point.records[name], rtol=6e-8)
    assert records["r"].max() == pytest.approx(0.25)


@given(U32, U32, st.binary(max_size=50))
def test_payload_of_another_result_does_not_pass(one: int, two: int, payload: bytes) -> None:
    if one != two:
        assert payload_crc(one, payload) != payload_crc(two, payload)
    assert payload_crc(one, payload) == zlib.crc32(one.to_bytes(4, "big") + payload)


@given(U32, U32, st.integers(0, 6), st.integers(0, 4))
def test_process_data_comes_back(token: int, count: int, state: int, outcome: int) -> None:
    assert beat_of(beat_bytes(token, count)) == (token, count)
    assert stop_of(stop_bytes(token)) == token
    assert progress_of(progress_bytes(Progress(state, count, outcome))) == Progress(state, count, outcome)


@given(st.binary(max_size=8))
def test_any_stop_frame_stops_and_a_cut_beat_is_no_beat(raw: bytes) -> None:
    assert isinstance(stop_of(raw), int)
    if len(raw) != 8:
        with pytest.raises(BusError):
            beat_of(raw)
