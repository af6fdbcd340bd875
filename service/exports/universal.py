"""Frequency responses as universal file datasets 58 (function at nodal degree of freedom), and back.

One dataset an entry: response node and direction say the output, reference node and direction the input; bearing A is
node 1, B node 2; plane x is direction +1, y is +2. Written in binary (58b): the text form has six digits of frequency,
too few for a mode of a damping ratio of 0.001. Beside a response, function type 4, its standard deviation is a general
function, type 0, of the same nodes. A dataset 164 before them says that lengths are in metres and forces in newtons, so
that no tool asks, or takes metres for millimetres; what is neither, as amperes, has its unit in the axes' labels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.exports.errors import ExportError
from service.exports.responses import Complex, Real, Responses

FRF, GENERAL = 4, 0
NODES = {"A": 1, "B": 2}
DIRECTIONS = {"x": 1, "y": 2}
LINE = 80
"""Characters of a line of the header."""
STD = "standard deviation of the response"
SI, RELATIVE = 1, 2
"""Code of metre and newton, and of temperatures that count from another zero, as degrees Celsius do."""
KELVIN_AT_ZERO = 273.15


def content(found: Iterable[Responses]) -> bytes:
    """A universal file of these responses.

    Written here and read by pyuff: pyuff 2.5's own writer loses the first header of a binary file, counts a third of
    its bytes in the header, and leaves files open.
    """
    return _units() + b"".join(_datasets(r) for r in found)


def _units() -> bytes:
    """Dataset 164: by what a length, a force and a temperature of the file are divided to be in SI, and 0 degrees."""
    lines = [
        f"{-1:6d}",
        f"{164:6d}",
        f"{SI:10d}{'SI: Meter (newton)':<20s}{RELATIVE:10d}",
        3 * _double(1.0),
        _double(KELVIN_AT_ZERO),
        f"{-1:6d}",
    ]
    return "".join(f"{line}\n" for line in lines).encode("ascii")


def _double(value: float) -> str:
    """FORTRAN's D25.17, whose exponent is a D.

    >>> _double(273.15)
    '  2.73149999999999977D+02'
    """
    return f"{value:25.17E}".replace("E", "D")


def _datasets(r: Responses) -> bytes:
    out = []
    for a, (target, unit) in enumerate(zip(r.outputs, r.output_units, strict=True)):
        for b, (source, per) in enumerate(zip(r.inputs, r.input_units, strict=True)):
            named = _Names(r.name, target, unit, source, per)
            out.append(_dataset(named, FRF, "frequency response", r.frequency_hz, r.value[:, a, b]))
            if r.std is not None:
                out.append(_dataset(named, GENERAL, STD, r.frequency_hz, r.std[:, a, b]))
    return b"".join(out)


@dataclass(frozen=True)
class _Names:
    response: str
    output: str
    output_unit: str
    input: str
    input_unit: str


def _dataset(named: _Names, kind: int, what: str, x: Real, y: Real | Complex) -> bytes:
    """One dataset 58b, little-endian IEEE doubles: pairs (x, y) or triples (x, re y, im y), x unevenly spaced."""
    is_complex = np.iscomplexobj(y)
    columns = [x, y.real, y.imag] if is_complex else [x, y]
    data = np.stack(columns, axis=1).astype("<f8").tobytes()
    rsp_node, rsp_dir = _place(named.output)
    ref_node, ref_dir = _place(named.input)
    displacement = 8 if named.output_unit == "m" else 0
    lines = [
        f"{-1:6d}",
        # little-endian, IEEE 754, lines of the header, bytes after it
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        _told_apart(named.response),
        what,
        f"{named.output} [{named.output_unit}] per {named.input} [{named.input_unit}]",
        "NONE",
        "NONE",
        f"{kind:5d}{0:10d}{0:5d}{0:10d} {named.output[:10]:>10s}{rsp_node:10d}{rsp_dir:4d} "
        f"{named.input[:10]:>10s}{ref_node:10d}{ref_dir:4d}",
        f"{6 if is_complex else 4:10d}{len(x):10d}{0:10d}{0.0:13.5e}{0.0:13.5e}{0.0:13.5e}",
        _axis(18, "frequency", "Hz"),
        _axis(displacement, named.output, named.output_unit),
        _axis(0, named.input, named.input_unit),
        _axis(0, "NONE", "NONE"),
    ]
    head = "".join(f"{line[:LINE]:<{LINE}s}\n" if 2 <= k < 7 else f"{line}\n" for k, line in enumerate(lines))
    return head.encode("ascii", "replace") + data + b"\n    -1\n"


def _told_apart(name: str) -> str:
    """A response's name in a line of the header: a long one loses its middle, for plane and path are at its end.

    >>> told = _told_apart(90 * "a" + " x u->y")
    >>> len(told), told[-11:], _told_apart("a" + chr(10) + "b")
    (80, 'aaaa x u->y', 'a b')
    """
    line = "".join(c if c.isprintable() else " " for c in name)
    return line if len(line) <= LINE else f"{line[: LINE // 2]}...{line[LINE // 2 + 3 - LINE :]}"


def _axis(kind: int, label: str, unit: str) -> str:
    """Record of an axis: specific data type (18 frequency, 8 displacement, 0 other), exponents of units, labels."""
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label[:20]:<20s} {unit[:20]:<20s}"


def _place(signal: str) -> tuple[int, int]:
    """Node and direction of a signal named ``u_xA``; node 0 where the name says neither."""
    axis = signal.rpartition("_")[2]
    if len(axis) == 2 and axis[0] in DIRECTIONS and axis[1] in NODES:
        return NODES[axis[1]], DIRECTIONS[axis[0]]
    return 0, 0


def from_datasets(found: Iterable[Mapping[str, Any]]) -> list[Responses]:
    """Responses of a file's datasets 58, one a name and set of frequencies, in the order of the file.

    Raises
    ------
    ExportError
        No dataset 58 of a frequency response, or one without an entry of its matrix.
    """
    groups: dict[tuple[str, bytes], list[Mapping[str, Any]]] = {}
    for d in found:
        if d.get("type") == 58 and d.get("func_type") in (FRF, GENERAL):
            key = (str(d["id1"]).strip(), np.asarray(d["x"], dtype=float).tobytes())
            groups.setdefault(key, []).append(d)
    made = [_matrix(name, group) for (name, _), group in groups.items() if any(d["func_type"] == FRF for d in group)]
    if not made:
        raise ExportError("the file has no dataset 58 with a frequency response (function type 4)")
    return made


def _matrix(name: str, group: list[Mapping[str, Any]]) -> Responses:
    outputs: dict[str, str] = {}
    inputs: dict[str, str] = {}
    for d in group:
        if d["func_type"] == FRF:
            outputs[_label(d, "rsp")] = _unit(d.get("ordinate_axis_units_lab"))
            inputs[_label(d, "ref")] = _unit(d.get("orddenom_axis_units_lab"))
    x = np.asarray(group[0]["x"], dtype=float)
    shape = (len(x), len(outputs), len(inputs))
    value, std = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    rows, columns = list(outputs), list(inputs)
    for d in group:
        target, source = _label(d, "rsp"), _label(d, "ref")
        if d["func_type"] == FRF:
            value[:, rows.index(target), columns.index(source)] = d["data"]
        elif str(d.get("id2", "")).strip() == STD and target in outputs and source in inputs:
            std[:, rows.index(target), columns.index(source)] = np.asarray(d["data"]).real
    if np.isnan(value).any():
        raise ExportError(f"response {name!r}: the file lacks entries of its matrix of {', '.join(rows)}")
    return Responses(
        name,
        x,
        value,
        None if np.isnan(std).any() else std,
        tuple(inputs),
        tuple(outputs),
        tuple(inputs.values()),
        tuple(outputs.values()),
    )


def _label(d: Mapping[str, Any], side: str) -> str:
    """Name of a signal: the entity's, or node and direction where a tool gives none."""
    name = str(d.get(f"{side}_ent_name", "")).strip()
    return name if name and name != "NONE" else f"node {d[f'{side}_node']} direction {d[f'{side}_dir']}"


def _unit(label: Any) -> str:
    text = str(label or "").strip()
    return "1" if text in ("", "NONE") else text
