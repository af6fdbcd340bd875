"""A figure with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SIGNIFICANT = 3.0
"""Standard deviations below which an estimate is not told from zero, and nothing is a share of it."""


@dataclass(frozen=True)
class Estimate:
    """A figure with its standard deviation."""

    value: float
    std: float
    unit: str = ""
    nominal: float | None = None
    """What the datasheet says."""
    std_from_data: float | None = None
    """The part of ``std`` that noise brings: without widening, and with the shapes' splits held."""

    @property
    def error_percent(self) -> float | None:
        """How far the datasheet is from the estimate, percent of the estimate; None of one that may be zero."""
        if self.nominal is None or self.value == 0 or abs(self.value) < SIGNIFICANT * self.std:
            return None
        return 100.0 * (self.nominal - self.value) / self.value

    def document(self) -> dict[str, Any]:
        """As JSON."""
        out: dict[str, Any] = {"value": self.value, "std": self.std, "unit": self.unit}
        if self.nominal is not None:
            out |= {"nominal": self.nominal, "error_percent": self.error_percent}
        if self.std_from_data is not None:
            out["std_from_data"] = self.std_from_data
        return out
