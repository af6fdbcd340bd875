"""``rig.toml``: the datasheet as a file.

``parse`` reads TOML text into frozen dataclasses and refuses what is missing, mistyped, negative or
not finite with one line that names the field. ``to_toml`` writes it back without loss.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from dataclasses import fields
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from sim.datasheet import AXES, ISO_14839_3_DB, Datasheet, Mode, Tolerance
from sim.errors import DatasheetError, EffectError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

FARTHEST = 1e16
"""Largest figure of any rig in SI units, and one over the smallest that is not nought: beyond, squares of figures and
their differences are lost in the arithmetic."""


def _not_huge(value: float) -> float:
    if abs(value) > FARTHEST:
        raise ValueError(f"no rig has a figure beyond {FARTHEST:g}; check it and its unit")
    return value


def _not_tiny(value: float) -> float:
    if value < 1 / FARTHEST:
        raise ValueError(f"no rig has a figure below {1 / FARTHEST:g} there; check it and its unit")
    return value


NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True), AfterValidator(_not_huge)]
Positive = Annotated[
    float, Field(gt=0, allow_inf_nan=False, strict=True), AfterValidator(_not_huge), AfterValidator(_not_tiny)
]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True), AfterValidator(_not_huge)]
PerAxis = Positive | list[Positive]
# Beyond these only a unit can be wrong; what an experiment keeps to hangs on them.
Gap = Annotated[Positive, Field(le=0.01)]
Distance = Annotated[Positive, Field(le=5.0)]  # of a bearing from the centre of gravity: a rotor of some 10 m
Current = Annotated[Positive, Field(le=1000.0)]
Delay = Annotated[NonNegative, Field(le=0.1)]
Pair = Annotated[list[Distance], Field(min_length=2, max_length=2)]
OTHER_UNITS = {"_m": "m, not in mm or um", "_a": "A, not in mA", "_s": "s, not in ms or us"}
"""By the end of a field's name: what a value beyond any rig's is to be in."""
SignedPair = Annotated[list[Finite], Field(min_length=2, max_length=2)]

SHOWN = 3
"""Problems of a file that its error tells; the others are counted."""
LONGEST = 60
"""Characters of a name that are looked at for what it may mean: the search grows with their square."""
DEEPEST = 8
"""Parts of a dotted key, and brackets within brackets: a datasheet has three, and a parser's work grows with them."""
BYTE_ORDER_MARK = "\ufeff"
"""What some editors begin a file of UTF-8 with; TOML has none."""
# What is repeated begins otherwise each time, and an end always matches: no backtracking. Possessive groups would say
# so, but go wrong in Python 3.11.2, which Debian 12 has.
_QUOTED = re.compile(
    r'''"""(?:[^"\\]++|\\.?|"(?!""))*(?:"{3,5}|\Z)'''  # texts of several lines
    r"""|'{3}(?:[^']++|'(?!''))*(?:'{3,5}|\Z)"""
    r"""|"(?:[^"\\\n]++|\\.?)*"?|'[^'\n]*+'?"""  # texts of one line
    r"|#[^\n]*+",
    re.DOTALL,
)
_DOTTED = re.compile(r"[\w+-]++(?:[ \t]*+\.[ \t]*+[\w+-]++)*")


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Rig(_Section):
    name: Annotated[str, Field(min_length=1)]
    axes: list[str]

    @model_validator(mode="after")
    def _known_axes(self) -> _Rig:
        if tuple(self.axes) not in (AXES[:2], AXES):
            raise ValueError(f'axes must be ["xA", "xB"] or ["xA", "xB", "yA", "yB"], not {self.axes}')
        return self


class _Rotor(_Section):
    mass_kg: Positive
    transverse_inertia_kgm2: Positive
    polar_inertia_kgm2: Positive | None = None
    bearing_from_cog_m: Pair
    sensor_from_cog_m: Pair


class _Mode(_Section):
    frequency_hz: Positive
    damping_ratio: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False, strict=True)]
    shape_at_bearings: SignedPair
    shape_at_sensors: SignedPair


