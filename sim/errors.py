"""Errors of the physics.

::

    AmbError (ValueError)            anything a caller can put right
    ├── DatasheetError               a value of rig.toml is missing, of the wrong type or out of range
    ├── LevitationError              the controller of the rig does not hold the rotor
    └── EffectError                  an unknown effect or parameter, or one that this rig cannot have
"""


class AmbError(ValueError):
    """Base of every error of this product: one line that names the thing and the remedy."""


class DatasheetError(AmbError):
    """A datasheet breaks the contract; the message names the field."""


class LevitationError(AmbError):
    """The closed loop is unstable: the rotor cannot be levitated with this controller."""


class EffectError(AmbError):
    """An effect id or one of its parameters is unknown, or does not fit the rig."""
