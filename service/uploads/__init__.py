"""Files that strangers send: looked at, and read, in a process that can be lost."""

from service.uploads.confined import Parsed, parse
from service.uploads.errors import UploadBusyError, UploadContentError, UploadError, UploadSizeError, UploadTypeError
from service.uploads.limits import Limits

__all__ = [
    "Limits",
    "Parsed",
    "UploadBusyError",
    "UploadContentError",
    "UploadError",
    "UploadSizeError",
    "UploadTypeError",
    "parse",
]
