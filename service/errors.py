"""Errors of the service, and where every other error of the product is drawn.

::

    AmbError (sim.errors)            one line that names the thing and the remedy; a command prints it and exits 1
    ├── SingularInputError           service.identification.measured.etfe: the inputs do not tell the axes apart
    ├── ControllerError              drivers.errors: bus, lease, limits, trips
    ├── ExperimentError              service.experiment.errors: files, journal, campaign
    └── ServiceError
        ├── OutputError              a result cannot be written
        ├── DocumentError            a result, a report or a twin that shall be read is not what it should be
        ├── StoppedError             the user stopped the job; what was finished is kept
        ├── ConfigurationError       a setting of the service is unknown or out of range
        ├── StorageError             a database or the store cannot be used
        ├── NotFoundError            there is no such resource
        ├── ConflictError            the state of a resource does not allow it
        │     └── InUseError         another process is at work in a folder
        ├── AccessError              service.access.errors: no key, too small a scope, too many requests
        ├── UploadError              service.uploads.errors: a file that was sent is refused
        ├── ControllerRefusedError   a controller that was checked would not be safe on the rig, or may not be
        └── JobError                 a job cannot be done; its title says in a few words what is the matter
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


class ConfigurationError(ServiceError):
    """A setting is unknown, of the wrong type or out of range."""


class StorageError(ServiceError):
    """A database or the store cannot be used."""


class NotFoundError(ServiceError):
    """There is no such resource."""


class ConflictError(ServiceError):
    """The state of a resource does not allow what was asked for."""


class InUseError(ConflictError):
    """Another process is at work in a folder that is for one at a time."""


class ControllerRefusedError(ServiceError):
    """A controller must not be loaded."""


class JobError(ServiceError):
    """A job cannot be done.

    Parameters
    ----------
    title
        A few words that stay the same for the same reason.
    detail
        One line that names the thing and the remedy.
    """

    def __init__(self, title: str, detail: str) -> None:
        super().__init__(detail)
        self.title = title
