"""Errors of access.

::

    ServiceError (service.errors)
    └── AccessError
        ├── UnauthorisedError    401: no key, or none that is known, valid now and not revoked
        ├── ForbiddenError       403: the key's scope does not reach so far
        └── RateError            429: too many requests; carries the seconds to wait
"""

from service.errors import ServiceError


class AccessError(ServiceError):
    """Base of every refusal of access."""


class UnauthorisedError(AccessError):
    """The request carries no key that is known, valid now and not revoked."""


class ForbiddenError(AccessError):
    """The key is good, its scope does not reach so far."""


class RateError(AccessError):
    """Too many requests.

    Attributes
    ----------
    retry_after_s
        Seconds after which the next request is let through.
    """

    def __init__(self, message: str, retry_after_s: float) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s
