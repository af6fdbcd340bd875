"""An effect that the simulated rig has and no one is told: drawn from the catalogue, kept in a sealed file.

The device prints a commitment, the SHA-256 of nonce and truth. Who diagnoses cannot learn the truth from it, and
who sealed it cannot change it afterwards.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.effect import Parameter
from sim.effects import CATALOGUE
from sim.errors import AmbError, EffectError, LevitationError
from sim.rig import Rig
from sim.stepping import Simulation

FORMAT = "amb-withheld-effect"
ATTEMPTS = 100


@dataclass(frozen=True)
class Withheld:
    """An effect and its parameters' values."""

    effect: str
    values: tuple[tuple[str, float], ...]

    def on(self, rig: Rig) -> Rig:
        """Rig with the effect."""
        return CATALOGUE[self.effect].on(rig, **dict(self.values))


def draw(rig: Rig, seed: int) -> Withheld:
    """An effect that this rig can have and still levitates with, its strength half to one and a half of typical.

    Raises
    ------
    EffectError
        No effect of the catalogue fits.
    """
    generator = np.random.default_rng(seed)
    fitting = [e for e in CATALOGUE.values() if e.needs_axes <= rig.n_axes and (rig.speed_rad_s or not e.needs_speed)]
    for _ in range(ATTEMPTS if fitting else 0):
        chosen = fitting[generator.integers(len(fitting))]
        drawn = Withheld(chosen.id, tuple((p.name, _value(p, generator)) for p in chosen.parameters))
        try:
            Simulation(drawn.on(rig), 0)
        except (EffectError, LevitationError):
            continue
        return drawn
    raise EffectError(f"no effect of the catalogue fits rig {rig.name}")


def _value(parameter: Parameter, generator: np.random.Generator) -> float:
    value = parameter.typical * generator.uniform(0.5, 1.5)
    return float(np.clip(value, min(parameter.low, parameter.high), max(parameter.low, parameter.high)))


def seal(withheld: Withheld, path: Path) -> str:
    """Commitment to the effect, which is written to ``path`` and nowhere else; only its owner can read it."""
    truth = json.dumps({"effect": withheld.effect, "values": dict(withheld.values)}, sort_keys=True)
    nonce = secrets.token_hex(16)
    commitment = _commitment(nonce, truth)
    content = {"format": FORMAT, "version": 1, "commitment": commitment, "nonce": nonce, "truth": truth}
    try:
        path.touch(mode=0o600, exist_ok=True)
        path.write_text(json.dumps(content) + "\n", encoding="utf-8")
    except OSError as error:
        raise AmbError(f"cannot write the sealed file {path}: {error}") from error
    return commitment


def opened(path: Path, commitment: str) -> Withheld:
    """The effect in a sealed file.

    Raises
    ------
    AmbError
        The file is not what the commitment was made to.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        nonce, truth = content["nonce"], content["truth"]
    except (OSError, UnicodeDecodeError, ValueError, KeyError, TypeError) as error:
        raise AmbError(f"cannot read the sealed file {path}: {error}") from error
    if _commitment(nonce, truth) != commitment:
        raise AmbError(f"the sealed file {path} is not the one of commitment {commitment[:12]}...: it was changed")
    told = json.loads(truth)
    return Withheld(told["effect"], tuple(sorted(told["values"].items())))


def _commitment(nonce: str, truth: str) -> str:
    return hashlib.sha256(f"{nonce}\n{truth}".encode()).hexdigest()
