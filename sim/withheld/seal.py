"""A truth behind a hash: who commits to it cannot change it afterwards, who sees the commitment cannot learn it.

>>> s = seal({"effects": ["loop_delay"]}, nonce="00ff")
>>> opened(s.document(), s.commitment)
{'effects': ['loop_delay']}
>>> opened(s.document() | {"truth": '{"effects": []}'}, s.commitment)
Traceback (most recent call last):
    ...
sim.withheld.seal.SealError: the sealed truth is not the one of commitment ...: it was changed
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sim.errors import AmbError

FORMAT = "amb-withheld-effect"


class SealError(AmbError):
    """A sealed truth is not the one that was committed to, or cannot be read."""


MARK = 12
"""Digits of a commitment by which a device tells which sealed truth it runs."""


def named_after(commitment: str) -> str:
    """How a device that runs a sealed truth begins its name; the commitment is no secret.

    >>> named_after("00ff" * 16)
    'withheld 00ff00ff00ff'
    """
    return f"withheld {commitment.strip().lower()[:MARK]}"


def names_a_seal(identity: str) -> bool:
    """Whether a controller's name is that of a device that runs some sealed truth.

    >>> names_a_seal("withheld 00ff00ff00ff, simulated rig mill"), names_a_seal("withheld rig")
    (True, False)
    """
    return re.match(rf"withheld [0-9a-f]{{{MARK}}}\b", identity) is not None


@dataclass(frozen=True)
class Seal:
    """A truth and the nonce that keeps it from being guessed from its hash."""

    nonce: str
    truth: str
    """JSON text, as it was hashed."""

    @property
    def commitment(self) -> str:
        """SHA-256 of nonce and truth, hexadecimal: what is shown before the seal is opened."""
        return commitment_to(self.nonce, self.truth)

    def document(self) -> dict[str, Any]:
        """The sealed file's content."""
        return {
            "format": FORMAT,
            "version": 1,
            "commitment": self.commitment,
            "nonce": self.nonce,
            "truth": self.truth,
        }


def commitment_to(nonce: str, truth: str) -> str:
    """SHA-256 of nonce, newline and truth, hexadecimal."""
    return hashlib.sha256(f"{nonce}\n{truth}".encode()).hexdigest()


def seal(truth: Mapping[str, Any], nonce: str | None = None) -> Seal:
    """Seal a truth; a nonce of 128 bits is drawn unless one is given."""
    return Seal(nonce or secrets.token_hex(16), json.dumps(truth, sort_keys=True, allow_nan=False))


def opened(document: Mapping[str, Any], commitment: str) -> dict[str, Any]:
    """The truth in a sealed document.

    Parameters
    ----------
    document
        As `Seal.document` gave it.
    commitment
        As it was shown before; the document's own is not trusted.

    Raises
    ------
    SealError
        The document was changed, or is none.
    """
    try:
        nonce, text = str(document["nonce"]), str(document["truth"])
    except (KeyError, TypeError) as error:
        raise SealError(f"the sealed document has no {error}; keep the file as it was written") from error
    if not hmac.compare_digest(commitment_to(nonce, text).encode(), commitment.strip().lower().encode()):
        raise SealError(f"the sealed truth is not the one of commitment {commitment[:12]}...: it was changed")
    try:
        truth = json.loads(text)
    except ValueError as error:
        raise SealError(f"the sealed truth cannot be read: {error}") from error
    if not isinstance(truth, dict):
        raise SealError("the sealed truth is no JSON object")
    return truth