class _Bearings(_Section):
    current_stiffness_n_per_a: PerAxis
    position_stiffness_n_per_m: PerAxis
    bias_current_a: Current | list[Current]
    linear_range_m: Gap


class _Amplifier(_Section):
    gain: PerAxis = 1.0
    bandwidth_hz: PerAxis | None = None
    natural_frequency_hz: PerAxis | None = None
    damping_ratio: PerAxis | None = None

    @model_validator(mode="after")
    def _one_order(self) -> _Amplifier:
        second = self.natural_frequency_hz is not None and self.damping_ratio is not None
        partly = self.natural_frequency_hz is not None or self.damping_ratio is not None
        if (self.bandwidth_hz is None) == (not second) or (self.bandwidth_hz is not None and partly):
            raise ValueError("give either bandwidth_hz, or natural_frequency_hz with damping_ratio")
        return self


class _Sensor(_Section):
    gain: PerAxis = 1.0
    bandwidth_hz: PerAxis | None = None


class _Controller(_Section):
    sample_time_s: Positive
    computing_delay_s: Delay = 0.0
    numerator: Annotated[list[Finite], Field(min_length=1)]
    denominator: Annotated[list[Finite], Field(min_length=1)]

    @model_validator(mode="after")
    def _proper(self) -> _Controller:
        if self.denominator[0] == 0:
            raise ValueError("the first coefficient of denominator must not be zero")
        if len(self.numerator) > len(self.denominator):
            raise ValueError("numerator has a higher order than denominator: the controller is not causal")
        return self


class _Limits(_Section):
    displacement_m: Gap
    current_a: Current
    sensitivity_zones: list[Annotated[str, Field(min_length=1)]] = [name for name, _ in ISO_14839_3_DB]
    sensitivity_zone_limits_db: list[Positive] = [limit for _, limit in ISO_14839_3_DB[:-1]]

    @model_validator(mode="after")
    def _rising(self) -> _Limits:
        names, limits = self.sensitivity_zones, self.sensitivity_zone_limits_db
        if len(names) != len(limits) + 1 or len(set(names)) < len(names):
            raise ValueError("sensitivity_zones need different names, one more than sensitivity_zone_limits_db")
        if any(a >= b for a, b in pairwise(limits)):
            raise ValueError("sensitivity_zone_limits_db have to rise")
        return self


class _Tolerance(_Section):
    current_stiffness: Positive | None = None
    position_stiffness: Positive | None = None
    mode_frequency: Positive | None = None
    mode_damping: Positive | None = None
    mode_shape: Positive | None = None
    mass: Positive | None = None
    transverse_inertia: Positive | None = None
    sensor_gain: Positive | None = None
    amplifier_frequency: Positive | None = None
    amplifier_damping: Positive | None = None
    amplifier_gain: Positive | None = None
    sensor_position_m: Positive | None = None


class _File(_Section):
    rig: _Rig
    rotor: _Rotor
    modes: list[_Mode] = []
    bearings: _Bearings
    amplifier: _Amplifier
    sensor: _Sensor = _Sensor()
    controller: _Controller
    limits: _Limits
    tolerance: _Tolerance | None = None
    effects: dict[str, dict[str, Finite]] = {}


def _whole_numbers_to_float(value: Any) -> Any:
    """TOML's ``280`` is an integer; every figure of a datasheet is a real number."""
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        return float(value)
    if isinstance(value, list):
        return [_whole_numbers_to_float(v) for v in value]
    if isinstance(value, dict):
        return {k: _whole_numbers_to_float(v) for k, v in value.items()}
    return value


def _per_axis(name: str, value: float | list[float], n: int) -> tuple[float, ...]:
    values = [value] * n if isinstance(value, float) else list(value)
    if len(values) != n:
        raise DatasheetError(f"{name} has {len(values)} values; give one for all or {n}, one per axis")
    return tuple(values)


