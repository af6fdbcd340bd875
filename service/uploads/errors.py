"""Errors of uploads.

::

    ServiceError (service.errors)
    └── UploadError              a file that was sent is refused; carries the HTTP status
        ├── UploadTypeError      415: neither HDF5 nor MATLAB
        ├── UploadSizeError      413: the file, or what it says it holds, is larger than the limits
        ├── UploadContentError   422: links, damage, wrong types, numbers that are none, too costly to read
        └── UploadBusyError      503: others are being read; try again
"""

from service.errors import ServiceError


class UploadError(ServiceError):
    """An uploaded file is refused: one line that names what is wrong with it and the remedy."""

    status = 422


class UploadTypeError(UploadError):
    """The file is of another type."""

    status = 415


class UploadSizeError(UploadError):
    """The file is too large, or unpacks to too much."""

    status = 413


class UploadContentError(UploadError):
    """The file breaks the contract, or does what an experiment file has no need of."""


class UploadBusyError(UploadError):
    """As many files as are allowed are being read."""

    status = 503


BY_STATUS: dict[int, type[UploadError]] = {
    error.status: error for error in (UploadTypeError, UploadSizeError, UploadContentError, UploadBusyError)
}
