"""Errors of the physics.

::

    AmbError (ValueError)            anything a caller can put right
    ├── DatasheetError               a value of rig.toml is missing, of the wrong type or out of range
    ├── LevitationError              the controller of the rig does not hold the rotor
    ├── EffectError                  an unknown effect or parameter, or one that this rig cannot have
    └── OptionsError                 values that a user gave cannot be read, or do not go together
"""

import re


class AmbError(ValueError):
    """Base of every error of this product: one line that names the thing and the remedy."""


def reason(error: BaseException) -> str:
    """What an error says, in one line; of one of the operating system the words, without its number.

    >>> reason(FileNotFoundError(2, "No such file or directory", "rig.toml"))
    'No such file or directory'
    """
    words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(re.sub(r"\[Errno -?\d+\] ", "", words).split()) or type(error).__name__


class DatasheetError(AmbError):
    """A datasheet breaks the contract; the message names the field."""


class LevitationError(AmbError):
    """The closed loop is unstable: the rotor cannot be levitated with this controller."""


class EffectError(AmbError):
    """An effect id or one of its parameters is unknown, or does not fit the rig."""


class OptionsError(AmbError):
    """Values that a user gave cannot be read or do not go together; to a command that is bad usage."""
