"""Errors of exports."""

from service.errors import ServiceError


class ExportError(ServiceError):
    """Something cannot be written in a format, or a file of it cannot be read back."""
