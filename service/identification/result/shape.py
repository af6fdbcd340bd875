"""The fields of a result.json that are read back, with their types and sizes; others may be anything.

Whoever reads a result takes what these models give, and nothing beside: what is read has been checked.
"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from service.identification.plane.amplifier import N_PARAMETERS
from service.identification.plane.layout import SHIFTS, Layout

Matrix = list[list[FiniteFloat]]


class _Read(BaseModel):
    model_config = ConfigDict(strict=True, protected_namespaces=())


def _is(matrix: Matrix, rows: int, columns: int) -> bool:
    return len(matrix) == rows and all(len(row) == columns for row in matrix)


class _StateSpace(_Read):
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    states: list[str]
    inputs: list[str]
    outputs: list[str]

    @model_validator(mode="after")
    def _fits(self) -> Self:
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        for name, rows, columns in (("A", n, n), ("B", n, m), ("C", p, n), ("D", p, m)):
            if not _is(getattr(self, name), rows, columns):
                raise ValueError(f"{name} is not {rows} x {columns}, as its names say")
        return self


class _Effect(_Read):
    effect: str
    parameters: dict[str, FiniteFloat]


class _Result(_Read):
    format: str
    version: int
    rig: str
    identified: bool = True
    known_effects: list[_Effect] | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_figures(cls, document: Any) -> Any:
        """The planes of a rig that is not identified are not looked at: that it is not is what there is to say."""
        not_identified = isinstance(document, dict) and document.get("identified") is False
        return {k: v for k, v in document.items() if k != "planes"} if not_identified else document

    @model_validator(mode="after")
    def _has_planes(self) -> Self:
        if self.identified and not getattr(self, "planes", None):
            raise ValueError("it has no plane")
        return self


class _PlaneSpaces(_Read):
    state_space: _StateSpace
    amplifier_state_space: _StateSpace

    @model_validator(mode="after")
    def _in_series(self) -> Self:
        if len(self.amplifier_state_space.outputs) != len(self.state_space.inputs):
            raise ValueError("its amplifiers have not as many outputs as its plant has inputs")
        return self


class ResultSpaces(_Result):
    """What an export reads: state spaces."""

    experiment: Any = ""
    planes: dict[str, _PlaneSpaces] = {}


class _Parameters(_Read):
    amplifier_orders: Annotated[list[int], Field(min_length=2, max_length=2)]
    modes: Annotated[int, Field(ge=0, le=1000)]
    values: dict[str, FiniteFloat]
    free: list[str]
    covariance: Matrix
    covariance_from_data: Matrix | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not set(self.amplifier_orders) <= set(N_PARAMETERS):
            raise ValueError(f"amplifiers have no orders {self.amplifier_orders}")
        names = Layout((self.amplifier_orders[0], self.amplifier_orders[1]), self.modes).names
        if missing := [name for name in names if name not in self.values and name not in SHIFTS]:
            raise ValueError(f"it has no value of {missing[0]}")
        n = len(set(self.free) & set(names))
        if n != len(self.free):
            raise ValueError("free names what is no parameter")
        for name in ("covariance", "covariance_from_data"):
            found = getattr(self, name)
            if found is not None and not _is(found, n, n):
                raise ValueError(f"{name} is not {n} x {n}, as free says")
        return self


class _Residuals(_Read):
    rms_over_sigma: FiniteFloat
    model_adequate: bool
    std_widened_by: FiniteFloat | None


class _Frequency(_Read):
    value: FiniteFloat


class _Mode(_Read):
    natural_frequency_rad_s: _Frequency


class _OtherMode(_Mode):
    kind: str


class _Evidence(_Read):
    chosen: bool = False
    data: int
    parameters: int


class _PlaneModel(_Read):
    parameters: _Parameters | None = None
    residuals: _Residuals
    rotor_modes: list[_Mode]
    other_modes: list[_OtherMode]
    mode_evidence: list[_Evidence] | None = None
    cross_validation_passed: bool | None = None
    measured_hz: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None = None

    @model_validator(mode="after")
    def _has_its_modes(self) -> Self:
        if self.parameters is not None and self.parameters.modes == 0 and (self.rotor_modes or self.other_modes):
            raise ValueError("it lists modes and has parameters of none")
        return self


class ResultModel(_Result):
    """What later work starts from: parameters with their covariance, plane by plane."""

    speed_rad_s: FiniteFloat | None = None
    planes: dict[str, _PlaneModel] = {}
    rotating: Any = None
    """Of the turning rotor; where it cannot be read, that is said, and all else goes on."""
