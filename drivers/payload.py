"""What a finished tone looks like on the wire: 32-bit floats of u, i and y; r is known from the tone. Pure.

The lock-in payload is, for u, i, y in turn, ``(blocks, 7, axes)``: the mean, then real and imaginary part of
harmonics 1, 2, 3. A raw record is ``(blocks * samples, 3, axes)``. A 32-bit float rounds by 6e-8 of the value,
1e-11 m in 100 um: far below a tenth of the sensors' noise, and of what is left of it after averaging.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from drivers.controller import HARMONICS, PointResult, Tone
from drivers.device.lockin import cosine, quantised_amplitude
from drivers.packing import Order
from sim.rig import Array

_FLOAT = {"big": np.dtype(">f4"), "little": np.dtype("<f4")}
_PARTS = 2 * len(HARMONICS) - 1


def payload_crc(result: int, payload: bytes) -> int:
    """CRC-32 over the result's number and its payload, so that two results cannot be mixed up."""
    return zlib.crc32(payload, zlib.crc32(result.to_bytes(4, "big")))


def encode_lockin(point: PointResult, order: Order) -> bytes:
    """Lock-in payload of a result."""
    signals = []
    for x in (point.U, point.I, point.Y):
        parts = [x[:, 0].real]
        for h in range(1, len(HARMONICS)):
            parts += [x[:, h].real, x[:, h].imag]
        signals.append(np.stack(parts, axis=1))
    return np.stack(signals).astype(_FLOAT[order]).tobytes()


def lockin_bytes(tone: Tone, n_axes: int) -> int:
    """Length of a lock-in payload."""
    return 3 * tone.blocks * _PARTS * n_axes * 4


def decode_lockin(payload: bytes, tone: Tone, n_axes: int, order: Order) -> tuple[NDArray[np.complex128], ...]:
    """R, U, I, Y of a payload, (blocks, harmonics, axes) each."""
    values = np.frombuffer(payload, _FLOAT[order]).astype(float).reshape(3, tone.blocks, _PARTS, n_axes)
    signals = np.zeros((3, tone.blocks, len(HARMONICS), n_axes), dtype=np.complex128)
    signals[:, :, 0] = values[:, :, 0]
    signals[:, :, 1:] = values[:, :, 1::2] + 1j * values[:, :, 2::2]
    r = np.zeros((tone.blocks, len(HARMONICS), n_axes), dtype=np.complex128)
    r[:, 1, tone.axis] = quantised_amplitude(tone.amplitude_a)
    return r, signals[0], signals[1], signals[2]


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
