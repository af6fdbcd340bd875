"""A good experiment file, and hostile ones, each built to hurt whoever reads it carelessly."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import scipy.io

GIB = 1 << 30
MIB = 1 << 20


AXES = ("xA", "xB", "yA", "yB")


def good(path: Path, points: int = 8, n_axes: int = 4, **replaced: object) -> Path:
    """A demodulated experiment of one sweep; ``replaced`` replaces datasets."""
    rng = np.random.default_rng(1)
    with h5py.File(path, "w") as file:
        file.attrs.update(format="amb-experiment", version=1, rig="bench 3", axes=json.dumps(AXES[:n_axes]))
        sweep = file.create_group("sweeps/0")
        sweep.attrs.update(kind="stepped-sine", speed_rad_s=0.0, sample_rate_hz=10_000.0, comment="main")
        for name, value in (datasets(points, n_axes, rng) | replaced).items():
            if value is not None:
                sweep[name] = value
    return path


def datasets(points: int, n_axes: int, rng: np.random.Generator) -> dict[str, object]:
    shape = (points, 4, 2, n_axes)
    axis = np.arange(points) % n_axes
    R = np.zeros(shape, dtype=complex)
    R[np.arange(points), :, 1, axis] = 0.1
    noisy = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    return {
        "frequency_hz": 10.0 + np.arange(points) // n_axes * (3900.0 / points),
        "axis": axis.astype(np.int8),
        "amplitude_a": np.full(points, 0.1),
        "harmonics": np.array([0, 1]),
        "R": R,
        "U": noisy,
        "I": noisy,
        "Y": 1e-6 * noisy,
    }


def good_matlab(path: Path, points: int = 8) -> Path:
    fields = datasets(points, len(AXES), np.random.default_rng(1))
    fields |= {"sample_rate_hz": 10_000.0, "kind": "stepped-sine"}
    scipy.io.savemat(path, {"sweeps": fields, "axes": json.dumps(AXES), "rig": "bench 3"}, do_compression=True)
    return path


def sweep(path: Path, change: Callable[[h5py.Group], object]) -> Path:
    """A good file whose sweep is then changed."""
    with h5py.File(good(path), "r+") as file:
        change(file["sweeps/0"])
    return path


def _replace(name: str, **how: object) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]
        group.create_dataset(name, **how)

    return change


def _link(name: str, link: object) -> Callable[[h5py.Group], None]:
    def change(group: h5py.Group) -> None:
        del group[name]
        group[name] = link

    return change


def _virtual(group: h5py.Group) -> None:
    layout = h5py.VirtualLayout((8, 4, 2, 2), dtype=complex)
    layout[:] = h5py.VirtualSource("/etc/hostname", "x", (8, 4, 2, 2))
    del group["Y"]
    group.create_virtual_dataset("Y", layout)


def _external_storage(group: h5py.Group) -> None:
    del group["frequency_hz"]
    group.create_dataset("frequency_hz", (8,), "f8", external=[("/etc/passwd", 0, 64)])


def _circle(group: h5py.Group) -> None:
    group["again"] = group
    group.create_group("a")["up"] = group


def _deep(group: h5py.Group) -> None:
    for _ in range(200):
        group = group.create_group("g")


def _wide(group: h5py.Group) -> None:
    for k in range(20_001):
        group.create_group(f"g{k}", track_order=False)


def _chunk_bomb(group: h5py.Group) -> None:
    """A chunk that says it unpacks to 64 MiB and is 100 bytes of rubbish: the size is the file's word only."""
    _replace("Y", shape=(1 << 23,), dtype="f8", chunks=(1 << 23,), compression="gzip")(group)
    group["Y"].id.write_direct_chunk((0,), zlib.compress(bytes(1 << 26), 9))


def _nan(group: h5py.Group) -> None:
    group["Y"][3, 0, 0, 0] = np.nan


def _group_for_a_dataset(group: h5py.Group) -> None:
    del group["Y"]
    group.create_group("Y")


