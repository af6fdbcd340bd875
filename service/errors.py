"""Errors of the service, and where every other error of the product is drawn.

::

    AmbError (sim.errors)            one line that names the thing and the remedy; a command prints it and exits 1
    ├── ControllerError              drivers.errors: bus, lease, limits, trips
    ├── ExperimentError              service.experiment.errors: files, journal, campaign
    └── ServiceError
        ├── OutputError              a result cannot be written
        ├── DocumentError            a result, a report or a twin that shall be read is not what it should be
        └── StoppedError             the user stopped the job; what was finished is kept
"""

from sim.errors import AmbError


class ServiceError(AmbError):
    """Base of every error of the service itself."""


class OutputError(ServiceError):
    """A folder or file cannot be written."""


class DocumentError(ServiceError):
    """A document of this product cannot be read back."""


class StoppedError(ServiceError):
    """The user stopped the job."""
