"""Models and responses as text tables (CSV, RFC 4180), and back. Every number is written with all its digits."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np

from service.exports.errors import ExportError
from service.exports.linear import Linear
from service.exports.responses import Responses

LINEAR_HEAD = ["matrix", "row", "column", "row_name", "column_name", "row_unit", "column_unit", "value"]


def linear_csv(model: Linear) -> str:
    """One entry of A, B, C, D a line, with the names and units of its row and column; the model's name comes first."""
    return _text([["name", model.name], ["comment", model.comment], LINEAR_HEAD, *_entries(model)])


def _entries(model: Linear) -> Iterator[list[str]]:
    states = [(s, "1") for s in model.states]
    inputs = list(zip(model.inputs, model.input_units, strict=True))
    outputs = list(zip(model.outputs, model.output_units, strict=True))
    for name, rows, columns in (
        ("A", states, states),
        ("B", states, inputs),
        ("C", outputs, states),
        ("D", outputs, inputs),
    ):
        values = getattr(model, name)
        for r, (row, row_unit) in enumerate(rows):
            for c, (column, column_unit) in enumerate(columns):
                yield [name, str(r + 1), str(c + 1), row, column, row_unit, column_unit, repr(float(values[r, c]))]


def linear_from_csv(text: str) -> Linear:
    """The model of such a table.

    Raises
    ------
    ExportError
        It is none, or not whole.
    """
    lines = list(csv.reader(io.StringIO(text)))
    if len(lines) < 3 or lines[2] != LINEAR_HEAD or lines[0][:1] != ["name"]:
        raise ExportError(f"this table is no state space: its third line must be {','.join(LINEAR_HEAD)}")
    entries: dict[str, dict[tuple[int, int], float]] = {k: {} for k in "ABCD"}
    states: dict[int, str] = {}
    inputs: dict[int, tuple[str, str]] = {}
    outputs: dict[int, tuple[str, str]] = {}
    try:
        for name, row, column, row_name, column_name, row_unit, column_unit, value in lines[3:]:
            r, c = int(row) - 1, int(column) - 1
            entries[name][r, c] = float(value)
            if name in "AB":
                states[r] = row_name
            if name in "BD":
                inputs[c] = (column_name, column_unit)
            if name in "CD":
                outputs[r] = (row_name, row_unit)
    except (ValueError, KeyError) as error:
        raise ExportError(f"a line of the table is no entry of a state space: {error}") from error
    sizes = {
        "A": (len(states), len(states)),
        "B": (len(states), len(inputs)),
        "C": (len(outputs), len(states)),
        "D": (len(outputs), len(inputs)),
    }
    filled = {}
    for name, (rows, columns) in sizes.items():
        wanted = {(r, c) for r in range(rows) for c in range(columns)}
        if set(entries[name]) != wanted:
            raise ExportError(f"the table lacks entries of {name}, or has too many")
        filled[name] = np.array([entries[name][k] for k in sorted(wanted)]).reshape(rows, columns)
    return Linear(
        lines[0][1] if len(lines[0]) > 1 else "",
        filled["A"],
        filled["B"],
        filled["C"],
        filled["D"],
        tuple(states[k] for k in range(len(states))),
        tuple(inputs[k][0] for k in range(len(inputs))),
        tuple(outputs[k][0] for k in range(len(outputs))),
        tuple(inputs[k][1] for k in range(len(inputs))),
        tuple(outputs[k][1] for k in range(len(outputs))),
        lines[1][1] if len(lines[1]) > 1 else "",
    )


def responses_csv(r: Responses) -> str:
    """A line a frequency: real part, imaginary part and standard deviation of every entry, units in the heading."""
    heads = ["frequency_hz"]
    columns = [r.frequency_hz]
    for a, (out, out_unit) in enumerate(zip(r.outputs, r.output_units, strict=True)):
        for b, (source, source_unit) in enumerate(zip(r.inputs, r.input_units, strict=True)):
            name = f"{out} per {source} [{out_unit} per {source_unit}]"
            heads += [f"re {name}", f"im {name}"]
            columns += [r.value[:, a, b].real, r.value[:, a, b].imag]
            if r.std is not None:
                heads.append(f"std {name}")
                columns.append(r.std[:, a, b])
    rows = [[repr(float(v)) for v in line] for line in zip(*columns, strict=True)]
    return _text([["name", r.name], heads, *rows])


def responses_from_csv(text: str) -> Responses:
    """The responses of such a table.

    Raises
    ------
    ExportError
        It is none, or not whole.
    """
    lines = list(csv.reader(io.StringIO(text)))
    if len(lines) < 2 or lines[0][:1] != ["name"] or lines[1][:1] != ["frequency_hz"]:
        raise ExportError("this table is no frequency response: its second line must begin with frequency_hz")
    heads = lines[1]
    try:
        values = np.array([[float(v) for v in line] for line in lines[2:]]).reshape(len(lines) - 2, len(heads))
        kinds = [h.split(" ", 1) for h in heads[1:]]
        entries = [_entry(name) for _, name in kinds]
    except ValueError as error:
        raise ExportError(f"the table is not whole: {error}") from error
    outputs = dict.fromkeys((e[0], e[2]) for e in entries)
    inputs = dict.fromkeys((e[1], e[3]) for e in entries)
    shape = (len(values), len(outputs), len(inputs))
    found = {"re": np.full(shape, np.nan), "im": np.full(shape, np.nan), "std": np.full(shape, np.nan)}
    rows, columns = list(outputs), list(inputs)
    for k, ((kind, _), e) in enumerate(zip(kinds, entries, strict=True)):
        if kind not in found:
            raise ExportError(f"column {heads[k + 1]!r} is neither re, im nor std of an entry")
        found[kind][:, rows.index((e[0], e[2])), columns.index((e[1], e[3]))] = values[:, k + 1]
    if np.isnan(found["re"]).any() or np.isnan(found["im"]).any():
        raise ExportError("the table lacks the real or imaginary part of an entry")
    return Responses(
        lines[0][1] if len(lines[0]) > 1 else "",
        values[:, 0],
        found["re"] + 1j * found["im"],
        None if np.isnan(found["std"]).all() else found["std"],
        tuple(name for name, _ in columns),
        tuple(name for name, _ in rows),
        tuple(unit for _, unit in columns),
        tuple(unit for _, unit in rows),
    )


def _entry(head: str) -> tuple[str, str, str, str]:
    """Output, input and their units of a heading ``out per in [unit per unit]``."""
    names, _, units = head.partition(" [")
    out, _, source = names.partition(" per ")
    out_unit, _, source_unit = units.removesuffix("]").partition(" per ")
    if not (out and source and units):
        raise ValueError(f"column {head!r} is not named out per in [unit per unit]")
    return out, source, out_unit, source_unit


def _text(rows: list[list[str]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\r\n").writerows(rows)
    return out.getvalue()
