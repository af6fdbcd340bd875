"""Errors of talking to a controller. A caller retries `BusError`, waits for `LeaseError`, and stops at the rest.

::

    AmbError (sim.errors)
    └── ControllerError
        ├── BusError             the link failed: time-out, bad CRC, refused connection; trying again may help
        ├── LeaseError           another host holds the rig; names the holder and the time left
        ├── LimitError           a value outside the controller's limits was refused before it was sent
        ├── TripError            the controller tripped: excitation is zero, the trip is latched; says why
        ├── BusyError            the controller is playing another tone
        ├── RestartError         the controller restarted (its boot_id changed); nothing of before is valid
        ├── AddressError         a URL is none of a controller: its scheme, host or an option; says what is valid
        ├── StopRefusedError     the controller did not stop, and may go on exciting: end the excitation there
        ├── OverdueError         a tone did not end in its time; the excitation was ended, and is off
        ├── MapError             a rig's own map of registers or objects is wrong; names the object
        ├── TranscriptError      what passes cannot be written down any more; the controller has done what it was asked
        └── CancelledError       the excitation was stopped, and is off
            └── StoppedElsewhereError  by somebody else than the caller: see to the rig before it is excited again
"""

from sim.errors import AmbError


class ControllerError(AmbError):
    """Base of every error of a controller."""


class BusError(ControllerError):
    """The link to the controller failed; the same call may be tried again."""


class LeaseError(ControllerError):
    """Another host holds the rig, or nobody does (an empty holder) and the caller must lease it first."""

    def __init__(self, holder: str, seconds_left: float) -> None:
        super().__init__(
            f"the rig is leased to {holder!r} for another {seconds_left:.1f} s; wait, or ask that host to release it"
            if holder
            else "the caller does not hold the rig's lease (never taken, or lapsed); take it and try again"
        )
        self.holder = holder
        self.seconds_left = seconds_left


class LimitError(ControllerError):
    """A value is outside what the controller allows; nothing was sent."""


class TripError(ControllerError):
    """The controller tripped: the excitation is off and the trip is latched until it is acknowledged."""

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class LatchedTripError(TripError):
    """A trip was latched before the tone began, which was refused: nothing was excited."""


class BusyError(ControllerError):
    """The controller is playing another tone; wait until it is done, or stop it."""


class AddressError(ControllerError):
    """A URL is none of a controller."""


class StopRefusedError(ControllerError):
    """The controller refused to stop, or did not: it may go on exciting, and somebody has to end that there."""


class OverdueError(ControllerError):
    """A tone did not end in its time, or after a stop that the controller had accepted."""


class MapError(ControllerError):
    """A rig's own map of registers or objects is wrong."""


class TranscriptError(ControllerError):
    """What passes cannot be written down; the controller has done what it was asked last all the same."""


class RestartError(ControllerError):
    """The controller restarted while it was leased."""


class CancelledError(ControllerError):
    """The excitation was stopped, and is off."""


class StoppedElsewhereError(CancelledError):
    """Somebody else than the caller stopped the excitation; see to the rig before it is excited again."""