def _problems(error: ValidationError) -> str:
    """What is wrong with a file in one line: names that are not known first, then what is missing or cannot be."""
    # of a list, what is wrong in it is told and not that it is no number
    found = [p for p in error.errors() if not (p["type"] == "float_type" and isinstance(p.get("input"), list))]
    found = found or error.errors()
    told, meant = {}, set()
    for problem in found:
        if problem["type"] == "extra_forbidden":
            where, close = _where(problem["loc"]), _close(problem["loc"])
            meant |= {close}
            told[where] = f"{where} is not known" + (f", is {close} meant?" if close else "")
    for problem in found:
        where = _where(problem["loc"])
        if where not in told and not (problem["type"] == "missing" and where in meant):  # misspelt, and so missing
            told[where] = f"{where} is missing" if problem["type"] == "missing" else f"{where}: {_refused(problem)}"
    sentences = list(told.values())
    more = len(sentences) - SHOWN
    return "; ".join(sentences[:SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _where(loc: tuple[int | str, ...]) -> str:
    """Where in a file something is: a section in its brackets, or a dotted name."""
    parts = [str(p) for p in loc if not str(p).startswith(("function", "constrained", "list[", "float"))]
    return f"[{parts[0]}]" if len(parts) == 1 else ".".join(parts)


def _close(loc: tuple[int | str, ...]) -> str:
    """The name that a misspelt one is likely to be; empty where none is like it."""
    section: type[BaseModel] = _File
    for part in loc[:-1]:
        if isinstance(part, str):
            annotation = section.model_fields[part].annotation
            inside = (a for a in (annotation, *get_args(annotation)) if isinstance(a, type))
            section = next(a for a in inside if issubclass(a, BaseModel))
    like = get_close_matches(str(loc[-1])[:LONGEST], section.model_fields, n=1)
    return _where((*loc[:-1], like[0])) if like else ""


def _refused(problem: ErrorDetails) -> str:
    """Why a value cannot be."""
    message = problem["msg"].removeprefix("Value error, ")
    shown = problem.get("input")
    value = "" if isinstance(shown, dict | list | BaseModel) else f" (it is {shown!r})"
    if problem["type"] == "less_than_equal":
        unit = next(OTHER_UNITS[end] for p in reversed(problem["loc"]) if (end := str(p)[-2:]) in OTHER_UNITS)
        message = f"no rig has more than {problem['ctx']['le']:g}; give it in {unit}"
    return message + value


def _must_be_shallow(text: str) -> None:
    """Raise DatasheetError for keys and brackets so deep that reading them takes minutes, or ends in the stack."""
    bare = _QUOTED.sub(lambda found: "" if found[0].startswith("#") else "_", text)
    for key in _DOTTED.finditer(bare):
        if (parts := key[0].count(".") + 1) > DEEPEST:
            raise DatasheetError(
                f"the key {key[0][:20]}... has {parts} parts; a datasheet's keys have a few: leave it out"
            )
    depth = 0
    for bracket in re.finditer(r"[\[\]{}]", bare):
        depth = depth + 1 if bracket[0] in "[{" else max(depth - 1, 0)
        if depth > DEEPEST:
            raise DatasheetError(
                f"more than {DEEPEST} brackets are open at once; a datasheet's lists are not that deep"
            )


def _must_be_in_hz(f: _File) -> None:
    """Raise DatasheetError for a bandwidth so far below the sample rate that no loop levitates: it is in kHz."""
    rate_hz = 1.0 / f.controller.sample_time_s
    for section, part in (("amplifier", f.amplifier), ("sensor", f.sensor)):
        for name in ("bandwidth_hz", "natural_frequency_hz"):
            value = getattr(part, name, None)
            least = min(value) if isinstance(value, list) and value else value
            if isinstance(least, float) and least < rate_hz / 1000:
                raise DatasheetError(
                    f"{section}.{name} is {least:g}, less than a thousandth of the controller's {rate_hz:.0f} Hz "
                    "sample rate, and no such rig levitates; give it in Hz, not in kHz"
                )


def parse(text: str, source: str = "rig.toml") -> Datasheet:
    """Read a datasheet from TOML text.

    Raises
    ------
    DatasheetError
        One line that names ``source``, the field and what it must be.
    """
    raw = _tables(text, source)
    try:
        f = _File.model_validate(raw)
    except ValidationError as error:
        raise DatasheetError(f"{source}: {_problems(error)}") from error
    try:
        _must_be_in_hz(f)
        datasheet = _datasheet(f)
        if datasheet.effects:  # or a typing error would be told once the whole experiment is measured
            from sim.twin import rig_from_datasheet  # which knows the catalogue, and that the parts of a rig

            rig_from_datasheet(datasheet)
    except (DatasheetError, EffectError) as error:
        raise DatasheetError(f"{source}: {error}") from error
    return datasheet


def kept_axes(text: str) -> tuple[str, ...]:
    """Axes of a datasheet that was read once and kept; what is shown of it does not end where newer rules refuse it.

    >>> kept_axes('rig.axes = ["xA", "xB"]  # and a rotor that no rig has any more')
    ('xA', 'xB')
    """
    return tuple(tomllib.loads(text.removeprefix(BYTE_ORDER_MARK))["rig"]["axes"])


def _tables(text: str, source: str) -> Any:
    """What TOML text holds, whole numbers as floating ones."""
    try:
        text = text.removeprefix(BYTE_ORDER_MARK)
        _must_be_shallow(text)
        return _whole_numbers_to_float(tomllib.loads(text))
    except DatasheetError as error:
        raise DatasheetError(f"{source}: {error}") from error
    except OverflowError as error:
        raise DatasheetError(f"{source}: a whole number is larger than any figure; write it as 1e6 is") from error
    except (ValueError, RecursionError) as error:  # what is no TOML, and a number of thousands of digits
        raise DatasheetError(f"{source} is not valid TOML: {error}") from error


def _datasheet(f: _File) -> Datasheet:
    """The datasheet that a file holds, its modes by rising frequency."""
    n = len(f.rig.axes)
    natural = f.amplifier.natural_frequency_hz if f.amplifier.bandwidth_hz is None else f.amplifier.bandwidth_hz
    assert natural is not None
    stated = {k: v for k, v in (f.tolerance.model_dump() if f.tolerance else {}).items() if v is not None}
    return Datasheet(
        name=f.rig.name,
        axes=tuple(f.rig.axes),
        mass_kg=f.rotor.mass_kg,
        transverse_inertia_kgm2=f.rotor.transverse_inertia_kgm2,
        polar_inertia_kgm2=f.rotor.polar_inertia_kgm2,
        bearing_from_cog_m=(f.rotor.bearing_from_cog_m[0], f.rotor.bearing_from_cog_m[1]),
        sensor_from_cog_m=(f.rotor.sensor_from_cog_m[0], f.rotor.sensor_from_cog_m[1]),
        modes=tuple(
            Mode(
                m.frequency_hz,
                m.damping_ratio,
                (m.shape_at_bearings[0], m.shape_at_bearings[1]),
                (m.shape_at_sensors[0], m.shape_at_sensors[1]),
            )
            for m in sorted(f.modes, key=lambda m: m.frequency_hz)
        ),
        current_stiffness_n_per_a=_per_axis(
            "bearings.current_stiffness_n_per_a", f.bearings.current_stiffness_n_per_a, n
        ),
        position_stiffness_n_per_m=_per_axis(
            "bearings.position_stiffness_n_per_m", f.bearings.position_stiffness_n_per_m, n
        ),
        bias_current_a=_per_axis("bearings.bias_current_a", f.bearings.bias_current_a, n),
        linear_range_m=f.bearings.linear_range_m,
        amplifier_gain=_per_axis("amplifier.gain", f.amplifier.gain, n),
        amplifier_natural_frequency_hz=_per_axis("amplifier.natural_frequency_hz", natural, n),
        amplifier_damping_ratio=None
        if f.amplifier.damping_ratio is None
        else _per_axis("amplifier.damping_ratio", f.amplifier.damping_ratio, n),
        sensor_gain=_per_axis("sensor.gain", f.sensor.gain, n),
        sensor_bandwidth_hz=None
        if f.sensor.bandwidth_hz is None
        else _per_axis("sensor.bandwidth_hz", f.sensor.bandwidth_hz, n),
        sample_time_s=f.controller.sample_time_s,
        computing_delay_s=f.controller.computing_delay_s,
        numerator=tuple(f.controller.numerator),
        denominator=tuple(f.controller.denominator),
        displacement_limit_m=f.limits.displacement_m,
        current_limit_a=f.limits.current_a,
        sensitivity_zones_db=tuple(
            zip(f.limits.sensitivity_zones, [*f.limits.sensitivity_zone_limits_db, math.inf], strict=True)
        ),
        tolerance=Tolerance(**stated),
        tolerance_stated=f.tolerance is not None,
        effects=tuple((k, tuple(v.items())) for k, v in f.effects.items()),
    )


def read(path: Path) -> Datasheet:
    """Read a datasheet from a file; errors name the file."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        why = error.strerror or str(error)
        raise DatasheetError(f"cannot read the datasheet {path}: {why}; give the path of a rig.toml") from error
    except UnicodeDecodeError as error:
        raise DatasheetError(f"the datasheet {path} is not UTF-8 text ({error}); save it as UTF-8") from error
    return parse(text, str(path))


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, str):
        # JSON's strings are TOML's but for surrogate pairs, which TOML does not know, and DEL, which it does not take.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if not math.isfinite(value):
        raise DatasheetError(f"a datasheet holds finite numbers only, not {value}")
    return repr(float(value))


def _zones(datasheet: Datasheet) -> dict[str, Any]:
    """Zones other than those of the standard."""
    zones = datasheet.sensitivity_zones_db
    if zones == ISO_14839_3_DB:
        return {}
    return {
        "sensitivity_zones": tuple(name for name, _ in zones),
        "sensitivity_zone_limits_db": tuple(limit for _, limit in zones[:-1]),
    }


def to_toml(datasheet: Datasheet) -> str:
    """TOML text that ``parse`` reads back to an equal datasheet.

    >>> from sim.reference import reference_datasheet
    >>> parse(to_toml(reference_datasheet())) == reference_datasheet()
    True
    """
    d = datasheet
    first_order = d.amplifier_damping_ratio is None
    sections: list[tuple[str, dict[str, Any]]] = [
        ("[rig]", {"name": d.name, "axes": d.axes}),
        (
            "[rotor]",
            {
                "mass_kg": d.mass_kg,
                "transverse_inertia_kgm2": d.transverse_inertia_kgm2,
                "polar_inertia_kgm2": d.polar_inertia_kgm2,
                "bearing_from_cog_m": d.bearing_from_cog_m,
                "sensor_from_cog_m": d.sensor_from_cog_m,
            },
        ),
        *(("[[modes]]", {f.name: getattr(m, f.name) for f in fields(m)}) for m in d.modes),
        (
            "[bearings]",
            {
                "current_stiffness_n_per_a": d.current_stiffness_n_per_a,
                "position_stiffness_n_per_m": d.position_stiffness_n_per_m,
                "bias_current_a": d.bias_current_a,
                "linear_range_m": d.linear_range_m,
            },
        ),
        (
            "[amplifier]",
            {
                "gain": d.amplifier_gain,
                ("bandwidth_hz" if first_order else "natural_frequency_hz"): d.amplifier_natural_frequency_hz,
                "damping_ratio": d.amplifier_damping_ratio,
            },
        ),
        ("[sensor]", {"gain": d.sensor_gain, "bandwidth_hz": d.sensor_bandwidth_hz}),
        (
            "[controller]",
            {
                "sample_time_s": d.sample_time_s,
                "computing_delay_s": d.computing_delay_s,
                "numerator": d.numerator,
                "denominator": d.denominator,
            },
        ),
        ("[limits]", {"displacement_m": d.displacement_limit_m, "current_a": d.current_limit_a} | _zones(d)),
    ]
    if d.tolerance_stated:
        sections.append(("[tolerance]", {f.name: getattr(d.tolerance, f.name) for f in fields(d.tolerance)}))
    sections += [(f"[effects.{effect}]", dict(values)) for effect, values in d.effects]
    blocks = [
        "\n".join([title, *(f"{k} = {_value(v)}" for k, v in body.items() if v is not None)])
        for title, body in sections
    ]
    return "\n\n".join(blocks) + "\n"
