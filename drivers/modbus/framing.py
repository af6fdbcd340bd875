"""Characters on a serial line: parity and stop bits (Modbus over serial line 1.02, 2.5.1)."""

from __future__ import annotations

from dataclasses import dataclass

PARITIES = ("E", "O", "N")


@dataclass(frozen=True)
class Framing:
    """Eight bits between a start bit, a parity bit or none, and stop bits."""

    parity: str = "N"
    stop_bits: int = 1

    @property
    def bits(self) -> int:
        """Of the line for each byte."""
        return 1 + 8 + (self.parity != "N") + self.stop_bits


EIGHT_N_ONE = Framing()
"""Unless a URL says otherwise."""


def framing(parity: str = "") -> Framing:
    """That of a parity: as the standard says, which has a second stop bit in place of parity; without one, 8N1.

    >>> framing("E"), framing("N"), framing(), framing("O").bits
    (Framing(parity='E', stop_bits=1), Framing(parity='N', stop_bits=2), Framing(parity='N', stop_bits=1), 11)
    """
    return Framing(parity, 2 if parity == "N" else 1) if parity else EIGHT_N_ONE
