"""Frequency responses as universal file datasets 58 (function at nodal degree of freedom), and back.

One dataset an entry: response node and direction say the output, reference node and direction the input; bearing A is
node 1, B node 2; plane x is direction +1, y is +2. Written in binary (58b): the text form has six digits of frequency,
too few for a mode of a damping ratio of 0.001. Beside a response, function type 4, its standard deviation is a general
function, type 0, of the same nodes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from service.exports.errors import ExportError
from service.exports.responses import Responses

FRF, GENERAL = 4, 0
NODES = {"A": 1, "B": 2}
DIRECTIONS = {"x": 1, "y": 2}
STD = "standard deviation of the response"


def datasets(r: Responses) -> list[dict[str, Any]]:
    """Datasets for pyuff."""
    out = []
    for a, (target, unit) in enumerate(zip(r.outputs, r.output_units, strict=True)):
        for b, (source, per) in enumerate(zip(r.inputs, r.input_units, strict=True)):
            common = _common(r, target, unit, source, per)
            out.append(common | {"func_type": FRF, "id2": "frequency response", "data": r.value[:, a, b]})
            if r.std is not None:
                out.append(common | {"func_type": GENERAL, "id2": STD, "data": r.std[:, a, b]})
    return out


def _common(r: Responses, target: str, unit: str, source: str, per: str) -> dict[str, Any]:
    rsp_node, rsp_dir = _place(target)
    ref_node, ref_dir = _place(source)
    return {
        "type": 58,
        "binary": 1,
        "id1": r.name[:80],
        "id3": f"{target} [{unit}] per {source} [{per}]"[:80],
        "rsp_ent_name": target[:10],
        "rsp_node": rsp_node,
        "rsp_dir": rsp_dir,
        "ref_ent_name": source[:10],
        "ref_node": ref_node,
        "ref_dir": ref_dir,
        "x": r.frequency_hz,
        "abscissa_spacing": 0,
        "abscissa_spec_data_type": 18,  # frequency
        "abscissa_axis_lab": "frequency",
        "abscissa_axis_units_lab": "Hz",
        "ordinate_spec_data_type": 8 if unit == "m" else 0,  # displacement
        "ordinate_axis_lab": target[:20],
        "ordinate_axis_units_lab": unit,
        "orddenom_spec_data_type": 0,
        "orddenom_axis_lab": source[:20],
        "orddenom_axis_units_lab": per,
    }


def _place(signal: str) -> tuple[int, int]:
    """Node and direction of a signal named ``u_xA``; node 0 where the name says neither."""
    axis = signal.rpartition("_")[2]
    if len(axis) == 2 and axis[0] in DIRECTIONS and axis[1] in NODES:
        return NODES[axis[1]], DIRECTIONS[axis[0]]
    return 0, 0


def with_sizes(content: bytes, sets: list[dict[str, Any]]) -> bytes:
    """A file of these datasets with the true number of bytes in each header.

    pyuff 2.5 counts a value's bytes but not its frequency's, nor its imaginary part's; readers that trust the header
    would stop early.
    """
    sizes = iter(8 * len(d["x"]) * (3 if np.iscomplexobj(d["data"]) else 2) for d in sets)
    return re.sub(
        rb"(    -1\r?\n    58b.{24})(.{12})",
        lambda m: m.group(1) + b"%12d" % next(sizes),
        content,
        count=len(sets),
        flags=re.DOTALL,
    )


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