def _foreign_filter(group: h5py.Group) -> None:
    del group["frequency_hz"]
    group.create_dataset("frequency_hz", data=np.zeros(8), chunks=(8,), compression="gzip")
    path = group.file.filename
    group.file.close()
    # the number of the filter in the message of the dataset: deflate (1) becomes a program that is to be loaded
    raw = Path(path).read_bytes()
    at = raw.index(b"deflate\x00") - 8
    Path(path).write_bytes(raw[:at] + struct.pack("<H", 32_015) + raw[at + 2 :])


def _many_references(group: h5py.Group) -> None:
    group.create_dataset("flags", (50_000,), dtype=h5py.ref_dtype)


def _large_attribute(group: h5py.Group) -> None:
    group.create_group("g", track_order=True)
    file = group.file
    path = file.filename
    file.close()
    with h5py.File(path, "r+", libver="latest") as again:
        again.create_group("h").attrs.create("x", np.zeros(1 << 18))


def very_many_points(path: Path) -> Path:
    """Records of very many, very short points: cheap to send, dear to demodulate."""
    points, samples = 60_000, 100
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file.attrs.update(format="amb-experiment", version=1, rig="r", axes='["xA"]')
        group = file.create_group("sweeps/0")
        group.attrs.update(kind="stepped-sine", speed_rad_s=0.0, sample_rate_hz=10_000.0, comment="")
        group["frequency_hz"] = np.full(points, 2500, "i2")
        group["axis"] = np.zeros(points, "i1")
        group["amplitude_a"] = np.ones(points, "i1")
        group["sample_start"] = samples * np.arange(points + 1, dtype="i4")
        for name in "ruiy":
            group[name] = rng.integers(-100, 100, (points * samples, 1), "i1")
    return path


def _truncated(kept: float, make: Callable[[Path], Path] = good) -> Callable[[Path], Path]:
    def cut(path: Path) -> Path:
        raw = make(path).read_bytes()
        path.write_bytes(raw[: int(kept * len(raw))])
        return path

    return cut


def _bytes(content: bytes) -> Callable[[Path], Path]:
    def write(path: Path) -> Path:
        path.write_bytes(content)
        return path

    return write


_MAT_HEADER = b"MATLAB 5.0 MAT-file, Platform: X".ljust(116) + bytes(8) + b"\x00\x01IM"


def _mat_variable(claimed: int, inner: bytes) -> bytes:
    """A compressed variable that says it unpacks to ``claimed`` bytes."""
    packed = zlib.compress(struct.pack("<II", 14, claimed) + inner, 9)
    return struct.pack("<II", 15, len(packed)) + packed


def _mat_array(rows: int, claimed_bytes: int) -> bytes:
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    shape = struct.pack("<IIii", 5, 8, rows, 1)
    return flags + shape + struct.pack("<HH4s", 1, 1, b"x\0\0\0") + struct.pack("<II", 9, claimed_bytes)


def _mat_nested(depth: int) -> bytes:
    """A cell in a cell in a cell..., each honest about its size."""
    inner = _mat_array(1, 8) + bytes(8)
    for _ in range(depth):
        element = struct.pack("<II", 14, len(inner)) + inner
        inner = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0) + element
    return struct.pack("<II", 14, len(inner)) + inner


