"""What a finished tone looks like on the wire: u, i and y; r is known from the tone. Pure.

The lock-in payload is, for u, i, y in turn, ``(blocks, 7, axes)``: the mean, then real and imaginary part of
harmonics 1, 2, 3. In its plain form every value is a 32-bit float. In its short form the mean over the blocks comes
first, ``(3, 7, axes)``, 32-bit floats, and then what each block differs from it, 24-bit floats (32-bit ones, rounded,
without their last byte): the difference is noise, of which 24 bits keep all but 1/130000. The length tells the form.
A raw record is ``(blocks * samples, 3, axes)``, 32-bit floats. A 32-bit float rounds by 6e-8 of the value, 1e-11 m in
100 um: far below a tenth of the sensors' noise, and of what is left of it after averaging.
"""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.controller import HARMONICS, PointResult, Tone, WaveformResult
from drivers.device.lockin import cosine, quantised_amplitude
from drivers.packing import Order
from sim.rig import Array

_FLOAT = {"big": np.dtype(">f4"), "little": np.dtype("<f4")}
SHORT_FROM_BLOCKS = 5
"""With fewer blocks the short form is not shorter."""
_PARTS = 2 * len(HARMONICS) - 1


def payload_crc(result: int, payload: bytes) -> int:
    """CRC-32 over the result's number and its payload, so that two results cannot be mixed up."""
    return zlib.crc32(payload, zlib.crc32(result.to_bytes(4, "big")))


def encode_lockin(point: PointResult, order: Order) -> bytes:
    """Lock-in payload of a result: the short form where it is shorter."""
    signals = []
    for x in (point.U, point.I, point.Y):
        parts = [x[:, 0].real]
        for h in range(1, len(HARMONICS)):
            parts += [x[:, h].real, x[:, h].imag]
        signals.append(np.stack(parts, axis=1))
    values = np.stack(signals)
    if point.tone.blocks < SHORT_FROM_BLOCKS:
        return bytes(values.astype(_FLOAT[order]).tobytes())
    mean = values.mean(axis=1).astype(_FLOAT[order])
    return bytes(mean.tobytes()) + _to_24_bits(values - mean[:, None].astype(float), order)


def lockin_bytes(tone: Tone, n_axes: int) -> tuple[int, int]:
    """Lengths that a lock-in payload may have: plain and short form."""
    values = 3 * _PARTS * n_axes
    return 4 * values * tone.blocks, 4 * values + 3 * values * tone.blocks


def decode_lockin(payload: bytes, tone: Tone, n_axes: int, order: Order) -> tuple[NDArray[np.complex128], ...]:
    """R, U, I, Y of a payload, (blocks, harmonics, axes) each."""
    shape = (3, tone.blocks, _PARTS, n_axes)
    if len(payload) == lockin_bytes(tone, n_axes)[0]:
        values = np.frombuffer(payload, _FLOAT[order]).astype(float).reshape(shape)
    else:
        head = 4 * 3 * _PARTS * n_axes
        mean = np.frombuffer(payload[:head], _FLOAT[order]).astype(float).reshape(3, 1, _PARTS, n_axes)
        values = mean + _from_24_bits(payload[head:], order).reshape(shape)
    signals = np.zeros((3, tone.blocks, len(HARMONICS), n_axes), dtype=np.complex128)
    signals[:, :, 0] = values[:, :, 0]
    signals[:, :, 1:] = values[:, :, 1::2] + 1j * values[:, :, 2::2]
    r = np.zeros((tone.blocks, len(HARMONICS), n_axes), dtype=np.complex128)
    r[:, 1, tone.axis] = quantised_amplitude(tone.amplitude_a)
    return r, signals[0], signals[1], signals[2]


def _to_24_bits(values: Array, order: Order) -> bytes:
    """32-bit floats, rounded to their first three bytes."""
    words = values.astype(np.float32).reshape(-1).view(np.uint32)
    rounded = (words.astype(np.uint64) + 0x80).astype(np.uint32)
    octets = rounded.astype(">u4").view(np.uint8).reshape(-1, 4)[:, :3]
    return bytes((octets if order == "big" else octets[:, ::-1]).tobytes())


def _from_24_bits(raw: bytes, order: Order) -> Array:
    """The inverse, as 64-bit floats."""
    octets = np.frombuffer(raw, np.uint8).reshape(-1, 3)
    words = np.zeros((len(octets), 4), np.uint8)
    words[:, :3] = octets if order == "big" else octets[:, ::-1]
    return words.view(">f4").reshape(-1).astype(float)


def encode_raw(point: PointResult, order: Order) -> bytes:
    """Raw record of a result, empty when it has none."""
    if point.records is None:
        return b""
    return np.stack([point.records[name] for name in "uiy"], axis=1).astype(_FLOAT[order]).tobytes()


def decode_raw(raw: bytes, tone: Tone, n_axes: int, order: Order) -> dict[str, Array]:
    """Records r, u, i, y, (blocks * samples, axes) each."""
    n = tone.blocks * tone.samples
    values = np.frombuffer(raw, _FLOAT[order]).astype(float).reshape(n, 3, n_axes)
    r = np.zeros((n, n_axes))
    r[:, tone.axis] = quantised_amplitude(tone.amplitude_a) * cosine(tone, 0, n)
    return {"r": r, "u": values[:, 0], "i": values[:, 1], "y": values[:, 2]}


def as_received(point: PointResult) -> PointResult:
    """The result as a host on a bus has it, to the last bit.

    The plan of an experiment goes by what was measured. A controller in process that gave digits which no bus
    carries would sooner or later be asked for another tone than the same controller on a bus.
    """
    axes = point.Y.shape[2]
    r, u, i, y = decode_lockin(encode_lockin(point, "big"), point.tone, axes, "big")
    return replace(
        point,
        R=r,
        U=u,
        I=i,
        Y=y,
        peak_displacement_m=float(np.float32(point.peak_displacement_m)),
        peak_current_a=float(np.float32(point.peak_current_a)),
        records=None if point.records is None else decode_raw(encode_raw(point, "big"), point.tone, axes, "big"),
    )


def records_as_received(result: WaveformResult) -> WaveformResult:
    """A waveform's records rounded to the 32-bit floats in which a bus carries u, i and y."""
    records = {k: v if k == "r" else v.astype(np.float32).astype(float) for k, v in result.records.items()}
    return replace(result, records=records)