def _mat_73_circle(path: Path) -> Path:
    """A cell whose only member is itself."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("#refs#")
        cell = group.create_dataset("a", (1,), dtype=h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_(b"cell")
        cell[0] = cell.ref
        file["sweeps"] = cell
    raw = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + raw[512:])
    return path


def _h5(change: Callable[[h5py.Group], object]) -> Callable[[Path], Path]:
    return lambda path: sweep(path, change)


HOSTILE: dict[str, tuple[Callable[[Path], Path], int, str]] = {
    "external link": (_h5(_link("Y", h5py.ExternalLink("/etc/passwd", "/x"))), 422, "link into another file"),
    "external link to itself": (_h5(_link("Y", h5py.ExternalLink("x.h5", "/sweeps/0/U"))), 422, "another file"),
    "soft link": (_h5(_link("Y", h5py.SoftLink("/sweeps/0/U"))), 422, "soft link"),
    "dangling soft link": (_h5(_link("Y", h5py.SoftLink("/nowhere"))), 422, "soft link"),
    "virtual dataset": (_h5(_virtual), 422, "virtual dataset"),
    "external storage": (_h5(_external_storage), 422, "in another file"),
    "1e9 elements": (_h5(_replace("Y", shape=(10**9,), dtype="f8")), 413, "7,629 MiB"),
    "1e9 elements, chunked": (_h5(_replace("Y", shape=(10**9,), dtype="c16", chunks=(1000,))), 413, "MiB are read"),
    "2^63 elements": (_h5(_replace("Y", shape=(1 << 31, 1 << 31), dtype="f8", chunks=(64, 64))), 413, "MiB are read"),
    "200 MiB in 200 KiB": (
        _h5(_replace("Y", data=np.zeros(25 * MIB), compression="gzip", compression_opts=9)),
        413,
        "measured data do not pack so tightly",
    ),
    "one bomb in one chunk": (_h5(_chunk_bomb), 413, "do not pack so tightly"),
    "foreign filter": (_h5(_foreign_filter), 422, "filter 32015"),
    "circle of groups": (_h5(_circle), 0, ""),
    "200 groups deep": (_h5(_deep), 422, "groups deep"),
    "20,001 groups": (_h5(_wide), 422, "at most 20000"),
    "50,000 references": (_h5(_many_references), 422, "references"),
    "2 MiB attribute": (_h5(_large_attribute), 413, "attribute x"),
    "NaN": (_h5(_nan), 422, "not finite"),
    "infinite": (lambda p: good(p, amplitude_a=np.full(8, np.inf)), 422, "not finite"),
    "text for numbers": (_h5(_replace("frequency_hz", data=["a"] * 8)), 422, "must hold numbers"),
    "records for numbers": (_h5(_replace("Y", data=np.zeros(8, dtype=[("a", "f8"), ("b", "f8")]))), 422, "numbers"),
    "lists of numbers": (_h5(_replace("Y", shape=(8,), dtype=h5py.vlen_dtype(np.float64))), 422, "must hold numbers"),
    "opaque": (_h5(_replace("Y", data=np.zeros(8, "V16"))), 422, "must hold numbers"),
    "times": (_h5(_replace("Y", data=np.zeros(8, "i8").astype("M8[s]").astype(h5py.opaque_dtype("M8[s]")))), 422, "Y"),
    "wrong shape": (lambda p: good(p, Y=np.zeros((8, 3))), 422, "shape"),
    "axis out of range": (lambda p: good(p, axis=np.full(8, 100, "i1")), 422, "axis"),
    "group for a dataset": (_h5(_group_for_a_dataset), 422, "Y"),
    "60,000 points": (very_many_points, 413, "at most 20,000"),
    "half": (_truncated(0.5), 422, "truncated or damaged"),
    "all but the end": (_truncated(0.98), 422, "truncated"),
    "signature alone": (_bytes(b"\x89HDF\r\n\x1a\n"), 422, "truncated"),
    "nothing": (_bytes(b""), 415, "neither an HDF5 nor a MATLAB file"),
    "text": (_bytes(b"[rig]\nname = 'a'\n"), 415, "neither"),
    "zip": (_bytes(b"PK\x03\x04" + bytes(100)), 415, "neither"),
    "no experiment": (lambda p: (h5py.File(p, "w").close(), p)[1], 422, "format is missing"),
    "mat, half": (_truncated(0.5, good_matlab), 422, "cut off"),
    "mat, header alone": (_bytes(b"MATLAB 5.0 MAT-file"), 422, "header"),
    "mat, claims 4 GiB": (
        _bytes(_MAT_HEADER + _mat_variable(0xFFFFFFF0, _mat_array(1 << 29, 0xFFFFFF00))),
        413,
        "tightly",
    ),
    "mat, unpacks to 4 GiB and lies": (
        _bytes(_MAT_HEADER + _mat_variable(4096, _mat_array(1 << 28, 1 << 31) + bytes(64 * MIB))),
        413,
        "memory",
    ),
    "mat, cells 20,000 deep": (_bytes(_MAT_HEADER + _mat_nested(20_000)), 422, ""),
    "mat 7.3, cell in itself": (_mat_73_circle, 422, ""),
}
"""Name: how it is made, the status of its refusal (0: it is harmless and read), a part of the reason."""
